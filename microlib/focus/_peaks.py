"""Positions of frames, and the peak of a focus measure over them by three points, (3.13)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, Image, as_array, scalar
from microlib.focus._filters import TINY, halved
from microlib.focus._measures import FocusMeasure


def check_positions(
    positions: ArrayLike | None,
    spacing: float | None = None,
    count: int = 0,
    from_file: ArrayLike | None = None,
) -> Array:
    """Return the positions of all frames, µm: given, evenly spaced, or from the file."""
    if spacing is not None:
        if positions is not None:
            raise ValueError("positions and spacing must not both be given")
        positions = scalar("spacing", spacing) * np.arange(count)
    positions = from_file if positions is None else positions
    if positions is None:
        raise ValueError(
            "positions or spacing must be given, got None and frames without positions of their own"
        )
    z = as_array("positions", positions, shape=(None,))
    if not 3 <= len(z) < 2**16:  # frames are counted in 16 bits
        raise ValueError(f"positions must hold 3 to 65535 values, got {len(z)}")
    for at in np.flatnonzero(np.diff(z) * np.sign(z[-1] - z[0]) <= 0):
        raise ValueError(
            f"positions must rise or fall strictly, got {z[at]:g} followed by {z[at + 1]:g}"
        )
    return z


def check_count(got: int | str, count: int) -> None:
    """Raise an error if there are not as many frames as positions."""
    if got != count:
        raise ValueError(f"frames and positions must be equal in number, got {got} and {count}")


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
        wrong = index[(index < 0) | (index >= len(z))][0]
        raise ValueError(f"index must hold numbers of the {len(z)} positions, got {wrong}")
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


class TrackedPeaks(NamedTuple):
    """Peaks of one focus measure over all frames.

    Attributes
    ----------
    window : ndarray of float32, shape (3, rows, cols)
        Measure of each pixel's best frame, in the middle, and its neighbors; 0 beyond the stack.
    profiles : ndarray of float32, shape (n, rows / 8, cols / 8)
        Means of the measure over blocks of 8 px.
    best : ndarray of uint16, shape (rows, cols)
        Number of the best frame, the first of equals.
    """

    window: NDArray[np.float32]
    profiles: NDArray[np.float32]
    best: NDArray[np.uint16]


def track_peaks(
    frames: Sequence[Image], measure: FocusMeasure, done: Callable[[float], object]
) -> TrackedPeaks:
    """Find the frame with each pixel's highest measure, keeping three frames at a time."""
    shape = frames[0].shape
    before, top, after = window = np.zeros((3, *shape), np.float32)
    zero, last, profiles = np.zeros(shape, np.float32), np.zeros(shape, np.float32), []
    best = np.zeros(shape, np.uint16)
    for k, frame in enumerate(frames):
        value = np.asarray(measure(frame), np.float32)
        profiles.append(halved(value, 3))
        cv2.copyTo(value, cv2.inRange(best, k - 1, k - 1), after)
        better = cv2.compare(value, top, cv2.CMP_GT)
        number = np.full(shape, k, np.uint16)
        for place, new in ((before, last), (top, value), (after, zero), (best, number)):
            cv2.copyTo(new, better, place)
        last = value
        done((k + 1) / len(frames))
    return TrackedPeaks(window=window, profiles=np.stack(profiles), best=best)
