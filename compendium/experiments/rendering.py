"""Blur by a uniform disc and noise of a camera, for scenes of pages, benchmarks and tests."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def disc(radius: float) -> NDArray[np.float32]:
    """Return a disc of unit sum, its edge drawn eight times finer than a pixel."""
    side = 2 * int(np.ceil(radius)) + 3
    place = (np.arange(8 * side) + 0.5) / 8 - side / 2
    fine = (np.add.outer(place**2, place**2) <= radius**2).astype(np.float32)
    kernel = fine.reshape(side, 8, side, 8).mean(axis=(1, 3))
    return np.asarray(kernel / kernel.sum())


def disc_blur(image: NDArray, radius: float) -> NDArray:
    """Convolve an image with a disc; below 0.3 px the disc is within the pixel."""
    kernel = disc(max(radius, 0.3))
    return np.asarray(cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_REFLECT))


def blended(ladder: NDArray, blurs: NDArray, blur: NDArray) -> NDArray:
    """Return an image whose pixels have a blur each, from images that have one of `blurs` each.

    Beyond the first and the last of `blurs` the image keeps their blur.
    """
    k = np.clip(np.searchsorted(blurs, blur) - 1, 0, len(blurs) - 2)
    part = np.clip((blur - blurs[k]) / (blurs[k + 1] - blurs[k]), 0, 1).astype(ladder.dtype)
    below, above = (np.take_along_axis(ladder, k[None] + n, axis=0)[0] for n in (0, 1))
    return np.asarray(below * (1 - part) + above * part)


def expose(image: NDArray, rng: np.random.Generator, noise: float = 2.0) -> NDArray[np.uint8]:
    """Add noise and round to 8 bits."""
    noisy = image + noise * rng.standard_normal(image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
