"""Significance of a focus peak against noise, decided by the profiles themselves.

Noise of a camera may be correlated over pixels, quantized, or sparse, as after JPEG compression.
In any case it changes independently in blocks that are a few pixels apart, whereas texture gives
neighboring blocks a common peak. No model of the noise is needed.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib.focus.common._filters import TINY, halved

#: Limit that `common_peak` of noise alone stays below in 98 % of the blocks: 1.8 of white, smoothed
#: and demosaiced noise, 2.5 after JPEG compression. And the peak of a measure over its mean.
_NOISE, _CONTRAST = 2.0, 2.5


class Significance(NamedTuple):
    """Significance of the peaks of all pixels, each map of shape (rows, cols).

    Attributes
    ----------
    insignificant : ndarray of bool
        Whether a peak is no more than noise.
    random_error : ndarray of float32
        Standard deviation of a depth that may be random, as a share of the scan.
    near_texture : ndarray of bool
        Whether a clear peak is at most three blocks away.
    """

    insignificant: NDArray[np.bool_]
    random_error: NDArray[np.float32]
    near_texture: NDArray[np.bool_]


def common_peak(profiles: NDArray) -> NDArray[np.float32]:
    """Return the peak that neighboring blocks share over the deviation of their profiles.

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


def peak_significance(
    profiles: NDArray, height: NDArray, times: int, rounding: float = 0.0
) -> Significance:
    """Return the significance of every pixel's peak.

    Parameters
    ----------
    profiles : ndarray of float32, shape (n, rows / 2^times, cols / 2^times)
        Focus measure of each frame, as means of blocks.
    height : ndarray, shape (rows, cols)
        Height of each pixel's peak.
    times : int
        Binary logarithm of the side of a block, px.
    rounding : float
        Height of the peaks that the rounding of grey levels makes; neighboring blocks share them.
    """
    excess, clear, mean_height = common_peak(profiles), _NOISE + 1, halved(height, times)
    # The contrast keeps flanks so steep that neighboring blocks have no depth in common.
    faint = mean_height < np.maximum(_CONTRAST * profiles.mean(axis=0), rounding)
    excess[mean_height < rounding] = 0
    insignificant = ((excess < _NOISE) & faint).astype(np.uint8)
    error = np.sqrt(np.clip(clear - excess, 0, 1) / 12)
    near = cv2.dilate(((excess > clear) | ~faint).astype(np.uint8), np.ones((7, 7), np.uint8))
    side = np.ones((2**times, 2**times), np.uint8)
    rows, cols = height.shape
    full = [np.kron(blocks, side)[:rows, :cols] for blocks in (insignificant, error, near)]
    return Significance(full[0] > 0, full[1].astype(np.float32), full[2] > 0)
