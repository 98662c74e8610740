"""Symmetry of focus curves about their peak: of a lens that moves, they are symmetric in 1/z only.

The blur of a lens that moves grows as |1/a − 1/b|, with the positions a and b measured from the
lens (the pole of 1/z). The middles of a focus curve at several heights (its bisector) show where
the lens is. They also give a depth that does not depend on the shape of the peak.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.focus.common._filters import TINY

#: Heights at which a focus curve is bisected, as shares of its peak above its minimum, and number
#: of bins into which the distance between two frames is divided.
_LEVELS, _PHASES = (0.5, 0.2), 5


@dataclass(frozen=True)
class Symmetry:
    """Coordinate along the optical axis in which focus curves are symmetric.

    Attributes
    ----------
    middle : float
        Position at which the coordinate is 0 and has the unit of the positions, µm.
    bend : float
        One over the distance from the lens to `middle`, 1/µm; 0 if focus curves are symmetric in
        the position itself.
    """

    middle: float = 0.0
    bend: float = 0.0

    def coordinate(self, z: NDArray) -> NDArray:
        """Return the coordinate of positions."""
        if not self.bend:
            return z
        # v²(1/v − 1/(v + away)) with the distance v = 1/bend from the lens to the middle.
        away = z - z.dtype.type(self.middle)
        return np.asarray(away / (1 + z.dtype.type(self.bend) * away))

    def slope(self, z: NDArray) -> NDArray:
        """Return the derivative of the coordinate."""
        away = z - z.dtype.type(self.middle)
        return np.asarray((1 + z.dtype.type(self.bend) * away) ** -2)

    def position(self, u: NDArray) -> NDArray:
        """Return the positions of coordinates."""
        if not self.bend:
            return u
        return np.asarray(u.dtype.type(self.middle) + u / (1 - u.dtype.type(self.bend) * u))


def find_symmetry(profiles: NDArray, positions: Array, spacing: float) -> tuple[Symmetry, Array]:
    """Return the coordinate in which focus curves are symmetric, and their centers, µm.

    Parameters
    ----------
    profiles : ndarray, shape (n, rows, cols)
        Focus measure of each frame.
    positions : ndarray, shape (n,)
        Position of each frame, µm.
    spacing : float
        Distance of the frames to which the peaks are fitted, µm. An asymmetry that moves the
        middles by less than 3 % of it is not distinguished from the bias of the frame positions.

    Returns
    -------
    symmetry : Symmetry
        With a bend of 0 if no asymmetry is significant.
    centers : ndarray, shape (rows, cols)
        Mean of the middles at all heights; NaN where the peak is below the median of
        all peaks, or cut off by the ends of the stack.
    """
    left, right = _crossings(profiles, positions)
    known = np.isfinite(left + right).all(axis=0)
    if known.sum() < 30:
        return Symmetry(), np.full(known.shape, np.nan)
    ends = np.stack([left[:, known], right[:, known]])
    found = Symmetry(float(np.median(ends)))
    steepest = 0.9 / np.abs(positions - found.middle).max()
    # Two such coordinates one after the other are one, whose bend is the sum: five Newton steps.
    for step in range(5):
        low, high = found.coordinate(ends)
        apart = np.subtract(*(low + high)[::-1]) / 2
        extra = apart / np.subtract(*((high - low) ** 2)[::-1]) * 4
        bend = float(np.median(extra))
        # Sampling and texture alone move the middles by up to 0.024, as often to either side; and
        # the error of a median, where neighbors are not independent.
        clear = abs(bend) / max(np.median(np.abs(extra - bend)), TINY)
        small = abs(np.median(apart)) * min(clear, 1) < 0.03 * spacing
        if step == 0 and (small or clear < 6 / np.sqrt(len(extra))):
            found = Symmetry()
            break
        bend = float(np.clip(found.bend + bend, -steepest, steepest))
        found = Symmetry(found.middle, bend)
    centers = np.full(known.shape, np.nan)
    centers[known] = found.position(found.coordinate(ends).mean(axis=(0, 1)))
    return found, centers


def _crossings(profiles: NDArray, positions: Array) -> tuple[Array, Array]:
    """Return where curves cross each level before and behind their peak; NaN where they do not."""
    low, top, best = profiles.min(axis=0), profiles.max(axis=0), profiles.argmax(axis=0)
    log = np.log(np.maximum(profiles, 1e-6 * np.maximum(top, TINY)))
    number = np.arange(len(positions)).reshape(-1, 1, 1)
    strong = (top > 0) & (top >= np.median(top))
    found = np.full((2, len(_LEVELS), *best.shape), np.nan)
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
            found[side, k][good] = positions[outer] + share * gap
    return found[0], found[1]


def shape_error(depth: NDArray, centers: NDArray, frames: Array) -> tuple[float, float]:
    """Return the bias of depths by the shape of the peaks: the same everywhere, and periodic.

    Asymmetry and the bias towards the frame positions (peak locking) move the peak of a curve
    against its center. The medians over pixels at equal distances from a frame contain both, and
    little noise.

    Parameters
    ----------
    depth, centers : ndarray, shape (rows, cols)
        Depths by a fit to the peak, and those of `find_symmetry`; NaN where unknown.
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
