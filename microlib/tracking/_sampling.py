"""Resolutions of a frame, the patches that warps cut out of them, and their noise."""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from microlib._common import Array, Image, image_noise, saturation_level
from microlib.tracking._geometry import TINY

#: Lagrange's interpolation half-way between six equidistant samples, exact for quintic polynomials.
_HALF_SAMPLE = np.array([[3, -25, 150, 150, -25, 3]], np.float32) / 256

#: Fourth-order central difference, and the pixels that it needs on either side.
_DIFFERENCE, _MARGIN = np.array([[1, -8, 0, 8, -1]], np.float32) / 12, 2

#: OpenCV before version 5 rounds positions between pixels to 1/32 px. This matters only at the last
#: level, which is not smoothed: the error is there 0.008 instead of 0.004 px.
_ROUNDS_POSITIONS = int(cv2.__version__.split(".")[0]) < 5


class SearchFrame:
    """The part of a frame in which a template is searched; layers and noise are computed once.

    `noise` is the standard deviation of its noise, at least `least_noise`; pixels with a grey level
    of at least `saturation` count as saturated.
    """

    def __init__(self, image: Image, least_noise: float) -> None:
        self.image, self._layers, self._least_noise = image, [image], least_noise

    def layer(self, halvings: int) -> Image:
        """Return the image halved so many times; its pixels are the even ones of the one before."""
        while len(self._layers) <= halvings:
            self._layers.append(cv2.pyrDown(self._layers[-1]))
        return self._layers[halvings]

    @cached_property
    def noise(self) -> float:
        return max(image_noise(self.image), self._least_noise)

    @cached_property
    def saturation(self) -> float:
        return saturation_level(self.image, self.noise)


def half_pixel(image: Image) -> Image:
    """Return the image sampled every half pixel; the even samples are the image itself.

    Bilinear interpolation between these samples has an eighth of the phase error of bilinear
    interpolation between the pixels, which is what limits the accuracy of a tracker on fine
    texture.
    """
    fine = np.empty((2 * image.shape[0], 2 * image.shape[1]), np.float32)
    rows = np.empty((image.shape[0], fine.shape[1]), np.float32)
    rows[:, ::2] = image
    rows[:, 1::2] = cv2.filter2D(image, -1, _HALF_SAMPLE, anchor=(2, 0))
    fine[::2] = rows
    fine[1::2] = cv2.filter2D(rows, -1, _HALF_SAMPLE.T, anchor=(0, 2))
    return fine


def padding(smoothing: float) -> int:
    """Return the margin of a patch: three standard deviations, and two pixels for the gradient."""
    return int(np.ceil(3 * smoothing)) + _MARGIN


def sample(
    image: Image, warp: Array, size: tuple[int, int], *, exact: bool = False
) -> tuple[Image, NDArray[np.bool_]]:
    """Cut a patch out of an image, bilinearly.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        Grey levels.
    warp : ndarray, shape (3, 3)
        From px of the patch to those of the image.
    size : tuple of int
        Width and height of the patch.
    exact : bool
        Whether to interpolate at the exact position with any version of OpenCV.

    Returns
    -------
    patch : ndarray, shape (height, width)
        The patch. Beyond the image it repeats the nearest pixel of the image.
    inside : ndarray of bool, shape (height, width)
        Whether the image shows a pixel of the patch.
    """
    # Sums of columns and rows, because the threads of a matrix product would take longer.
    column, row = (np.arange(length, dtype=np.float32) for length in size)
    across, down, shift = warp.astype(np.float32).T[..., None, None]
    x, y, depth = across * column + (down * row[:, None] + shift)
    depth = np.maximum(depth, np.float32(TINY))
    x, y = x / depth, y / depth
    last_y, last_x = (float(length - 1) for length in image.shape)
    inside = (x >= 0) & (x <= last_x) & (y >= 0) & (y <= last_y)
    x, y = np.minimum(np.maximum(x, 0), last_x), np.minimum(np.maximum(y, 0), last_y)
    if exact and _ROUNDS_POSITIONS:
        return ndimage.map_coordinates(image, [y, x], order=1, mode="nearest"), inside
    return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), inside


def cut_out(
    image: Image,
    warp: Array,
    shape: tuple[int, int],
    smoothing: float,
    mask: Image | None = None,
) -> tuple[Image, Image, NDArray[np.bool_]]:
    """Return a patch, H×W, smoothed, its gradient (x, y), 2×HW, and where the image shows it.

    The warp begins at the first pixel of the padding. Smoothing in the template's frame, and not in
    the image, commutes with the warp. With a mask of the padded patch, the smoothing is that of the
    masked pixels only.
    """
    pad = padding(smoothing)
    patch, inside = sample(
        image, warp, (shape[1] + 2 * pad, shape[0] + 2 * pad), exact=smoothing == 0
    )
    if smoothing:
        size = (2 * (pad - _MARGIN) + 1,) * 2
        if mask is None:
            patch = cv2.GaussianBlur(patch, size, smoothing)
        else:
            share = np.maximum(cv2.GaussianBlur(mask, size, smoothing), np.float32(TINY))
            patch = cv2.GaussianBlur(patch * mask, size, smoothing) / share
    gradient = [cv2.filter2D(patch, -1, kernel) for kernel in (_DIFFERENCE, _DIFFERENCE.T)]
    grey, *slope, inside = (each[pad:-pad, pad:-pad] for each in (patch, *gradient, inside))
    return np.ascontiguousarray(grey), np.stack([each.ravel() for each in slope]), inside


def noise_gain(halvings: int, density: int, smoothing: float) -> float:
    """Return the standard deviation of unit white noise after halving, sampling and smoothing.

    Behind a Gaussian of variance v it is 1/√(4πv). Each halving adds a variance of 1 px², and
    linear interpolation one of a sixth of a squared sample.
    """
    variance = (4**halvings - 1) / 3 + 4**halvings * (smoothing**2 + 1 / (6 * density**2))
    return float(min(1.0, 1 / np.sqrt(4 * np.pi * variance)))
