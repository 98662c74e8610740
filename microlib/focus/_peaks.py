"""From the measures around each pixel's best frame to its depth: (3.13), and a fit to more frames.

The logarithm of the measure is fitted by a parabola, because Gaussian blur makes the measure of a
pixel nearly a Gaussian of the distance from focus, (3.9).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, as_array, scalar
from microlib.focus._measures import MOST, TINY

#: One over the least distance of two positions, µm.
FARTHEST = 1e12
#: Pixels that are fitted at a time: their windows stay in the processor's cache.
_BAND = 16384


def check_positions(
    positions: ArrayLike | None,
    spacing: float | None = None,
    count: int = 0,
    told: ArrayLike | None = None,
) -> Array:
    """Return the positions of all frames, µm: those given, evenly spaced, or as the frames told."""
    if spacing is not None:
        if positions is not None:
            raise ValueError("positions and spacing must not both be given")
        positions = scalar("spacing", spacing) * np.arange(count)
    positions = told if positions is None else positions
    if positions is None:
        raise ValueError(
            "positions or spacing must be given, got None and frames that do not tell theirs"
        )
    z = as_array("positions", positions, shape=(None,))
    if not 3 <= len(z) <= MOST:
        raise ValueError(f"positions must be at least three, at most {MOST}, got {len(z)}")
    for at in np.flatnonzero(np.diff(z) * np.sign(z[-1] - z[0]) < 1 / FARTHEST):
        raise ValueError(
            f"positions must rise or fall strictly, got {z[at]:g} followed by {z[at + 1]:g}"
        )
    return z


def check_count(got: int | str, count: int) -> None:
    """Raise an error if there are not as many frames as positions."""
    if got != count:
        raise ValueError(f"frames and positions must be as many, got {got} and {count}")


def three_point_peak(window: NDArray, index: NDArray, positions: Array) -> NDArray[np.float32]:
    """Return the depth at the vertex of the Gaussian through the best frame and its two neighbors.

    Parameters
    ----------
    window : ndarray, shape (3, rows, cols)
        Measures of the best frame, in the middle, and of its neighbors.
    index : ndarray of int, shape (rows, cols)
        Number of the best frame.
    positions : ndarray of float64, shape (n,)
        Position of each frame, µm, rising or falling.

    Returns
    -------
    ndarray of float32, shape (rows, cols)
        Depth, µm. NaN where the three measures are equal or zero; the position of the frame itself
        where the best is the first or the last, and NaN if its one neighbor is not below it.

    Raises
    ------
    ValueError
        If the arrays are not of these shapes, a measure is negative or not finite, positions do
        not rise or fall strictly, or the index is none of theirs.

    Notes
    -----
    This is (3.13) with the positions taken relative to the best frame: subtracting the squares of
    absolute positions, as it is printed, loses digits. Spacings may be uneven.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.focus import three_point_peak
    >>> profile = np.exp(-((np.arange(5.0) - 2.25) ** 2))
    >>> window, index = profile[1:4, None, None], np.full((1, 1), 2)
    >>> depth = three_point_peak(window, index, 10 * np.arange(5.0))
    >>> round(float(depth[0, 0]), 4)
    22.5
    """
    z = check_positions(positions)
    as_array("index", index)  # refuses masks, and rows of several lengths
    index = np.asarray(index)
    if index.dtype.kind not in "ui" or index.size == 0:
        raise ValueError(f"index must hold whole numbers, got {index.dtype} of {index.shape}")
    if index.max() >= len(z) or index.min() < 0:
        raise ValueError(f"index must hold numbers of the {len(z)} positions, got {index.max()}")
    values = as_array("window", window, shape=(3, *index.shape))
    if values.min() < 0:
        raise ValueError(f"window must hold measures of zero or more, got {values.min():g}")
    gaps = np.diff(z)
    before = -np.append(np.inf, gaps)[index]
    after = np.append(gaps, np.inf)[index]
    # The logarithm is of a share: a difference of logarithms would lose digits.
    first, best, third = values
    with np.errstate(divide="ignore", invalid="ignore"):
        left = np.log(np.maximum(first / best, TINY)) / before
        right = np.log(np.maximum(third / best, TINY)) / after
        curvature = (right - left) / (after - before)
        shift = (before - left / curvature) / 2
    ends = (index == 0) | (index == len(z) - 1)
    beside = np.where(index == 0, third, first)
    depth = z[index] + np.where(ends, 0, np.where(np.isfinite(shift), shift, np.nan))
    known = (best > 0) & (~ends | (best > beside))
    return np.where(known, depth, np.nan).astype(np.float32)


def fit_peaks(
    window: NDArray[np.float32],
    best: NDArray[np.unsignedinteger],
    steps: Array,
    *,
    near: NDArray[np.float32] | None = None,
    within: float = 0.0,
    beyond: float = 0.0,
    narrow: float = 1.0,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Fit a Gaussian to all frames of each pixel's window; return its depth, and how sure it is.

    Parameters
    ----------
    window : ndarray of float32, shape (2 reach + 1, rows, cols)
        Measures of the best frame, in the middle, and of its neighbors; 0 beyond the stack.
    best : ndarray of int, shape (rows, cols)
        Number of the best frame.
    steps : ndarray, shape (n,)
        Position of each frame, rising.
    near : ndarray of float32, shape (rows, cols), optional
        A depth around which the peak is sought, instead of around the best frame.
    within : float
        How far from there.
    beyond : float
        How far the stack goes on before the first position and behind the last.
    narrow : float
        Factor by which the frames' weights fall off sooner.

    Returns
    -------
    depth : ndarray of float32, shape (rows, cols)
        In the unit of the steps. NaN where the measure is flat, or its logarithm opens upwards and
        the best frame is not the first or the last, whose position is taken then. A vertex beyond
        the neighboring frames or outside of the stack is put there.
    strength : ndarray of float32, shape (rows, cols)
        Inverse variance of the depth, up to a common factor: height times sharpness of the peak.

    Notes
    -----
    Frames are weighted with a power of their measure, because the logarithm of a small one is
    uncertain, and with the square of an inverted parabola centered on the peak. The measure itself
    pulls the depths of fine texture towards the frames, by up to 0.018 of a frame, its power 3/4 by
    0.010. Around a given depth it is the measure itself, which is the better weight for relief.
    Real profiles have longer tails than a Gaussian: a window that is not centered leans on one of
    them. The peak is only known after a first fit, so there are two. Near the ends of the stack the
    window is narrower for the same reason, to no less than three frames.
    """
    table = _table(steps, len(window) // 2, beyond)
    table[3] *= narrow
    rows, cols = best.shape
    depth, strength = np.empty((2, rows, cols), np.float32)
    band = max(1, _BAND // cols)
    for top in range(0, rows, band):
        here = slice(top, top + band)
        samples = window[:, here].reshape(len(window), -1)
        place = None if near is None else near[here].ravel()
        found = _fit(samples, best[here].ravel(), table, place, within)
        depth[here], strength[here] = (part.reshape(-1, cols) for part in found)
    return depth, strength


def _table(steps: Array, reach: int, beyond: float) -> NDArray[np.float32]:
    """Return what a fit needs to know of the frames around each, a column for each frame.

    Its rows are the frame's position; from there the least and the greatest vertex; one over half
    the width of the window; and the positions of the window's frames from there, where those beyond
    the stack have no weight, as their measure is 0.
    """
    count = len(steps)
    number = np.arange(count)
    around = np.clip(number + np.arange(-reach, reach + 1)[:, None], 0, count - 1)
    offset = steps[around] - steps
    least, most = offset[reach - 1].copy(), offset[reach + 1].copy()
    near = np.maximum(-least, most)
    least[0], most[-1] = -beyond, beyond
    # The fit looks equally far to both sides, as far as there are frames on the shorter one. At an
    # end there is but one side, and two frames on it make up the least three.
    far = np.minimum(np.minimum(number, count - 1 - number), reach)
    far[far == 0] = 2
    before, after = (steps[np.clip(number + s * far, 0, count - 1)] - steps for s in (-1, 1))
    # The window moves to the vertex, which is half a frame away at most, or a whole one at an end
    # of the stack: no frame of three may lose its weight by that.
    width = np.maximum(-before, after) + np.where(far > 1, 0.5, 1.0) * near
    return np.vstack([steps, least, most, 1 / width, offset]).astype(np.float32)


def _fit(
    window: NDArray[np.float32],
    best: NDArray[np.unsignedinteger],
    table: NDArray[np.float32],
    near: NDArray[np.float32] | None,
    within: float,
) -> tuple[NDArray, NDArray]:
    """Do the work of `fit_peaks` on a band of pixels, window of shape (2 reach + 1, pixels)."""
    top, last = window[len(window) // 2], table.shape[1] - 1
    found = np.take(table, best, axis=1)
    (place, least, most, narrow), offset = found[:4], found[4:]
    share = window / np.maximum(top, TINY)
    log = cv2.log(np.maximum(share, 1e-6))
    center = np.zeros_like(place)
    if near is None:
        share = np.asarray(cv2.sqrt(share * cv2.sqrt(share)))
    else:
        # From the place of the best frame; never outside of the stack.
        center = near - place
        steps, before, after = table[:3]
        first, final = before[0] - place, steps[last] + after[last] - place
        least = np.maximum(center - np.float32(within), first)
        most = np.maximum(np.minimum(center + np.float32(within), final), least)
    with np.errstate(all="ignore"):
        for _ in range(2):
            weight = np.maximum(1 - ((offset - center) * narrow) ** 2, 0)
            weight *= weight
            weight *= share
            vertex, curvature = _parabola(weight, offset, log)
            center = np.clip(vertex, least, most)
        there = (top > 0) & (log.min(axis=0) < -1e-3)
        good = there & (curvature < 0) & np.isfinite(center)
        end = there & ((best == 0) | (best == last))
        depth = np.where(good, place + center, np.where(end, place, np.float32(np.nan)))
        return depth, np.where(good, -curvature * top, np.float32(0))


def _parabola(weight: NDArray, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
    """Return the vertex and the leading coefficient of the weighted parabola through each column.

    Its terms are made orthogonal one after the other: 1, then x less its mean, then the square of
    that less its own mean and slope.
    """
    total = weight.sum(axis=0)
    mean = np.einsum("ij,ij->j", weight, x) / total
    away = x - mean
    first = weight * away
    second = first * away
    variance = second.sum(axis=0)
    # Slope and mean of the square, (x − mean)².
    slope = np.einsum("ij,ij->j", second, away) / variance
    level = variance / total
    fourth = np.einsum("ij,ij,ij->j", second, away, away)
    norm = fourth - variance * (slope * slope + level)
    y0, y1, y2 = (np.einsum("ij,ij->j", part, y) for part in (weight, first, second))
    curvature = (y2 - slope * y1 - level * y0) / norm
    curvature[~(norm * total > 1e-6 * variance * variance)] = 0
    return mean + (slope - y1 / (variance * curvature)) / 2, curvature


class PeakFollower:
    """Measures of all frames of a part of the image, and the frame of the highest one.

    Parameters
    ----------
    count, kinds : int
        Number of frames, and of measures for each; the first of them decides.
    shape : tuple of int
        Rows and columns.
    reach : int
        How many frames to either side of the best one are wanted.
    """

    def __init__(self, count: int, kinds: int, shape: tuple[int, int], reach: int) -> None:
        self._reach = reach
        self._measures = np.zeros((kinds, count + 2 * reach, *shape), np.float32)
        self.top, self.best = np.zeros(shape, np.float32), np.zeros(shape, np.uint16)

    def slot(self, k: int) -> NDArray[np.float32]:
        """Return where the measures of frame k are to be written, shape (kinds, rows, cols)."""
        return self._measures[:, k + self._reach]

    def push(self, k: int, allowed: NDArray[np.bool_] | None = None) -> None:
        """Take the written measures of frame k into account, where that is allowed."""
        value = self.slot(k)[0]
        if allowed is not None:
            value = np.where(allowed, value, 0)
        number = np.multiply(value > self.top, np.uint16(k), dtype=np.uint16)
        cv2.max(value, self.top, self.top)
        cv2.max(self.best, number, self.best)

    def all(self, rows: slice) -> NDArray[np.float32]:
        """Return the deciding measure of all frames, shape (n, rows, cols)."""
        count = self._measures.shape[1] - 2 * self._reach
        return self._measures[0, self._reach : self._reach + count, rows]

    def windows(self, rows: slice = slice(None)) -> NDArray[np.float32]:
        """Return the measures around the best frames, shape (kinds, 2 reach + 1, rows, cols)."""
        best = self.best[rows]
        pixel = np.arange(self.best.size).reshape(self.best.shape)[rows]
        frame = best.astype(np.intp) + np.arange(2 * self._reach + 1)[:, None, None]
        measures = self._measures.reshape(len(self._measures), -1)
        return np.take(measures, pixel + frame * self.best.size, axis=1)
