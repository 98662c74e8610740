"""The depth at the peak of one focus measure, by three points, (3.13)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, as_array
from microlib.focus._measures import FocusMeasure
from microlib.focus._stack import check_positions
from microlib.focus.common import (
    TINY,
    DepthMap,
    Frame,
    blur,
    halved,
    peak_centers,
    peak_significance,
    shape_error,
)


def three_point_peak(window: NDArray, index: NDArray, positions: Array) -> Array:
    """Return the depth at the peak of the Gaussian through the best frame and its two neighbors.

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
    ndarray of float64, shape (rows, cols)
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
    return np.where(known, depth, np.nan)


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
    frames: Sequence[Frame], measure: FocusMeasure, done: Callable[[float], object]
) -> TrackedPeaks:
    """Find the frame with each pixel's highest measure, keeping three frames at a time."""
    shape = frames[0].shape
    before, top, after = window = np.zeros((3, *shape), np.float32)
    zero, last, profiles = np.zeros(shape, np.float32), np.zeros(shape, np.float32), []
    best = np.zeros(shape, np.uint16)
    for k, frame in enumerate(frames):
        value = np.asarray(measure(frame[:]), np.float32)
        profiles.append(halved(value, 3))
        cv2.copyTo(value, cv2.inRange(best, k - 1, k - 1), after)
        better = cv2.compare(value, top, cv2.CMP_GT)
        number = np.full(shape, k, np.uint16)
        for place, new in ((before, last), (top, value), (after, zero), (best, number)):
            cv2.copyTo(new, better, place)
        last = value
        done((k + 1) / len(frames))
    return TrackedPeaks(window=window, profiles=np.stack(profiles), best=best)


def three_point_depth(
    frames: Sequence[Frame],
    positions: Array,
    measure: FocusMeasure,
    done: Callable[[float], object],
) -> DepthMap:
    """Return the depth at the three-point peaks of one measure, (3.13)."""
    peaks = track_peaks(frames, measure, done)
    depth = three_point_peak(peaks.window, peaks.best, positions).astype(np.float32)
    significance = peak_significance(peaks.profiles, peaks.window[1], 3)
    depth[significance.insignificant] = np.nan
    spacing = float(np.median(np.abs(np.diff(positions))))
    rough = _roughness(depth, positions, peaks.best)
    bias = np.float32(_shape_error(peaks.profiles, positions))
    random = np.float32(np.ptp(positions)) * significance.random_error
    return DepthMap(
        depth=depth,
        uncertainty=np.sqrt(rough * rough + bias * bias + random * random),
        frame=peaks.best,
        at_end=(peaks.best == 0) | (peaks.best == len(positions) - 1),
        spacing=spacing,
    )


def _shape_error(profiles: NDArray, positions: Array) -> float:
    """Return the bias of three-point peaks by the shape of the profiles, µm."""
    some = max(round(np.sqrt(profiles[0].size / 2000)), 1)
    profiles = profiles[:, ::some, ::some]
    best = np.clip(profiles.argmax(axis=0), 1, len(profiles) - 2)
    around = best + np.arange(-1, 2)[:, None, None]
    peaks = three_point_peak(np.take_along_axis(profiles, around, axis=0), best, positions)
    biases = [shape_error(peaks, centers) for centers in peak_centers(profiles, positions)]
    return float(np.linalg.norm(biases))


def _roughness(depth: NDArray, positions: Array, index: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Return the local root mean square of the depth after a high-pass filter, µm.

    The difference from a Gaussian mean (σ = 8 px) is taken four times in a row, (1 − G)⁴: slopes
    and curvature leave no trace in it, and errors that change within some ten pixels pass. Taken
    on every second pixel, with the best frame's position where there is no depth.
    """
    # From the middle of the stack, where float32 has digits to spare.
    rough, frame = depth[::2, ::2], positions[index[::2, ::2]]
    rough = (np.where(np.isnan(rough), frame, rough) - positions.mean()).astype(np.float32)
    for _ in range(4):
        rough = rough - blur(rough, 4.0)
    rough = np.sqrt(np.maximum(cv2.boxFilter(rough * rough, -1, (3, 3)), 0))
    return np.asarray(cv2.resize(rough, depth.shape[::-1]))
