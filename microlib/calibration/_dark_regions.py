"""Find dark shapes on a bright, unevenly lit ground: where the detectors start from."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from skimage.filters import threshold_otsu

from microlib._common import Array, as_image
from microlib.calibration._detection import FEWEST
from microlib.calibration._outline_fit import START_BLUR

#: Smaller components are noise, px; 5 to 20 find the same shapes, 80 loses squares
#: of 9 px.
_SMALLEST = 20
#: Standard deviation of the Gaussian that takes the noise off before thresholding, px.
#: From 0.5 to 2 the points' error varies by 1 %, but 2 loses the smallest shapes.
_SMOOTHING = 1.0
#: How often threshold and light are found in turn. With light that falls to a half in a corner,
#: 1 to 5 find the same shapes.
_ROUNDS = 3
#: Least light, as a part of the most: where the paraboloid comes out as zero or less, in a corner
#: without a bright pixel, nothing is divided by it.
_LEAST_LIGHT = 1e-3
#: The paraboloid is fitted to every fourth row and column, to save time; 1 to 16
#: find the same shapes.
_STRIDE = 4
#: Regions of one pattern differ in area by less than this factor from the median; 2 to 8 find
#: the same shapes of patterns with dirt on them.
_ALIKE = 4.0
#: Below this, px, an estimate of the blur is no better a start than the usual one.
_USUAL_BLUR = 2.0
#: Least gradient that is divided by, grey levels a pixel.
_FLAT = 1e-9


@dataclass(frozen=True)
class DarkRegions:
    """Connected dark regions of alike size.

    Parameters
    ----------
    image : ndarray of float32, shape (height, width)
        The image they were found in.
    smooth : ndarray of float32, shape (height, width)
        The image, blurred by one pixel and divided by the light on it.
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

    @property
    def fullness(self) -> Array:
        """Area over that of the ellipse with the same moments: 1 for any ellipse, 3/π for a
        parallelogram."""
        return self.areas / (4 * np.pi * np.sqrt(np.linalg.det(self.moments)))


def find_dark_regions(image: ArrayLike) -> DarkRegions:
    """Threshold the image against the light that falls on it and measure the dark regions.

    The light is a paraboloid fitted to the bright pixels. Regions of less than a quarter or more
    than four times the median area are left out.

    Parameters
    ----------
    image : array_like, shape (height, width)
        Grey levels.

    Returns
    -------
    DarkRegions

    Raises
    ------
    ValueError
        If `image` is not a finite grey image, has no contrast, or shows fewer than four dark
        regions.
    """
    image = as_image("image", image, smallest=16)
    if np.ptp(image) == 0:
        raise ValueError(f"image must show a pattern, got the one grey level {image[0, 0]:g}")
    smooth: NDArray = cv2.GaussianBlur(image, (0, 0), _SMOOTHING)
    for _ in range(_ROUNDS):
        threshold = threshold_otsu(smooth)
        light = _paraboloid(smooth, smooth > threshold)
        if not light.max() > 0:
            raise ValueError("image must show a pattern on a lit ground, got a dark one")
        smooth = smooth / np.maximum(light, _LEAST_LIGHT * light.max())
    mask = (smooth < threshold_otsu(smooth)).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    areas = stats[:, cv2.CC_STAT_AREA].astype(np.float64)
    areas[0] = 0  # the ground
    keep = areas >= _SMALLEST
    if keep.any():
        middle = np.median(areas[keep])
        keep &= (areas > middle / _ALIKE) & (areas < middle * _ALIKE)
    if keep.sum() < FEWEST:
        raise ValueError(f"image must show a pattern, got {int(keep.sum())} dark regions")
    centers, moments = _moments(labels, count)
    blur = start_blur(*_edge(smooth, keep[labels]))
    return DarkRegions(image, smooth, centers[keep], moments[keep], areas[keep], blur)


def _edge(smooth: NDArray, dark: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Contrast of the dark regions, and the gradients at some of their edges' pixels."""
    sample = np.s_[::_STRIDE, ::_STRIDE]
    contrast = np.median(smooth[sample][~dark[sample]]) - np.median(smooth[dark])
    edge = dark[1:-1:_STRIDE, 1:-1] & ~dark[1:-1:_STRIDE, 2:]
    row, column = np.nonzero(edge)
    row, column = 1 + _STRIDE * row, 1 + column
    dx = smooth[row, column + 1] - smooth[row, column - 1]
    dy = smooth[row + 1, column] - smooth[row - 1, column]
    return np.full(len(row), contrast), np.hypot(dx, dy) / 2


def start_blur(contrast: Array, steep: Array) -> float:
    """Blur with which to start the fits of marks, px.

    Parameters
    ----------
    contrast, steep : ndarray, shape (N,)
        Contrast of each mark and gradient at its edge, after the noise was smoothed away. A
        Gaussian edge of contrast C has the gradient C/(√(2π) blur).

    Returns
    -------
    float
        The usual one if the edges are not much softer.

    Examples
    --------
    >>> round(start_blur(np.array([100.0]), np.array([8.0])), 3)
    4.885
    """
    if len(contrast) == 0:
        return START_BLUR
    seen = float(np.median(contrast / np.maximum(steep, _FLAT))) / np.sqrt(2 * np.pi)
    blur = float(np.sqrt(max(seen**2 - _SMOOTHING**2, 0)))
    return blur if blur > _USUAL_BLUR else START_BLUR


def _paraboloid(image: NDArray[np.float32], bright: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Second-order surface through the bright pixels, from a sample of the rows and columns."""
    height, width = image.shape
    x, y = np.linspace(-1, 1, width), np.linspace(-1, 1, height)

    def basis(x: Array, y: Array) -> Array:
        return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)

    grid_x, grid_y = np.meshgrid(x[::_STRIDE], y[::_STRIDE])
    chosen = bright[::_STRIDE, ::_STRIDE]
    solution = np.linalg.lstsq(
        basis(grid_x[chosen], grid_y[chosen]), image[::_STRIDE, ::_STRIDE][chosen], rcond=None
    )[0]
    c0, cx, cy, cxx, cxy, cyy = solution
    y = y[:, None]
    return (c0 + cx * x + cy * y + cxx * x * x + cxy * x * y + cyy * y * y).astype(np.float32)


def _moments(labels: NDArray, count: int) -> tuple[Array, Array]:
    """Centroid and second central moments of each label."""
    row, column = np.nonzero(labels)
    label = labels[row, column]

    def total(values: NDArray) -> NDArray:
        return np.bincount(label, values, minlength=count)

    size = np.maximum(total(np.ones(len(label))), 1)
    x, y = total(column) / size, total(row) / size
    dx, dy = column - x[label], row - y[label]
    xx, xy, yy = total(dx * dx) / size, total(dx * dy) / size, total(dy * dy) / size
    # A pixel is a square, whose second moment is 1/12.
    moments = np.stack([xx, xy, xy, yy], axis=-1).reshape(-1, 2, 2) + np.eye(2) / 12
    return np.column_stack([x, y]), moments
