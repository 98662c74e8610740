"""Bias of depths by the shape of focus peaks.

A Gaussian that is fitted to an asymmetric focus curve, such as that of a lens that moves instead of
the object, has its vertex beside the focus. The midpoints of the curve at two heights show by how
much.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.focus.common._filters import TINY

#: Heights of which the midpoints are taken, as shares of the peak above the minimum, and number of
#: bins into which the distance between two frames is divided.
_LEVELS, _PHASES = (0.5, 0.2), 5


def peak_centers(profiles: NDArray, positions: Array) -> tuple[Array, Array]:
    """Return the midpoints of focus curves at half of their height, and at the peak, µm.

    The midpoint of a curve moves in proportion to the square of its width, as that of a lens that
    moves does to first order. The midpoint at the peak follows from two heights.

    Parameters
    ----------
    profiles : ndarray, shape (n, rows, cols)
        Focus measure of each frame.
    positions : ndarray, shape (n,)
        Position of each frame, µm.

    Returns
    -------
    at_half, at_peak : ndarray, shape (rows, cols)
        NaN where the peak is below the median of all peaks, or cut off by the ends of the stack.
    """
    low, top, best = profiles.min(axis=0), profiles.max(axis=0), profiles.argmax(axis=0)
    log = np.log(np.maximum(profiles, 1e-6 * np.maximum(top, TINY)))
    number = np.arange(len(positions)).reshape(-1, 1, 1)
    strong = (top > 0) & (top >= np.median(top))
    crossings = np.full((2, len(_LEVELS), *best.shape), np.nan)  # before and behind the peak
    for k, height in enumerate(_LEVELS):
        level = np.log(np.maximum(low + height * (top - low), TINY))
        below = log < level
        last = np.where(below & (number < best), number, -1).max(axis=0)
        first = np.where(below & (number > best), number, len(positions)).min(axis=0)
        good = strong & (last >= 0) & (first < len(positions))
        pixels = np.nonzero(good)
        for side, outer, inner in ((0, last[good], 1), (1, first[good], -1)):
            outside, inside = log[(outer, *pixels)], log[(outer + inner, *pixels)]
            share = (level[good] - outside) / (inside - outside)
            gap = positions[outer + inner] - positions[outer]
            crossings[side, k][good] = positions[outer] + share * gap
    middle, square = crossings.mean(axis=0), (crossings[1] - crossings[0]) ** 2
    slope = (middle[1] - middle[0]) / (square[1] - square[0])
    return middle[0], np.asarray(middle[0] - slope * square[0])


def shape_error(depth: NDArray, centers: NDArray, frames: Array) -> tuple[float, float]:
    """Return the bias of depths by the shape of the peaks: the same everywhere, and periodic.

    Asymmetry and the bias towards the frame positions (peak locking) move the peak of a curve
    against its center. The medians over pixels at equal distances from a frame contain both, and
    little noise.

    Parameters
    ----------
    depth, centers : ndarray, shape (rows, cols)
        Depths by a fit to the peak, and those of `peak_centers`; NaN where unknown.
    frames : ndarray, shape (n,)
        Positions of the frames to which the peaks were fitted, rising, in the same unit.

    Returns
    -------
    constant, periodic : float
        Size of the median bias, and the median size of what changes between two frames; 0, 0 if
        fewer than 30 pixels are known.
    """
    known = np.isfinite(depth + centers)
    difference = (depth - centers)[known]
    if len(difference) < 30:
        return 0.0, 0.0
    phase = (_PHASES * np.interp(centers[known], frames, np.arange(len(frames)))).astype(int)
    constant, size = np.median(difference), np.zeros(len(difference))
    for k in range(_PHASES):
        here = phase % _PHASES == k
        if here.any():
            part = difference[here]
            median = np.median(part)
            noise = 2.6 * np.median(np.abs(part - median)) / np.sqrt(len(part))
            size[here] = np.sqrt(max((median - constant) ** 2 - noise**2, 0))
    return float(np.abs(constant)), float(np.median(size))
