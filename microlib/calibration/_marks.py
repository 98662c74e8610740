"""Marks in a grey image: dark regions of an even ground, or closed even edges in clutter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from microlib._common import Array, as_array, as_image, items, whole

#: Smallest image in which four marks can be seen, px.
_SMALLEST_IMAGE = 16
#: Luminance of red, green and blue, as frames that are read as grey have it.
_LUMINANCE = (0.299, 0.587, 0.114)
#: Standard deviation of the Gaussian that takes the noise off, px. From 0.5 to 2 the points' error
#: varies by 1 %, but 2 loses the smallest shapes.
_SMOOTHING = 1.0
#: Blur with which the fits of marks start unless their edges are much softer, px: less does no
#: harm, a start with 2.5 px may end in a wrong minimum.
START_BLUR, _USUAL_BLUR = 1.2, 2.0
#: Least gradient that is divided by, grey levels a pixel.
_FLAT = 1e-9

# Dark regions of an even ground

#: Smaller components are noise, px; 5 to 20 find the same shapes, 80 loses squares
#: of 9 px.
_SMALLEST = 20
#: Every so many rows and columns are asked for the grey level of the ground, to save time.
_STRIDE = 4
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
    blur : float
        Blur of their edges with which a fit may start, px.
    """

    image: NDArray[np.float32]
    smooth: NDArray[np.float32]
    centers: Array
    moments: Array
    areas: Array
    blur: float = START_BLUR

    def __getitem__(self, index: NDArray | slice) -> Marks:
        """Some of the marks."""
        return replace(
            self, centers=self.centers[index], moments=self.moments[index], areas=self.areas[index]
        )

    @property
    def fullness(self) -> Array:
        """Area over that of the ellipse with the same moments: 1 for any ellipse, 3/π for a
        parallelogram."""
        return self.areas / (4 * np.pi * np.sqrt(np.linalg.det(self.moments)))


def to_grey(image: ArrayLike) -> NDArray[np.float32]:
    """Checked grey levels of an image, or the luminance of one in color."""
    array = as_array("image", image, dtype=np.float32)
    if array.ndim == 3 and array.shape[2] in (3, 4):
        array = array[..., :3] @ np.array(_LUMINANCE, dtype=np.float32)
    return np.ascontiguousarray(as_image("image", array, smallest=_SMALLEST_IMAGE))


def crop(
    grey: NDArray[np.float32], region: tuple[int, int, int, int] | None
) -> tuple[NDArray[np.float32], NDArray]:
    """The part of the image to look at, and its first pixel (x, y)."""
    if region is None:
        return grey, np.zeros(2)
    x, y, width, height = (
        whole("region", n, least=least)
        for n, least in zip(
            items("region", region, 4), (0, 0, _SMALLEST_IMAGE, _SMALLEST_IMAGE), strict=True
        )
    )
    if x + width > grey.shape[1] or y + height > grey.shape[0]:
        raise ValueError(
            f"region must lie in the image of {grey.shape[1]}×{grey.shape[0]} px, got {region}"
        )
    return np.ascontiguousarray(grey[y : y + height, x : x + width]), np.array([x, y], float)


def dark_regions(grey: NDArray[np.float32]) -> Marks:
    """Connected dark regions of alike size, from one threshold of the whole image.

    Regions of less than a quarter or more than four times the median area are left out. Uneven
    light is left to `even_edges`.
    """
    smooth: NDArray = cv2.GaussianBlur(grey, (0, 0), _SMOOTHING)
    if not np.ptp(smooth) > 0:
        return _strongest(np.empty((0, 10)), grey, smooth)
    from skimage.filters import threshold_otsu  # here, as it takes long to import

    mask = (smooth < threshold_otsu(smooth)).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    areas = stats[:, cv2.CC_STAT_AREA].astype(np.float64)
    areas[0] = 0  # the ground
    keep = areas >= _SMALLEST
    if keep.any():
        middle = np.median(areas[keep])
        keep &= (areas > middle / _ALIKE) & (areas < middle * _ALIKE)
    row, column = np.nonzero(labels)
    label = labels[row, column]

    def mean(values: NDArray) -> NDArray:
        return np.bincount(label, values, minlength=count) / np.maximum(stats[:, 4], 1)

    x, y = mean(column), mean(row)
    dx, dy = column - x[label], row - y[label]
    # A pixel is a square, whose second moment is 1/12.
    moments = np.stack([mean(dx * dx), mean(dx * dy), mean(dx * dy), mean(dy * dy)], axis=-1)
    moments = moments.reshape(-1, 2, 2) + np.eye(2) / 12
    dark = keep[labels]
    rim = cv2.morphologyEx(dark.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    blur = START_BLUR
    if rim.any():
        sample = np.s_[::_STRIDE, ::_STRIDE]
        contrast = np.median(smooth[sample][~dark[sample]]) - np.median(smooth[dark])
        blur = _start_blur(contrast, _slope(smooth)[rim])
    return Marks(grey, smooth, np.column_stack([x, y])[keep], moments[keep], areas[keep], blur)


def _slope(smooth: NDArray) -> NDArray:
    """Gradient of the image, grey levels a pixel."""
    dx, dy = (cv2.Scharr(smooth, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    return np.hypot(dx, dy) / _SCHARR


def _start_blur(contrast: Array, steep: Array) -> float:
    """Blur with which to start the fits: a Gaussian edge of contrast C has the gradient C/(√(2π)
    blur), of which a part is the smoothing's."""
    seen = float(np.median(contrast / np.maximum(steep, _FLAT))) / np.sqrt(2 * np.pi)
    blur = float(np.sqrt(max(seen**2 - _SMOOTHING**2, 0)))
    return blur if blur > _USUAL_BLUR else START_BLUR


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
    dark = rows[:, 9] > 0
    return [
        _strongest(rows[dark], grey, smooth),
        _strongest(rows[~dark], negative, negative.max() - smooth),
    ]


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


def _strongest(rows: Array, image: NDArray[np.float32], smooth: NDArray) -> Marks:
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
    return Marks(
        image,
        smooth,
        rows[:, :2],
        rows[:, [2, 3, 3, 4]].reshape(-1, 2, 2),
        rows[:, 5],
        _start_blur(rows[:, 8], rows[:, 7]) if len(rows) else START_BLUR,
    )
