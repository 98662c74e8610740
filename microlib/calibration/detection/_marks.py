"""Marks in a grey image: dark regions by one threshold, or closed contours in clutter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from microlib._common import Array, image_noise
from microlib.calibration.detection._image import GreyImage
from microlib.calibration.detection._settings import DetectionSettings

#: A contour that may be a mark: its centroid, second central moments and area, the mean gradient
#: along it, and whether it encloses a dark region.
_CONTOUR = [
    ("center", "2f8"),
    ("moments", "(2,2)f8"),
    ("area", "f8"),
    ("slope", "f8"),
    ("dark", "?"),
]


class Rows:
    """Record of arrays with n rows each."""

    def __getitem__(self, index: NDArray | slice) -> Self:
        """Selected rows."""
        return type(self)(*(each[index] for each in vars(self).values()))


@dataclass(frozen=True, eq=False)
class Marks(Rows):
    """Candidates for marks in an image.

    Attributes
    ----------
    centers : ndarray, shape (n, 2)
        Centroids (x, y), px.
    moments : ndarray, shape (n, 2, 2)
        Second central moments, px²; NaN for the corners of boards.
    areas : ndarray, shape (n,)
        Number of pixels of a mark, or of a field of a board.
    """

    centers: Array
    moments: Array
    areas: Array


def dark_regions(image: GreyImage, settings: DetectionSettings) -> Marks:
    """Dark regions of similar area by Otsu's threshold of the image.

    Under uneven light, `even_edges` finds more.
    """
    most = np.iinfo(np.uint8).max
    levels: NDArray = cv2.normalize(image.smooth, np.empty(0), 0, most, cv2.NORM_MINMAX, cv2.CV_8U)
    darkest, _ = cv2.threshold(levels, 0, 1, cv2.THRESH_OTSU)
    rows = _at_level(levels, _slope(image.smooth), darkest, settings)
    rows = rows[rows["dark"]]
    typical = np.median(rows["area"]) if len(rows) else 0.0
    rows = rows[np.abs(np.log(rows["area"] / typical)) < np.log(settings.max_region_ratio)]
    return _strongest(rows)


def even_edges(image: GreyImage, settings: DetectionSettings) -> list[tuple[GreyImage, Marks]]:
    """Marks enclosed by an edge of even gradient: dark ones, and bright ones in the negative."""
    smooth, slope = image.smooth, _slope(image.smooth)
    # The derivative of the smoothed image has a noise of σ/√(8 π).
    least = image_noise(image.grey) * np.sqrt(2 / np.pi)  # four times it
    low, high = np.percentile(smooth, [0.5, 99.5])
    ranks = np.percentile(smooth[::2, ::2], np.linspace(2, 98, settings.levels))
    levels = np.unique(np.concatenate([np.linspace(low, high, settings.levels + 2)[1:-1], ranks]))
    rows = np.concatenate([_at_level(smooth, slope, level, settings, least) for level in levels])
    return [
        (image, _strongest(rows[rows["dark"]])),
        (image.negative(), _strongest(rows[~rows["dark"]])),
    ]


def _slope(smooth: NDArray) -> NDArray:
    """Gradient of the image, grey levels per pixel."""
    dx, dy = (cv2.Scharr(smooth, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    return np.hypot(dx, dy) / 32  # the kernel's positive weights times two pixels


def _at_level(
    smooth: NDArray,
    slope: NDArray,
    level: float,
    settings: DetectionSettings,
    least: float | None = None,
) -> NDArray:
    """Contours of a grey level that may be marks.

    With `least`, only those of the area of an ellipse or square whose gradient is even and has a
    mean of more than `least`.
    """
    # With a bright border, a mark at the edge of the image is a hole, too.
    mask = np.pad((smooth > level).astype(np.uint8), 1, constant_values=1)
    contours, hierarchy = cv2.findContours(
        mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE, offset=(-1, -1)
    )
    last_pixel = np.array(smooth.shape[::-1]) - 1
    rows = []
    for k, contour in enumerate(contours):
        if len(contour) < settings.min_contour:
            continue
        m = cv2.moments(contour)
        area = m["m00"]
        if not 0 < area < settings.max_area * mask.size:
            continue
        xx, xy, yy = m["mu20"] / area, m["mu11"] / area, m["mu02"] / area
        spread = xx * yy - xy * xy
        if not spread > (xx + yy) / 4:  # at most two pixels wide, with a variance of ¼ px²
            continue
        ratio = area / (4 * np.pi * np.sqrt(spread))
        if least is not None and not settings.ellipse_ratio[0] < ratio < settings.ellipse_ratio[1]:
            continue
        column, row = np.clip(contour[:, 0], 0, last_pixel).T
        steep = slope[row, column]
        mean = float(steep.mean())
        if least is not None and not (
            mean > least and steep.std() < settings.max_slope_scatter * mean
        ):
            continue
        # The contour of a hole runs through the bright pixels around a dark mark, half a pixel from
        # its edge, and that of a bright mark through the outermost pixels of the mark.
        hole = hierarchy[0, k, 3] >= 0
        wider = (1 + (-0.5 if hole else 0.5) / np.sqrt(area / np.pi)) ** 2
        moments = wider * np.array([[xx, xy], [xy, yy]])
        rows.append(((m["m10"] / area, m["m01"] / area), moments, wider * area, mean, hole))
    return np.array(rows, dtype=_CONTOUR)


def _strongest(rows: NDArray) -> Marks:
    """The contour with the steepest edge of those within half a radius of each other."""
    rows = rows[np.argsort(-rows["slope"], kind="stable")]
    centers, areas = rows["center"], rows["area"]
    chosen = np.ones(len(rows), dtype=bool)
    near = cKDTree(centers).query_ball_point(centers, np.sqrt(areas / np.pi) / 2)
    for k, close in enumerate(near):
        if chosen[k]:
            later = [j for j in close if j > k and 1 / 2 < areas[j] / areas[k] < 2]
            chosen[later] = False
    return Marks(centers[chosen], rows["moments"][chosen], areas[chosen])
