"""Where a depth from focus is not to be believed, so that NaN is the better answer.

What each rule is worth, and what depends on its constants, stands in the tables "rule switched off"
and "constant changed" of benchmarks/focus.py.
"""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.focus._loops import fixed_point
from microlib.focus._measures import blur

#: Side of the medians that find incoherent frames, in every second pixel: its deviation from the
#: median then reaches further than the window of a measure, inside which even noise is alike.
_COHERENCE_WINDOW = 5
#: Frames by which half the neighbors must differ for a pixel's best frame to count as incoherent.
_INCOHERENT = 2
#: Radius over which a depth needs others around it, and the share of them that it needs, px and 1.
_SURROUNDINGS, _LEAST_KNOWN = 6.0, 0.5
#: Peak over the mean of the measure on noise, averaged over `_SURROUNDINGS`: this and the other
#: times ln n is 5 % above what 99.9 % of the pixels of n frames of noise stay below, simulated with
#: n from 12 to 300 and the noise as `noise_level` finds it.
_NOISE_PEAK, _NOISE_PEAK_GROWTH = 1.46, 0.113
#: Radius over which the blur of a strong edge outshines weak texture, in every second pixel.
_SPREAD = 5.0
#: Distance of a blurred edge's depth from that of the brighter ones around, and the half width of
#: what counts as one depth, frames.
_APART, _TOGETHER = 2.0, 1.0
#: Share of the peaks around that those of a blurred edge stay below.
_FAINT_EDGE = 0.2
#: Largest area that is no surface of its own, px, and the jump between surfaces, frames.
_SMALL_AREA, _COMPONENT_JUMP = 50, 1.5
#: Parts of a frame that a whole number counts: 64 leave 1023 frames to 16 bits, and what lies
#: higher counts as one surface.
_FIXED_POINT = 64


def incoherent_mask(index: NDArray[np.uint16], count: int) -> NDArray[np.bool_]:
    """Tell, of every second pixel, where the best frame differs at random from pixel to pixel."""
    coarse = index[::2, ::2]
    if count <= 256:
        coarse = coarse.astype(np.uint8)
    coarse = np.ascontiguousarray(coarse)
    deviation = cv2.absdiff(coarse, cv2.medianBlur(coarse, _COHERENCE_WINDOW))
    return np.asarray(cv2.medianBlur(deviation, _COHERENCE_WINDOW)) > _INCOHERENT


def set_to_nan(depth: NDArray, mask: NDArray[np.bool_]) -> None:
    """Make NaN of the pixels that the mask of every second one stands for, two by two."""
    for dy, dx in product((0, 1), repeat=2):
        part = depth[dy::2, dx::2]
        part[mask[: part.shape[0], : part.shape[1]]] = np.nan


def below_noise_mask(ratio: NDArray[np.float32], count: int) -> NDArray[np.bool_]:
    """Tell where the peak, over the mean of the measure on noise, is no higher than by noise alone.

    The limit is 1.8 with 21 frames and 2.1 with 300, where 99.9 % of the pixels of pure noise stay
    below 1.72 and 2.02.
    """
    return blur(ratio, _SURROUNDINGS) < _NOISE_PEAK + _NOISE_PEAK_GROWTH * np.log(count)


def blurred_edge_mask(depth: NDArray, inverse_variance: NDArray) -> NDArray[np.bool_]:
    """Tell, of every second pixel, where the peak is that of something brighter, out of focus.

    Blur carries the light of a strong edge into places without texture, where it is the largest
    change of all frames, but at the wrong depth. Peaks at that depth are faint, on average, beside
    those all around, whereas both sides of a step have strong ones. Depths are in frames.
    """
    coarse, weight = depth[::2, ::2], inverse_variance[::2, ::2]
    level = np.nan_to_num(coarse).astype(np.float32)
    strength = np.where(np.isfinite(coarse), weight, 0).astype(np.float32)
    around = blur(strength, _SPREAD)
    # The least positive weight that float32 divides by without overflow.
    mean = blur(level * strength, _SPREAD) / np.maximum(around, 1e-30)
    apart = np.abs(level - mean) > _APART
    faint = np.zeros(level.shape, bool)
    nearest = np.rint(level)
    for k in np.unique(nearest[apart]):
        near = (np.abs(level - k) <= _TOGETHER).astype(np.float32)
        share, theirs = blur(near, _SPREAD), blur(near * strength, _SPREAD)
        faint |= (nearest == k) & (theirs < _FAINT_EDGE * around * share)
    return faint & apart


def small_component_mask(depth: Array, least: float) -> NDArray[np.bool_]:
    """Tell which pixels are of a surface of their own, but of a few pixels only; depths in frames.

    No depth is half a frame below `least`. Unknown depths are among them.
    """
    unknown = -(2**15)
    level = np.empty(depth.shape, np.int16)
    fixed_point(depth, least - 0.5, _FIXED_POINT, level)
    cv2.filterSpeckles(level, unknown, _SMALL_AREA, _FIXED_POINT * _COMPONENT_JUMP)
    return level == unknown


def isolated_mask(depth: Array) -> NDArray[np.bool_]:
    """Tell where most of the surroundings have no depth: what is left was right by chance."""
    return blur(np.isfinite(depth).astype(np.float32), _SURROUNDINGS) < _LEAST_KNOWN
