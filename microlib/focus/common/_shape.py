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

#: Heights of which the midpoints are taken, as shares of the peak above the minimum.
_LEVELS = (0.5, 0.2)


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


def shape_error(depth: NDArray, centers: NDArray) -> float:
    """Return the size of the median bias of depths by the shape of the peaks.

    Parameters
    ----------
    depth, centers : ndarray, shape (rows, cols)
        Depths by a fit to the peak, and those of `peak_centers` in the same unit; NaN where
        unknown. The bias is 0 if fewer than 30 pixels are known.
    """
    difference = depth - centers
    known = np.isfinite(difference)
    return float(np.abs(np.median(difference[known]))) if known.sum() >= 30 else 0.0
