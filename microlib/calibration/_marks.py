"""Marks in a grey image: dark regions of an even ground, or closed even edges in clutter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from microlib._common import Array, as_image, as_region, luminance
from microlib.calibration._settings import Settings

#: Median of the absolute values to standard deviation, for normal errors.
TO_SIGMA = 1.4826


@dataclass(frozen=True, eq=False)
class Marks:
    """Dark marks, or what may be some, in an image.

    Parameters
    ----------
    image : ndarray of float32, shape (height, width)
        The image they were found in.
    smooth : ndarray of float32, shape (height, width)
        The image, blurred by one pixel.
    centers : ndarray, shape (N, 2)
        Centroids (x, y), px.
    moments : ndarray, shape (N, 2, 2)
        Second central moments, px².
    areas : ndarray, shape (N,)
        Number of pixels.
    settings : Settings
        Those of the detection.
    """

    image: NDArray[np.float32]
    smooth: NDArray[np.float32]
    centers: Array
    moments: Array
    areas: Array
    settings: Settings

    def __getitem__(self, index: NDArray | slice) -> Marks:
        """Some of the marks."""
        return replace(
            self, centers=self.centers[index], moments=self.moments[index], areas=self.areas[index]
        )


def to_grey(image: ArrayLike) -> NDArray[np.float32]:
    """Checked grey levels of an image, or the luminance of one in color."""
    grey = as_image("image", luminance("image", image), smallest=16)
    return np.ascontiguousarray(grey)


def crop(
    grey: NDArray[np.float32], region: tuple[int, int, int, int] | None
) -> tuple[NDArray[np.float32], NDArray]:
    """The part of the image to look at, and its first pixel (x, y)."""
    if region is None:
        return grey, np.zeros(2)
    x, y, width, height = as_region("region", region, grey.shape, least=16)
    return np.ascontiguousarray(grey[y : y + height, x : x + width]), np.array([x, y], dtype=float)


def dark_regions(grey: NDArray[np.float32], settings: Settings) -> Marks:
    """Dark regions of alike size, from one threshold of the whole image.

    Regions of less than a quarter or more than four times the median area are left out. Uneven
    light is left to `even_edges`.
    """
    smooth: NDArray = cv2.GaussianBlur(grey, (0, 0), 1.0)
    rows: Array = np.empty((0, 8))
    if np.ptp(smooth) > 0:
        from skimage.filters import threshold_otsu  # here, as it takes long to import

        rows = _at_level(smooth, _slope(smooth), threshold_otsu(smooth), settings)
        rows = rows[rows[:, 7] > 0]
        typical = np.median(rows[:, 5]) if len(rows) else 0.0
        rows = rows[(rows[:, 5] > typical / 4) & (rows[:, 5] < typical * 4)]
    return _strongest(rows, grey, smooth, settings)


def _slope(smooth: NDArray) -> NDArray:
    """Gradient of the image, grey levels a pixel."""
    dx, dy = (cv2.Scharr(smooth, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    return np.hypot(dx, dy) / 32  # the kernel's positive weights times two pixels


def even_edges(grey: NDArray[np.float32], settings: Settings) -> list[Marks]:
    """Marks that one even edge surrounds: the dark ones, and the bright ones of the negative."""
    smooth: NDArray = cv2.GaussianBlur(grey, (0, 0), 1.0)
    slope = _slope(smooth)
    # The noise, by a mask that no plane or ridge answers, the squares of whose weights sum to 36,
    # and what it makes of the smoothed image's derivative.
    mask = np.array([[1.0, -2, 1], [-2, 4, -2], [1, -2, 1]])
    noise = float(np.median(np.abs(cv2.filter2D(grey, cv2.CV_32F, mask)))) * TO_SIGMA / 6
    least = 4 * noise / (np.sqrt(8 * np.pi))
    low, high = np.percentile(smooth, [0.5, 99.5])
    ranks = np.percentile(smooth[::2, ::2], np.linspace(2, 98, settings.levels))
    levels = np.unique(np.concatenate([np.linspace(low, high, settings.levels + 2)[1:-1], ranks]))
    rows = np.concatenate([_at_level(smooth, slope, level, settings, least) for level in levels])
    negative = (grey.max() + grey.min()) - grey
    dark = rows[:, 7] > 0
    return [
        _strongest(rows[dark], grey, smooth, settings),
        _strongest(rows[~dark], negative, negative.max() - smooth, settings),
    ]


def _at_level(
    smooth: NDArray, slope: NDArray, level: float, settings: Settings, least: float | None = None
) -> Array:
    """Contours of a level that may be marks: center, moments (3), area, mean gradient, and whether
    dark (1) or bright (0). With `least`, full ones with an even gradient of more than that."""
    # Around the image there is ground: a mark beside its border is a hole in that, too.
    mask = np.pad((smooth > level).astype(np.uint8), 1, constant_values=1)
    way = (cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    contours, hierarchy = cv2.findContours(mask, *way, offset=(-1, -1))
    limit = np.array(smooth.shape[::-1]) - 1
    rows = []
    for k, contour in enumerate(contours):
        if len(contour) < settings.shortest:
            continue
        m = cv2.moments(contour)
        area = m["m00"]
        if not 0 < area < mask.size / 4**2:
            continue
        xx, xy, yy = m["mu20"] / area, m["mu11"] / area, m["mu02"] / area
        spread = xx * yy - xy * xy
        if not spread > (xx + yy) / 4:  # no wider than two pixels, whose moment across is ¼ px²
            continue
        full = area / (4 * np.pi * np.sqrt(spread))
        if least is not None and not settings.fullness[0] < full < settings.fullness[1]:
            continue
        column, row = np.clip(contour[:, 0], 0, limit).T
        steep = slope[row, column]
        mean = float(steep.mean())
        # Noise, uneven light and the pixels' raster make the gradient uneven by up to 0.35.
        if least is not None and not (mean > least and steep.std() < mean / 2):
            continue
        # The contour of a hole runs through the bright pixels around a dark mark, half a pixel
        # beside its edge; that of a bright mark through its own outermost ones.
        hole = hierarchy[0, k, 3] >= 0
        wider = (1 + (-0.5 if hole else 0.5) / np.sqrt(area / np.pi)) ** 2
        moments = wider * np.array([xx, xy, yy, area])
        rows.append([m["m10"] / area, m["m01"] / area, *moments, mean, hole])
    return np.array(rows).reshape(-1, 8)


def _strongest(
    rows: Array, image: NDArray[np.float32], smooth: NDArray, settings: Settings
) -> Marks:
    """Of the contours of one mark, within half a radius, the one with the steepest edge."""
    rows = rows[np.argsort(-rows[:, 6], kind="stable")]
    chosen = np.ones(len(rows), dtype=bool)
    if len(rows):
        near = cKDTree(rows[:, :2]).query_ball_point(rows[:, :2], np.sqrt(rows[:, 5] / np.pi) / 2)
        for k in range(len(rows)):
            if chosen[k]:
                later = [j for j in near[k] if j > k and 0.5 < rows[j, 5] / rows[k, 5] < 2]
                chosen[later] = False
    rows = rows[chosen]
    moments = rows[:, [2, 3, 3, 4]].reshape(-1, 2, 2)
    return Marks(image, smooth, rows[:, :2], moments, rows[:, 5], settings)
