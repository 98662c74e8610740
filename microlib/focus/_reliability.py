"""Where a depth is not to be believed, on which side of a step it lies, and what stands instead.

All depths are in steps of the averaged frames, all lengths in pixels of the grid of every second
pixel. What each rule is worth stands in the table "stage left out" of benchmarks/focus.py.
"""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib.focus._measures import TINY, blur
from microlib.focus._settings import Settings


def isolated_mask(depth: NDArray, radius: float) -> NDArray[np.bool_]:
    """Tell where most of the surroundings have no depth: what is left was right by chance."""
    return blur(np.isfinite(depth).astype(np.float32), radius) < 0.5


def blurred_edge_mask(depth: NDArray, strength: NDArray, settings: Settings) -> NDArray[np.bool_]:
    """Tell where the peak is that of something brighter, out of focus.

    Blur carries the light of a strong edge into places without texture, where it is the largest
    change of all frames, but at the wrong depth. Peaks at that depth are faint, on average, beside
    those all around, whereas both sides of a step have strong ones.
    """
    level = np.nan_to_num(depth).astype(np.float32)
    mass = np.where(np.isfinite(depth), strength, 0).astype(np.float32)
    radius = settings.halo
    around = blur(mass, radius)
    apart = np.abs(level - blur(level * mass, radius) / np.maximum(around, TINY)) > 2
    faint, nearest = np.zeros(level.shape, bool), np.rint(level)
    for k in np.unique(nearest[apart]):
        near = (np.abs(level - k) <= 1).astype(np.float32)
        theirs, share = blur(near * mass, radius), blur(near, radius)
        faint |= (nearest == k) & (theirs < settings.faint * around * share)
    return faint & apart


def small_piece_mask(depth: NDArray, area: int, jump: float) -> NDArray[np.bool_]:
    """Tell which pixels are of a surface of their own, but of a few pixels only, or unknown."""
    # In 64ths of a step, which leaves 1023 steps to 16 bits; what lies higher is one surface.
    unknown, part = np.iinfo(np.int16).min, 64
    level = np.clip(part * (depth + 0.5) + unknown + 1, unknown + 1, -unknown - 1)
    level = np.where(np.isnan(depth), unknown, level).astype(np.int16)
    cv2.filterSpeckles(level, unknown, area, part * jump)
    return np.asarray(level == unknown)


def without_spikes(depth: NDArray, side: int = 3) -> NDArray:
    """Replace by the median what is too far from it."""
    median = cv2.medianBlur(depth, side)
    return np.where(np.abs(depth - median) > 1, median, depth)


def fill_nearest(depth: NDArray) -> NDArray:
    """Give unknown pixels the depth of the nearest known one; 0 if there is none."""
    unknown = np.isnan(depth)
    _, label = cv2.distanceTransformWithLabels(
        unknown.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.zeros(label.max() + 1, np.float32)
    table[label[~unknown]] = depth[~unknown]
    return table[label]


def choose_side(broad: NDArray, edge: NDArray, side: int, jump: float) -> tuple[NDArray, NDArray]:
    """Return each pixel's depth on its own side of a step, and how far the measures are apart.

    Next to a step the broad window sees the other side as well, and the better textured side
    wins. A few pixels away, on the pixel's own side, it does not: where the edge measure, steadied
    by medians of `side` px, differs from it by a jump, a neighbor's broad depth is taken that
    agrees to a step.
    """
    fine = np.asarray(cv2.medianBlur(edge, side))
    apart = np.abs(broad - fine)
    sure = cv2.medianBlur(np.abs(edge - fine), 5) < 1
    fine = np.asarray(cv2.medianBlur(fine, side))
    padded = np.pad(broad, 3, mode="symmetric")
    rows, cols = np.nonzero(sure & (np.abs(broad - fine) > jump))
    own, found = fine[rows, cols], broad[rows, cols]
    gap = np.abs(found - own)
    for distance in (1, 3):
        for dy, dx in product((-distance, 0, distance), repeat=2):
            there = padded[rows + 3 + dy, cols + 3 + dx]
            other = np.abs(there - own)
            better = (other < gap) & (other < 1)
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
    settings: Settings,
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
    known, side = np.isfinite(wide), settings.nearby
    steep, late = _wide_errors(wide, settings.wide)
    square = np.ones((side, side), np.uint8)
    low = cv2.erode(np.where(known, wide, np.float32(np.inf)), square)
    high = cv2.dilate(np.where(known, wide, np.float32(-np.inf)), square)

    def beyond(gap: float) -> NDArray[np.bool_]:
        return known & ((depth < low - late - gap) | (depth > high + late + gap))

    # The median passes over the edges of what is narrow, where the measures always differ.
    apart = cv2.medianBlur(np.minimum(disagreement, np.float32(3)), 5)
    mean = cv2.blur(apart, (side, side))
    erratic = mean > settings.erratic
    blurred = ~np.where(mean > settings.doubtful, sharp, finer)
    doubtful = beyond(1.2) | (erratic & beyond(settings.erratic_gap))
    instead = (steep < 0.5) & known & (np.isnan(depth) | (doubtful & blurred))
    neither = erratic & (beyond(settings.lone_gap) | ~known) & ~instead & ~sharp
    return instead, neither


def _wide_errors(wide: NDArray, reach: int) -> tuple[NDArray, NDArray]:
    """Return the steepest slope that a wide window sees, and how far it is off at the border.

    There it sees the inner side only, and is late on a slope. Every second pixel, a window of
    `reach` times every fourth sees as many px to either side.
    """
    down, along = np.gradient(np.nan_to_num(wide))
    steep = cv2.dilate(np.hypot(down, along), np.ones((2 * reach + 1,) * 2, np.uint8))
    inside = (np.minimum(np.arange(n), np.arange(n)[::-1]) for n in wide.shape)
    outer = np.maximum(reach - np.minimum.outer(*inside), 0).astype(np.float32)
    return steep, steep * (outer * outer / (2 * reach))
