"""Where a depth from focus is not to be believed, so that NaN is the better answer."""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib.focus._measures import blur

__all__ = ["forget", "is_alone", "is_blank", "is_chance", "is_outshone", "is_speck"]

#: Frames by which half the neighbours must differ for a pixel's best frame to count as chance.
_CHANCE = 2
#: Distance over which a depth needs others beside it, px.
_ALONE = 6.0
#: Distance over which the blur of a strong edge outshines weak texture, in every second pixel.
_SPREAD = 5.0
#: Largest area that is no surface of its own, px.
_SPECK = 50


def is_chance(index: NDArray[np.uint16], count: int) -> NDArray[np.bool_]:
    """Tell, of every second pixel, where the best frame differs from pixel to pixel: by chance.

    Every second pixel is enough, and its deviation from the median reaches further than the window
    of a measure, inside which even noise is alike.
    """
    coarse = index[::2, ::2]
    if count <= 256:
        coarse = coarse.astype(np.uint8)
    coarse = np.ascontiguousarray(coarse)
    deviation = cv2.absdiff(coarse, cv2.medianBlur(coarse, 5))
    return np.asarray(cv2.medianBlur(deviation, 5)) > _CHANCE


def forget(depth: NDArray, doubtful: NDArray[np.bool_]) -> None:
    """Make NaN of the pixels that the mask of every second one stands for, two by two."""
    for dy, dx in product((0, 1), repeat=2):
        part = depth[dy::2, dx::2]
        part[doubtful[: part.shape[0], : part.shape[1]]] = np.nan


def is_blank(ratio: NDArray[np.float32], count: int) -> NDArray[np.bool_]:
    """Tell where the peak, over the mean of the measure on noise, is no higher than by noise alone.

    Averaged over `_ALONE` px, 99.9 % of what the largest of `count` frames of noise reaches is
    less: 1.8 with 21 frames, 2.1 with 300.
    """
    return blur(ratio, _ALONE) < 1.46 + 0.113 * np.log(count)


def is_outshone(depth: NDArray, weight: NDArray) -> NDArray[np.bool_]:
    """Tell, of every second pixel, where the peak is that of something brighter, out of focus.

    Blur carries the light of a strong edge into places without texture, where it is the largest
    change of all frames, but at the wrong depth. Peaks at that depth are faint, on average, beside
    those all around, whereas both sides of a step have strong ones.
    """
    level = np.nan_to_num(depth[::2, ::2]).astype(np.float32)
    strength = np.where(np.isfinite(depth[::2, ::2]), weight[::2, ::2], 0).astype(np.float32)
    around = blur(strength, _SPREAD)
    apart = np.abs(level - blur(level * strength, _SPREAD) / np.maximum(around, 1e-30)) > 2
    faint = np.zeros(level.shape, bool)
    nearest = np.rint(level)
    for k in np.unique(nearest[apart]):
        near = (np.abs(level - k) <= 1).astype(np.float32)
        share, theirs = blur(near, _SPREAD), blur(near * strength, _SPREAD)
        faint |= (nearest == k) & (theirs < 0.2 * around * share)
    return faint & apart


def is_speck(depth: NDArray) -> NDArray[np.bool_]:
    """Tell which pixels are of a surface of their own, but of a few pixels only."""
    unknown = -(2**15)
    fine = np.where(np.isfinite(depth), 64 * (depth - np.fmin.reduce(depth, axis=None)), unknown)
    level = np.clip(fine, unknown, 2**15 - 1).astype(np.int16)
    cv2.filterSpeckles(level, unknown, _SPECK, 96)
    return level == unknown


def is_alone(depth: NDArray) -> NDArray[np.bool_]:
    """Tell where most of the surroundings have no depth: what is left was right by chance."""
    return blur(np.isfinite(depth).astype(np.float32), _ALONE) < 0.5
