"""Marks in a grey image: dark regions of an even ground, or closed even edges in clutter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from microlib._common import Array, as_image, as_region, luminance

#: Smallest image in which four marks can be seen, px.
_SMALLEST_IMAGE = 16
#: Standard deviation of the Gaussian that takes the noise off, px. From 0.5 to 2 the points' error
#: varies by 1 %, but 2 loses the smallest shapes.
_SMOOTHING = 1.0
#: Least number that is divided by.
_FLAT = 1e-9

# Dark regions of an even ground

#: Smaller regions are noise, px; 5 to 20 find the same shapes, 80 loses squares of 9 px.
_SMALLEST = 20
#: Regions of one pattern differ in area by less than this factor from the median; 2 to 8 find
#: the same shapes of patterns with dirt on them.
_ALIKE = 4.0

# Closed even edges

#: Levels at which contours are drawn: as many evenly spaced as by rank. A mark is found if one of
#: them separates it from its ground all round.
_LEVELS = 20
#: What Scharr's kernel makes of a gradient of one: its positive weights times two pixels.
_SCHARR = 32
#: Shortest contour of a mark of 5 px across, px; and its most area as a part of the image's.
_SHORTEST, _LARGEST = 14, 1 / 16
#: Fullness of an ellipse is 1, of a square 0.955; contours of few pixels come out a little beside.
_FULLNESS = (0.90, 1.02)
#: Most standard deviation of the gradient along an edge, as a part of its mean: noise, uneven
#: light and the pixels' raster make up to 0.35 of it.
_MOST_UNEVEN = 0.5
#: A mark is wider than two pixels: the second moment of these across is 4/16 px².
_THINNEST = 0.25
#: The mean gradient of an edge is so many standard deviations of the noise's: contours of noise
#: alone have up to 3.
_TOLD = 4.0
#: Median of the absolute values to standard deviation, for normal errors.
_TO_SIGMA = 1.4826
#: Contours are of one mark if their centers are this near, in radii.
_SAME = 0.5


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
    """

    image: NDArray[np.float32]
    smooth: NDArray[np.float32]
    centers: Array
    moments: Array
    areas: Array

    def __getitem__(self, index: NDArray | slice) -> Marks:
        """Some of the marks."""
        return replace(
            self, centers=self.centers[index], moments=self.moments[index], areas=self.areas[index]
        )


def to_grey(image: ArrayLike) -> NDArray[np.float32]:
    """Checked grey levels of an image, or the luminance of one in color."""
    grey = as_image("image", luminance("image", image), smallest=_SMALLEST_IMAGE)
    return np.ascontiguousarray(grey)


def crop(
    grey: NDArray[np.float32], region: tuple[int, int, int, int] | None
) -> tuple[NDArray[np.float32], NDArray]:
    """The part of the image to look at, and its first pixel (x, y)."""
    if region is None:
        return grey, np.zeros(2)
    x, y, width, height = as_region("region", region, grey.shape, least=_SMALLEST_IMAGE)
    return np.ascontiguousarray(grey[y : y + height, x : x + width]), np.array([x, y], dtype=float)


def dark_regions(grey: NDArray[np.float32]) -> Marks:
    """Dark regions of alike size, from one threshold of the whole image.

    Regions of less than a quarter or more than four times the median area are left out. Uneven
    light is left to `even_edges`.
    """
    smooth: NDArray = cv2.GaussianBlur(grey, (0, 0), _SMOOTHING)
    rows: Array = np.empty((0, 8))
    if np.ptp(smooth) > 0:
        from skimage.filters import threshold_otsu  # here, as it takes long to import

        rows = _at_level(smooth, _slope(smooth), threshold_otsu(smooth))
        rows = rows[(rows[:, 7] > 0) & (rows[:, 5] > _SMALLEST)]
        typical = np.median(rows[:, 5]) if len(rows) else 0.0
        rows = rows[(rows[:, 5] > typical / _ALIKE) & (rows[:, 5] < typical * _ALIKE)]
    return _strongest(rows, grey, smooth)


def _slope(smooth: NDArray) -> NDArray:
    """Gradient of the image, grey levels a pixel."""
    dx, dy = (cv2.Scharr(smooth, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    return np.hypot(dx, dy) / _SCHARR


def even_edges(grey: NDArray[np.float32]) -> list[Marks]:
    """Marks that one even edge surrounds: the dark ones, and the bright ones of the negative."""
    smooth: NDArray = cv2.GaussianBlur(grey, (0, 0), _SMOOTHING)
    slope = _slope(smooth)
    # The noise, by a mask that no plane or ridge answers, the squares of whose weights sum to 36,
    # and what it makes of the smoothed image's derivative.
    mask = np.array([[1.0, -2, 1], [-2, 4, -2], [1, -2, 1]])
    noise = float(np.median(np.abs(cv2.filter2D(grey, cv2.CV_32F, mask)))) * _TO_SIGMA / 6
    least = _TOLD * noise / (np.sqrt(8 * np.pi) * _SMOOTHING**2)
    low, high = np.percentile(smooth, [0.5, 99.5])
    ranks = np.percentile(smooth[::2, ::2], np.linspace(2, 98, _LEVELS))
    levels = np.unique(np.concatenate([np.linspace(low, high, _LEVELS + 2)[1:-1], ranks]))
    rows = np.concatenate([_at_level(smooth, slope, level, least) for level in levels])
    negative = (grey.max() + grey.min()) - grey
    dark = rows[:, 7] > 0
    return [
        _strongest(rows[dark], grey, smooth),
        _strongest(rows[~dark], negative, negative.max() - smooth),
    ]


def _at_level(smooth: NDArray, slope: NDArray, level: float, least: float | None = None) -> Array:
    """Contours of a level that may be marks: center, moments (3), area, mean gradient, and whether
    dark (1) or bright (0). With `least`, full ones with an even gradient of more than that."""
    # Around the image there is ground: a mark beside its border is a hole in that, too.
    mask = np.pad((smooth > level).astype(np.uint8), 1, constant_values=1)
    way = (cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    contours, hierarchy = cv2.findContours(mask, *way, offset=(-1, -1))
    limit = np.array(smooth.shape[::-1]) - 1
    rows = []
    for k, contour in enumerate(contours):
        if len(contour) < _SHORTEST:
            continue
        m = cv2.moments(contour)
        area = m["m00"]
        if not 0 < area < _LARGEST * mask.size:
            continue
        xx, xy, yy = m["mu20"] / area, m["mu11"] / area, m["mu02"] / area
        spread = xx * yy - xy * xy
        full = area / (4 * np.pi * np.sqrt(max(spread, _FLAT)))
        if not spread > _THINNEST * (xx + yy):
            continue
        if least is not None and not _FULLNESS[0] < full < _FULLNESS[1]:
            continue
        column, row = np.clip(contour[:, 0], 0, limit).T
        steep = slope[row, column]
        mean = float(steep.mean())
        if least is not None and not (mean > least and steep.std() < _MOST_UNEVEN * mean):
            continue
        # The contour of a hole runs through the bright pixels around a dark mark, half a pixel
        # beside its edge; that of a bright mark through its own outermost ones.
        hole = hierarchy[0, k, 3] >= 0
        wider = (1 + (-0.5 if hole else 0.5) / np.sqrt(area / np.pi)) ** 2
        moments = wider * np.array([xx, xy, yy, area])
        rows.append([m["m10"] / area, m["m01"] / area, *moments, mean, hole])
    return np.array(rows).reshape(-1, 8)


def _strongest(rows: Array, image: NDArray[np.float32], smooth: NDArray) -> Marks:
    """Of the contours of one mark the one with the steepest edge."""
    rows = rows[np.argsort(-rows[:, 6], kind="stable")]
    chosen = np.ones(len(rows), dtype=bool)
    if len(rows):
        near = cKDTree(rows[:, :2]).query_ball_point(
            rows[:, :2], _SAME * np.sqrt(rows[:, 5] / np.pi)
        )
        for k in range(len(rows)):
            if chosen[k]:
                later = [j for j in near[k] if j > k and 0.5 < rows[j, 5] / rows[k, 5] < 2]
                chosen[later] = False
    rows = rows[chosen]
    moments = rows[:, [2, 3, 3, 4]].reshape(-1, 2, 2)
    return Marks(image, smooth, rows[:, :2], moments, rows[:, 5])
