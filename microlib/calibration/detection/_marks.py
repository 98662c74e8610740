"""Marks in a grey image: dark regions by one threshold, or closed contours in clutter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from microlib._common import Array
from microlib.calibration.detection._settings import Settings

#: Standard deviation over median absolute value of normal errors.
TO_SIGMA = 1.4826
#: A contour that may be a mark: its centroid, second central moments and area, the mean gradient
#: along it, and whether it encloses a dark region.
_CONTOUR = [
    ("center", "2f8"),
    ("moments", "(2,2)f8"),
    ("area", "f8"),
    ("slope", "f8"),
    ("dark", "?"),
]


@dataclass(frozen=True, eq=False)
class Marks:
    """Candidates for dark marks in an image.

    Parameters
    ----------
    image : ndarray of float32, shape (height, width)
        Image of the marks.
    smooth : ndarray of float32, shape (height, width)
        Image after a Gaussian blur of 1 px.
    centers : ndarray, shape (N, 2)
        Centroids (x, y), px.
    moments : ndarray, shape (N, 2, 2)
        Second central moments, px².
    areas : ndarray, shape (N,)
        Number of pixels.
    settings : Settings
        Settings of the detection.
    """

    image: NDArray[np.float32]
    smooth: NDArray[np.float32]
    centers: Array
    moments: Array
    areas: Array
    settings: Settings

    def __getitem__(self, index: NDArray | slice) -> Marks:
        """Selected marks."""
        return replace(
            self, centers=self.centers[index], moments=self.moments[index], areas=self.areas[index]
        )


def to_bytes(grey: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Grey levels scaled to 0 … 255."""
    most = np.iinfo(np.uint8).max
    return np.asarray(cv2.normalize(grey, np.empty(0), 0, most, cv2.NORM_MINMAX, cv2.CV_8U))


def dark_regions(grey: NDArray[np.float32], settings: Settings) -> Marks:
    """Dark regions of similar area by Otsu's threshold of the image.

    Regions of less than a quarter or more than four times the median area are left out. Under
    uneven light, `even_edges` finds more.
    """
    smooth: NDArray = cv2.GaussianBlur(grey, (0, 0), 1.0)
    levels = to_bytes(smooth)
    darkest, _ = cv2.threshold(levels, 0, 1, cv2.THRESH_OTSU)
    rows = _at_level(levels, _slope(smooth), darkest, settings)
    rows = rows[rows["dark"]]
    typical = np.median(rows["area"]) if len(rows) else 0.0
    rows = rows[(rows["area"] > typical / 4) & (rows["area"] < typical * 4)]
    return _strongest(rows, grey, smooth, settings)


def _slope(smooth: NDArray) -> NDArray:
    """Gradient of the image, grey levels per pixel."""
    dx, dy = (cv2.Scharr(smooth, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    return np.hypot(dx, dy) / 32  # the kernel's positive weights times two pixels


def even_edges(grey: NDArray[np.float32], settings: Settings) -> list[Marks]:
    """Marks enclosed by an edge of even gradient: dark ones, and bright ones in the negative."""
    smooth: NDArray = cv2.GaussianBlur(grey, (0, 0), 1.0)
    slope = _slope(smooth)
    # The noise σ by a filter whose response to planes and straight ridges is zero (Immerkær, 1996);
    # the derivative of the smoothed image has a noise of σ/√(8 π).
    mask = np.outer([1.0, -2, 1], [1, -2, 1]) / np.sum([1, 4, 1])
    noise = TO_SIGMA * float(np.median(np.abs(cv2.filter2D(grey, cv2.CV_32F, mask))))
    least = noise * np.sqrt(2 / np.pi)  # four times it
    low, high = np.percentile(smooth, [0.5, 99.5])
    ranks = np.percentile(smooth[::2, ::2], np.linspace(2, 98, settings.levels))
    levels = np.unique(np.concatenate([np.linspace(low, high, settings.levels + 2)[1:-1], ranks]))
    rows = np.concatenate([_at_level(smooth, slope, level, settings, least) for level in levels])
    negative = (grey.max() + grey.min()) - grey
    return [
        _strongest(rows[rows["dark"]], grey, smooth, settings),
        _strongest(rows[~rows["dark"]], negative, negative.max() - smooth, settings),
    ]


def _at_level(
    smooth: NDArray, slope: NDArray, level: float, settings: Settings, least: float | None = None
) -> NDArray:
    """Contours of a grey level that may be marks.

    With `least`, only those of the area of an ellipse or square whose gradient is even and has a
    mean of more than `least`.
    """
    # With a bright border, a mark at the edge of the image is a hole, too.
    mask = np.pad((smooth > level).astype(np.uint8), 1, constant_values=1)
    way = (cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    contours, hierarchy = cv2.findContours(mask, *way, offset=(-1, -1))
    limit = np.array(smooth.shape[::-1]) - 1
    rows = []
    for k, contour in enumerate(contours):
        if len(contour) < settings.min_contour:
            continue
        m = cv2.moments(contour)
        area = m["m00"]
        if not 0 < area < mask.size / 4**2:
            continue
        xx, xy, yy = m["mu20"] / area, m["mu11"] / area, m["mu02"] / area
        spread = xx * yy - xy * xy
        if not spread > (xx + yy) / 4:  # at most two pixels wide, with a variance of ¼ px²
            continue
        ratio = area / (4 * np.pi * np.sqrt(spread))
        if least is not None and not settings.ellipse_ratio[0] < ratio < settings.ellipse_ratio[1]:
            continue
        column, row = np.clip(contour[:, 0], 0, limit).T
        steep = slope[row, column]
        mean = float(steep.mean())
        # Noise, uneven light and pixels scatter the gradient of a mark by up to 0.35.
        if least is not None and not (mean > least and steep.std() < mean / 2):
            continue
        # The contour of a hole runs through the bright pixels around a dark mark, half a pixel from
        # its edge, and that of a bright mark through the outermost pixels of the mark.
        hole = hierarchy[0, k, 3] >= 0
        wider = (1 + (-0.5 if hole else 0.5) / np.sqrt(area / np.pi)) ** 2
        moments = wider * np.array([[xx, xy], [xy, yy]])
        rows.append(((m["m10"] / area, m["m01"] / area), moments, wider * area, mean, hole))
    return np.array(rows, dtype=_CONTOUR)


def _strongest(
    rows: NDArray, image: NDArray[np.float32], smooth: NDArray, settings: Settings
) -> Marks:
    """The contour with the steepest edge of those within half a radius of each other."""
    rows = rows[np.argsort(-rows["slope"], kind="stable")]
    centers, areas = rows["center"], rows["area"]
    chosen = np.ones(len(rows), dtype=bool)
    near = cKDTree(centers).query_ball_point(centers, np.sqrt(areas / np.pi) / 2)
    for k, close in enumerate(near):
        if chosen[k]:
            later = [j for j in close if j > k and 1 / 2 < areas[j] / areas[k] < 2]
            chosen[later] = False
    return Marks(image, smooth, centers[chosen], rows["moments"][chosen], areas[chosen], settings)
