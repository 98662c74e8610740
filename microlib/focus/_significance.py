"""Is a peak of focus more than noise? Decided by the profiles themselves, not by a model of noise.

Noise of a camera may be correlated over pixels, quantized, or sparse, as after JPEG compression.
Whatever it is, it changes independently in blocks that are a few pixels apart, whereas texture
gives neighboring blocks a peak in common.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib.focus._measures import TINY, halved

#: What `common_peak` of noise alone stays below in 98 % of the blocks: 1.8 of white, smoothed and
#: demosaiced noise, 2.5 after JPEG compression. And the peak of a measure over its mean.
_NOISE, _CONTRAST = 2.0, 2.5


def block_means(image: NDArray, times: int) -> NDArray[np.float32]:
    """Return the means of blocks of 2^times px; those of 8 px are as large as JPEG's."""
    for _ in range(times):
        image = halved(image)
    return image


def common_peak(profiles: NDArray) -> NDArray[np.float32]:
    """Return how far the peak that neighboring blocks share exceeds what they differ by.

    Parameters
    ----------
    profiles : ndarray of float32, shape (n, rows, cols)
        Focus measure of each frame, as means of blocks.

    Returns
    -------
    ndarray of float32, shape (rows, cols)
        Peak of the median profile of 5 by 5 blocks, less its mean, over the mean deviation of the
        blocks from it.
    """
    share = profiles / np.maximum(profiles.mean(axis=0), TINY)
    common = np.stack([cv2.medianBlur(frame, 5) for frame in share])
    scatter = cv2.blur(np.abs(share - common).mean(axis=0), (5, 5))
    return np.asarray((common.max(axis=0) - common.mean(axis=0)) / np.maximum(scatter, 0.02))


def judge_peaks(
    profiles: NDArray, top: NDArray, times: int
) -> tuple[NDArray[np.bool_], NDArray[np.float32], NDArray[np.bool_]]:
    """Return where peaks are no more than noise, what error that makes, and where texture is near.

    Parameters
    ----------
    profiles : ndarray of float32, shape (n, rows / 2^times, cols / 2^times)
        Focus measure of each frame, as means of blocks.
    top : ndarray, shape (rows, cols)
        Height of each pixel's peak.
    times : int
        Binary logarithm of the side of a block, px.

    Returns
    -------
    insignificant : ndarray of bool, shape (rows, cols)
    error : ndarray of float32, shape (rows, cols)
        Standard deviation of a depth that may be random, as a share of the scan.
    near : ndarray of bool, shape (rows, cols)
        Where a clear peak is at most three blocks away.
    """
    excess, sure = common_peak(profiles), _NOISE + 1
    # The contrast keeps flanks so steep that neighboring blocks have no depth in common.
    faint = block_means(top, times) < _CONTRAST * profiles.mean(axis=0)
    maps = (
        ((excess < _NOISE) & faint).astype(np.uint8),
        np.sqrt(np.clip(sure - excess, 0, 1) / 12),
        cv2.dilate(((excess > sure) | ~faint).astype(np.uint8), np.ones((7, 7), np.uint8)),
    )
    side = np.ones((2**times, 2**times), np.uint8)
    rows, cols = top.shape
    insignificant, error, near = (np.kron(blocks, side)[:rows, :cols] for blocks in maps)
    return insignificant > 0, error.astype(np.float32), near > 0
