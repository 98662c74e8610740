"""Where a depth is not to be believed, on which side of a step it lies, and what stands instead.

All depths are in steps of the averaged frames, all lengths in pixels of the grid of every second
pixel. What each rule is worth stands in the table "rule switched off" of benchmarks/focus.py.
"""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib.focus._measures import blur

#: Side of the medians that find incoherent frames, wider than a measure's window, inside which even
#: noise is alike; frames by which half the neighbors must differ from them.
_COHERENCE_WINDOW, _INCOHERENT = 5, 2
#: Radius over which a depth needs others around it, and the share of them that it needs.
_SURROUNDINGS, _LEAST_KNOWN = 3.0, 0.5
#: Radius over which the blur of a strong edge outshines weak texture; distance of its depth from
#: that of the brighter peaks around; half the range of what counts as one depth; the share of the
#: peaks around that its own stay below.
_SPREAD, _APART, _TOGETHER, _FAINT_EDGE = 5.0, 2.0, 1.0, 0.2
#: Largest area that is no surface of its own, px, and the jump between surfaces, steps.
_SMALL_AREA, _PIECE_JUMP = 12, 1.5
#: Parts of a step that a whole number counts: 64 leave 1023 steps to 16 bits, and what lies higher
#: counts as one surface.
_FIXED_POINT = 64
#: Spread of the fine depth below which it is trusted, steps.
_SIDE_SPREAD = 1.0
#: Difference of fine and broad depth from which a pixel's own side is sought, and up to which a
#: neighbor agrees, steps; distances of the neighbors, px; how much better one must agree for each
#: px that it is further away.
_SIDE_GAP, _SIDE_AGREES, _SIDE_DISTANCES, _SIDE_SLOPE = 1.5, 1.0, (1, 3), 0.1
#: Distance from its median from which a depth is a spike, steps.
_SPIKE = 1.0
#: Slope of the wide depth that is a step, steps/px, and how far from one it is not taken.
_CLIFF, _NEAR_CLIFF = 0.5, 13
#: Side of the square in which the wide depth is looked for, and over which disagreement is
#: averaged; differences from which two depths are not the same, and for a depth that is erratic,
#: or erratic and without a substitute, steps.
_NEARBY, _GAP, _ERRATIC_GAP, _LONE_GAP = 11, 1.2, 0.4, 0.8
#: Mean distance of the depths by two measures from which on they may be of blurred light, and from
#: which on they have no peak in common, and the most that one pixel counts, steps. On narrow bars
#: 95 % of the pixels lie below 0.16, and 95 % of a real board's halos above 0.15.
_DOUBT, _ERRATIC, _MOST_DISAGREEMENT = 0.16, 0.3, 3.0
#: Further than any depth.
_FAR = np.float32(1e6)


def incoherent_mask(best: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Tell where the best frame differs at random from pixel to pixel."""
    off = cv2.absdiff(best, cv2.medianBlur(best, _COHERENCE_WINDOW))
    return np.asarray(cv2.medianBlur(off, _COHERENCE_WINDOW)) > _INCOHERENT


def unchanged_mask(rise: NDArray, chance: NDArray, count: int) -> NDArray[np.bool_]:
    """Tell where a peak is no higher than noise alone makes it around one and the same picture.

    The highest of n normal deviates lies no more than √(2 ln n) deviations above their mean, on
    average. One deviation more is not reached where both are averaged over a few pixels.

    Parameters
    ----------
    rise : ndarray, shape (rows, cols)
        Peak of the measure, less its mean over all frames.
    chance : ndarray, shape (rows, cols)
        Standard deviation that noise alone gives the measure.
    count : int
        Number of frames.
    """
    limit = np.sqrt(2 * np.log(count))
    return np.asarray(blur(rise, _SURROUNDINGS) <= limit * blur(chance, _SURROUNDINGS))


def isolated_mask(depth: NDArray) -> NDArray[np.bool_]:
    """Tell where most of the surroundings have no depth: what is left was right by chance."""
    return blur(np.isfinite(depth).astype(np.float32), _SURROUNDINGS) < _LEAST_KNOWN


def blurred_edge_mask(depth: NDArray, strength: NDArray) -> NDArray[np.bool_]:
    """Tell where the peak is that of something brighter, out of focus.

    Blur carries the light of a strong edge into places without texture, where it is the largest
    change of all frames, but at the wrong depth. Peaks at that depth are faint, on average, beside
    those all around, whereas both sides of a step have strong ones.
    """
    level = np.nan_to_num(depth).astype(np.float32)
    mass = np.where(np.isfinite(depth), strength, 0).astype(np.float32)
    around = blur(mass, _SPREAD)
    apart = np.abs(level - blur(level * mass, _SPREAD) / np.maximum(around, 1e-30)) > _APART
    faint, nearest = np.zeros(level.shape, bool), np.rint(level)
    for k in np.unique(nearest[apart]):
        near = (np.abs(level - k) <= _TOGETHER).astype(np.float32)
        theirs, share = blur(near * mass, _SPREAD), blur(near, _SPREAD)
        faint |= (nearest == k) & (theirs < _FAINT_EDGE * around * share)
    return faint & apart


def small_piece_mask(depth: NDArray) -> NDArray[np.bool_]:
    """Tell which pixels are of a surface of their own, but of a few pixels only, or unknown."""
    unknown = -(2**15)
    level = np.clip(_FIXED_POINT * (depth + 0.5) + unknown + 1, unknown + 1, 2**15 - 1)
    level = np.where(np.isnan(depth), unknown, level).astype(np.int16)
    cv2.filterSpeckles(level, unknown, _SMALL_AREA, _FIXED_POINT * _PIECE_JUMP)
    return np.asarray(level == unknown)


def without_spikes(depth: NDArray, side: int = 3) -> NDArray:
    """Replace by the median what is too far from it."""
    median = cv2.medianBlur(depth, side)
    return np.where(np.abs(depth - median) > _SPIKE, median, depth)


def fill_nearest(depth: NDArray) -> NDArray:
    """Give unknown pixels the depth of the nearest known one; 0 if there is none."""
    unknown = np.isnan(depth)
    if not unknown.any():
        return depth
    if unknown.all():
        return np.zeros_like(depth)
    _, label = cv2.distanceTransformWithLabels(
        unknown.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.zeros(label.max() + 1, np.float32)
    table[label[~unknown]] = depth[~unknown]
    return table[label]


def choose_side(broad: NDArray, edge: NDArray, side: int) -> tuple[NDArray, NDArray]:
    """Return each pixel's depth on its own side of a step, and how far the measures are apart.

    Next to a step the broad window sees the other side as well, and the better textured side
    wins. A few pixels away, on the pixel's own side, it does not: where the edge measure, steadied
    by medians of `side` px, differs from it, a neighbor's broad depth is taken that agrees.
    """
    fine = np.asarray(cv2.medianBlur(edge, side))
    apart = np.abs(broad - fine)
    sure = cv2.medianBlur(np.abs(edge - fine), 5) < _SIDE_SPREAD
    fine = np.asarray(cv2.medianBlur(fine, side))
    far = max(_SIDE_DISTANCES)
    padded = np.pad(broad, far, mode="symmetric")
    rows, cols = np.nonzero(sure & (np.abs(broad - fine) > _SIDE_GAP))
    own, found = fine[rows, cols], broad[rows, cols]
    gap = np.abs(found - own)
    for distance in _SIDE_DISTANCES:
        for dy, dx in product((-distance, 0, distance), repeat=2):
            there = padded[rows + far + dy, cols + far + dx]
            # Nearer neighbors first: what is further away must agree the better.
            other = np.abs(there - own) + np.float32(_SIDE_SLOPE * distance)
            better = (other < gap) & (other < _SIDE_AGREES)
            found, gap = np.where(better, there, found), np.where(better, other, gap)
    result = broad.copy()
    result[rows, cols] = found
    return result, apart


def check_wide(
    depth: NDArray,
    wide: NDArray,
    disagreement: NDArray,
    sharp: NDArray[np.bool_],
    finer: NDArray[np.bool_],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell where the depth by a wide window is the better one, and where neither is to be believed.

    Beside a strong edge its blur is the largest change of all frames, at a wrong depth. A wide
    window sees the edge itself and is right there, but wrong beside a step. On bare ground noise
    has the largest change in some frame or other, and the depths by two measures differ.

    Parameters
    ----------
    depth, wide : ndarray, shape (rows, cols)
        Both depths, NaN where unknown.
    disagreement : ndarray, shape (rows, cols)
        Distance of the depths by the default's two measures.
    sharp, finer : ndarray of bool, shape (rows, cols)
        Where there is fine detail that no blurred light has, for sure, and probably: the latter is
        enough where both measures agree.

    Returns
    -------
    instead, neither : ndarray of bool, shape (rows, cols)
    """
    known = np.isfinite(wide)
    square = np.ones((_NEARBY, _NEARBY), np.uint8)
    down, along = np.gradient(np.nan_to_num(wide))
    steep = cv2.dilate(np.hypot(down, along), np.ones((2 * _NEAR_CLIFF + 1,) * 2, np.uint8))
    plain = steep < _CLIFF
    low = cv2.erode(np.where(known, wide, _FAR), square)
    high = cv2.dilate(np.where(known, wide, -_FAR), square)
    # At the image's border the wide window sees the inner side only, and is late on a slope.
    inside = (np.minimum(np.arange(n), np.arange(n)[::-1]) for n in depth.shape)
    outer = np.maximum(_NEAR_CLIFF - np.minimum.outer(*inside), 0).astype(np.float32)
    late = steep * (outer * outer / (2 * _NEAR_CLIFF))

    def beyond(gap: float) -> NDArray[np.bool_]:
        return known & ((depth < low - late - gap) | (depth > high + late + gap))

    # The median passes over the edges of what is narrow, where the measures always differ.
    apart = cv2.medianBlur(np.minimum(disagreement, np.float32(_MOST_DISAGREEMENT)), 5)
    mean = cv2.blur(apart, (_NEARBY, _NEARBY))
    erratic = mean > _ERRATIC
    blurred = ~np.where(mean > _DOUBT, sharp, finer)
    doubtful = beyond(_GAP) | (erratic & beyond(_ERRATIC_GAP))
    instead = plain & known & (np.isnan(depth) | (doubtful & blurred))
    neither = erratic & (beyond(_LONE_GAP) | ~known) & ~instead & ~sharp
    return instead, neither
