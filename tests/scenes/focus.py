"""Focal stacks that the tests of focus share, and the error of a depth."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib import synthetic
from microlib.focus._measures import MEASURES

#: Every focus measure that has a name.
NAMES = ("multiscale", *MEASURES)


def stack_of(
    height: NDArray,
    positions: ArrayLike,
    *,
    texture: NDArray | None = None,
    noise: float = 2.0,
    seed: int = 0,
    rate: float = 1.0,
) -> NDArray[np.uint8]:
    """Return frames whose blur grows by `rate` px per µm, by default of a random texture."""
    rng = np.random.default_rng(seed)
    if texture is None:
        texture = synthetic.mixed_texture(height.shape, rng)
    return synthetic.focal_stack(texture, height, positions, blur_rate=rate, noise=noise, rng=rng)


def gaussian_blur(image: NDArray, sigma: float) -> NDArray:
    """Convolve an image with a Gaussian, which below 0.3 px is within the pixel."""
    return cv2.GaussianBlur(image, (0, 0), max(sigma, 0.3))


def disc_blur(image: NDArray, radius: float) -> NDArray:
    """Convolve an image with a uniform disc, drawn eight times finer than a pixel."""
    reach = int(np.ceil(radius)) + 1
    place = (np.arange(8 * (2 * reach + 1)) + 0.5) / 8 - reach - 0.5
    fine = (np.hypot(place[:, None], place) <= max(radius, 0.3)).astype(np.float32)
    kernel = cv2.resize(fine, (2 * reach + 1,) * 2, interpolation=cv2.INTER_AREA)
    return cv2.filter2D(image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT)


def defocused(
    texture: NDArray, blurs: NDArray, spread: Callable[[NDArray, float], NDArray]
) -> NDArray:
    """Return a frame for each map of blurs, interpolated between images that are blurred evenly."""
    levels = np.concatenate([np.arange(0, 3, 0.1), np.arange(3, blurs.max() + 1, 0.5)])
    ladder = np.array([spread(texture, level) for level in levels])
    below = np.searchsorted(levels, blurs, side="right") - 1
    part = (blurs - levels[below]) / (levels[below + 1] - levels[below])
    low, high = (np.take_along_axis(ladder, below + n, axis=0) for n in (0, 1))
    return low * (1 - part) + high * part


def inner(image: NDArray, border: int = 8) -> NDArray:
    return image[..., border:-border, border:-border]


def rms(error: NDArray) -> float:
    """Return the root mean square of an error that is known everywhere."""
    assert np.isfinite(error).all()
    return float(np.sqrt(np.mean(error**2)))
