"""Smoothing, halving and doubling of images, and their ratio."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

#: Least divisor: the focus measure of a black frame is 0.
TINY = np.float32(1e-30)


def blur(image: NDArray, sigma: float) -> NDArray:
    """Smooth by a Gaussian; beyond 1 px by two boxes of nearly its variance, which is faster."""
    if sigma <= 1:
        side = 2 * round(4 * sigma) - 1  # 3 to 7 px
        return np.asarray(cv2.GaussianBlur(image, (side, side), sigma))
    # A box of n px has the variance (n² − 1) / 12.
    side = 2 * round((np.sqrt(6 * sigma**2 + 1) - 1) / 2) + 1
    return np.asarray(cv2.blur(cv2.blur(image, (side, side)), (side, side)))


def ratio(numerator: NDArray, denominator: NDArray) -> NDArray:
    """Divide two maps; 0 where the denominator is no more than the rounding of its largest value.

    The sums of `blur` run along a row, so that they leave a rounding residue where all is 0.
    """
    floor = np.finfo(np.float32).eps * denominator.max()
    return np.divide(
        numerator, denominator, out=np.zeros_like(numerator), where=denominator > floor
    )


def halved(image: NDArray, times: int = 1) -> NDArray:
    """Return the means of blocks of 2^times px; an odd side is continued by its edge."""
    for _ in range(times):
        rows, cols = (n % 2 for n in image.shape)
        if rows or cols:
            image = cv2.copyMakeBorder(image, 0, rows, 0, cols, cv2.BORDER_REPLICATE)
        size = image.shape[1] // 2, image.shape[0] // 2
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    return image


def doubled(half: NDArray, shape: tuple[int, ...], how: int = cv2.INTER_LINEAR) -> NDArray:
    """Return an image of `shape` from one of half its sides, by default interpolated linearly."""
    full = cv2.resize(half, (2 * half.shape[1], 2 * half.shape[0]), interpolation=how)
    return np.asarray(full)[: shape[0], : shape[1]]
