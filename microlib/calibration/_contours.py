"""Find marks in clutter: closed contours of many grey levels that look like an even edge."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from microlib._common import Array
from microlib.calibration._dark_regions import DarkRegions, start_blur

#: Levels at which contours are drawn: as many evenly spaced as by rank. A mark is found if one of
#: them separates it from its ground all round.
_LEVELS = 20
#: Standard deviation of the Gaussian that takes the noise off, px.
_SMOOTHING = 1.0
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


def find_marks(image: NDArray[np.float32]) -> list[DarkRegions]:
    """Marks that one even edge surrounds: the dark ones, and the bright ones of the negative.

    Parameters
    ----------
    image : ndarray of float32, shape (height, width)
        Grey levels.

    Returns
    -------
    list of DarkRegions
        Two, of which either may hold no mark.
    """
    smooth: NDArray = cv2.GaussianBlur(image, (0, 0), _SMOOTHING)
    dx, dy = (cv2.Scharr(smooth, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    slope = np.hypot(dx, dy) / _SCHARR
    least = _TOLD * _noise_gradient(image)
    low, high = np.percentile(smooth, [0.5, 99.5])
    ranks = np.percentile(smooth[::2, ::2], np.linspace(2, 98, _LEVELS))
    levels = np.unique(np.concatenate([np.linspace(low, high, _LEVELS + 2)[1:-1], ranks]))
    rows = np.concatenate([_at_level(smooth, slope, level, least) for level in levels])
    negative = (image.max() + image.min()) - image
    dark = rows[:, 9] > 0
    return [
        _strongest(rows[dark], image, smooth),
        _strongest(rows[~dark], negative, negative.max() - smooth),
    ]


def _noise_gradient(image: NDArray[np.float32]) -> float:
    """Standard deviation of the smoothed image's derivative that noise alone makes, grey levels a
    pixel."""
    # A mask that no plane or ridge answers; the squares of its weights sum to 36.
    mask = np.array([[1.0, -2, 1], [-2, 4, -2], [1, -2, 1]])
    noise = float(np.median(np.abs(cv2.filter2D(image, cv2.CV_32F, mask)))) * _TO_SIGMA / 6
    return noise / (np.sqrt(8 * np.pi) * _SMOOTHING**2)


def _at_level(smooth: NDArray, slope: NDArray, level: float, least: float) -> Array:
    """Contours of a level that may be marks, their mean gradient more than `least`: center, moments
    (3), area, fullness, mean gradient, contrast, and whether dark (1) or bright (0)."""
    mask = (smooth > level).astype(np.uint8)
    contours, hierarchy = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    size = np.fromiter(map(len, contours), dtype=np.intp, count=len(contours))
    chosen = np.flatnonzero(size >= _SHORTEST)
    rows, outlines, kept = [], [], []
    for k in chosen.tolist():
        m = cv2.moments(contours[k])
        area = m["m00"]
        if not 0 < area < _LARGEST * mask.size:
            continue
        xx, xy, yy = m["mu20"] / area, m["mu11"] / area, m["mu02"] / area
        spread = xx * yy - xy * xy
        if not spread > _THINNEST * (xx + yy):
            continue
        full = area / (4 * np.pi * np.sqrt(spread))
        if _FULLNESS[0] < full < _FULLNESS[1]:
            rows.append([m["m10"] / area, m["m01"] / area, xx, xy, yy, area, full])
            outlines.append(contours[k][:, 0])
            kept.append(k)
    if not rows:
        return np.empty((0, 10))
    # The contour of a hole runs through the bright pixels around a dark mark.
    hole = hierarchy[0, kept, 3] >= 0
    count = size[kept]
    points = np.concatenate(outlines)
    steep = slope[points[:, 1], points[:, 0]]
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    mean = np.add.reduceat(steep, start) / count
    square = np.add.reduceat(steep**2, start) / count
    even = (square - mean**2 < (_MOST_UNEVEN * mean) ** 2) & (mean > least)
    table = np.array(rows)
    column, row = np.round(table[:, :2]).astype(int).T
    beside = 2 * np.abs(smooth[row, column] - level)
    return np.column_stack([table, mean, beside, hole])[even]


def _strongest(rows: Array, image: NDArray[np.float32], smooth: NDArray) -> DarkRegions:
    """Of the contours of one mark the one with the steepest edge."""
    rows = rows[np.argsort(-rows[:, 7], kind="stable")]
    radius = np.sqrt(rows[:, 5] / np.pi)
    taken = np.zeros(len(rows), dtype=bool)
    chosen = []
    if len(rows):
        tree = cKDTree(rows[:, :2])
        for k, near in enumerate(tree.query_ball_point(rows[:, :2], _SAME * radius)):
            if not taken[k]:
                chosen.append(k)
                alike = [j for j in near if 0.5 < rows[j, 5] / rows[k, 5] < 2]
                taken[alike] = True
    rows = rows[chosen]
    return DarkRegions(
        image,
        smooth,
        rows[:, :2],
        rows[:, [2, 3, 3, 4]].reshape(-1, 2, 2),
        rows[:, 5],
        start_blur(rows[:, 8], rows[:, 7]),
    )
