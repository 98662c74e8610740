"""The blur by a uniform disc, for scenes of pages, benchmarks and tests."""

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
