"""Follow the sharpest frame of every pixel through a stack, and fit the peak between frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image, are_small, pipeline
from microlib.focus._loops import track_rows
from microlib.focus._measures import RowsMeasure
from microlib.focus._vertex import fit_window, places, three_points

#: Pixels of a band: few enough for its state, some 15 bytes a pixel, to stay near the processor,
#: and enough for a thread to work some time before it needs the interpreter again.
_BAND = 2**17

#: Positions, µm, in single precision: a million meters, and spacings far below an atom.
FARTHEST = 1e12
#: Focus measures in single precision, whose range ends at 3e38.
_LARGEST = 1e18


class _PeakTracker:
    """The focus measures around the best frame so far, for every pixel of a band of rows.

    Memory holds the measures of the last `reach` frames and of 2 `reach` + 1 frames around the
    best one, whatever the number of frames.

    Attributes
    ----------
    window : ndarray, shape (2 reach + 1, rows, cols)
        Measures of the frames around the best one. Entries before the first or after the last
        frame are undefined.
    index : ndarray of uint16, shape (rows, cols)
        Number of the best frame; the first of equals.
    image : ndarray, shape (rows, cols)
        Grey level in the best frame.
    """

    def __init__(self, reach: int, index: NDArray[np.uint16], image: Image) -> None:
        self.index = index
        self.image = image
        self._reach = reach
        self._count = 0

    def push(self, measure: NDArray, frame: Image) -> None:
        """Take in the next frame of the band and its focus measure."""
        if self._count == 0:
            self.index[:] = 0
            self.window = np.zeros((2 * self._reach + 1, *measure.shape), measure.dtype)
            self._recent = np.zeros((self._reach, *measure.shape), measure.dtype)
        track_rows(measure, frame, self._count, self.window, self._recent, self.index, self.image)
        self._count += 1


def _check_window(window: NDArray, index: NDArray, positions: Array) -> None:
    """Refuse what is not of the kinds that a stack's own windows have; the values are its own."""
    for name, value, kinds in (
        ("window", window, "uif"),
        ("index", index, "ui"),
        ("positions", positions, "f"),
    ):
        plain = isinstance(value, np.ndarray) and not isinstance(value, np.ma.MaskedArray)
        if not plain or value.ndim == 0 or value.dtype.kind not in kinds:
            kind = "whole numbers" if kinds == "ui" else "real numbers"
            raise ValueError(f"{name} must be an array of {kind}, got {type(value).__name__}")
    if len(window) < 3 or len(window) % 2 == 0 or window.shape[1:] != index.shape:
        raise ValueError(
            f"window must hold an odd number of measures for each pixel of index, at least 3, got "
            f"{window.shape} and {index.shape}"
        )
    if not window.min() >= 0 or (window.dtype == np.float64 and not are_small(window, _LARGEST)):
        raise ValueError(
            f"window must hold measures from 0 to {_LARGEST:g}, got {window.min():g} to "
            f"{window.max():g}"
        )
    if positions.ndim != 1 or len(positions) < 3 or not np.isfinite(positions).all():
        raise ValueError("positions must be at least three finite numbers")
    exact = positions.astype(np.float64)
    if np.abs(exact).max() > FARTHEST or np.abs(np.diff(exact)).min() < 1 / FARTHEST:
        raise ValueError(
            f"positions must be at least {1 / FARTHEST:g} µm apart and within ±{FARTHEST:g} µm"
        )
    if index.size == 0 or index.max() >= len(positions) or index.min() < 0:
        raise ValueError(f"index must hold numbers of the {len(positions)} positions")


def three_point_peak(
    window: NDArray, index: NDArray[np.uint16], positions: Array
) -> NDArray[np.float32]:
    """Return the depth at the vertex of the Gaussian through the best frame and its two neighbors.

    Parameters
    ----------
    window : ndarray, shape (3, rows, cols)
        Measures of the best frame, in the middle, and of its neighbors.
    index : ndarray of int, shape (rows, cols)
        Number of the best frame.
    positions : ndarray of float64, shape (n,)
        Position of each frame, µm.

    Returns
    -------
    ndarray of float32, shape (rows, cols)
        Depth, µm. NaN where the three measures are equal or zero; the position of the frame itself
        where the best is the first or the last.

    Notes
    -----
    This is (3.13) with the positions taken relative to the best frame: subtracting the squares of
    absolute positions, as it is printed, loses digits. Spacings may be uneven.

    Examples
    --------
    >>> profile = np.exp(-((np.arange(5.0) - 2.25) ** 2))
    >>> window, index = profile[1:4, None, None], np.full((1, 1), 2)
    >>> depth = three_point_peak(window, index, 10 * np.arange(5.0))
    >>> round(float(depth[0, 0]), 4)
    22.5
    """
    _check_window(window, index, positions)
    # Compiled code knows neither half nor extended precision, nor the other order of bytes.
    exact = np.float32 if np.can_cast(window.dtype, np.float32) else np.float64
    return _three_points(
        np.ascontiguousarray(window, exact),
        np.ascontiguousarray(index, np.intp),
        positions.astype(np.float64, copy=False),
    )


def _three_points(
    window: NDArray, index: NDArray[np.uint16], positions: Array
) -> NDArray[np.float32]:
    """Do the work of `three_point_peak` on a window that is known to be one."""
    gaps = np.diff(positions)
    before, after = -np.append(np.nan, gaps), np.append(gaps, np.nan)
    around = np.stack([positions, before, after]).astype(np.float32)
    depth = np.empty(index.size, np.float32)
    three_points(window.reshape(3, -1), index.ravel(), around, depth)
    return depth.reshape(index.shape)


def fit_peak(
    window: NDArray,
    index: NDArray[np.uint16],
    positions: Array,
    ends: tuple[float, float] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the depth of the Gaussian fitted to all frames of the window, and how sure it is.

    Parameters
    ----------
    window : ndarray, shape (2 reach + 1, rows, cols)
        Measures of the best frame, in the middle, and of its neighbors. Entries beyond the stack
        are ignored.
    index : ndarray of int, shape (rows, cols)
        Number of the best frame.
    positions : ndarray of float64, shape (n,)
        Position of each frame, µm.
    ends : tuple of float, optional
        Where the stack begins and ends, µm: further out than the first and the last position if
        these are means of several frames.

    Returns
    -------
    depth : ndarray of float32, shape (rows, cols)
        Depth, µm. NaN where the measure is flat, or its logarithm opens upwards and the best frame
        is not the first or last, whose position is taken then. A vertex beyond the neighboring
        frames or outside the stack is put there.
    inverse_variance : ndarray of float32, shape (rows, cols)
        That of the depth, up to a common factor: height times sharpness of the peak.

    Notes
    -----
    A parabola through the logarithms by least squares. Frames are weighted with their measure,
    because the logarithm of a small one is uncertain, and with the square of an inverted parabola
    centered on the peak. Real profiles have longer tails than a Gaussian: a window that is not
    centered leans on one of them, and pulls the depth towards the middle between frames. The peak
    is only known after a first fit, so there are two. Near the ends of the stack the window is made
    narrower for the same reason, to no less than three frames.

    Examples
    --------
    >>> profile = np.exp(-((np.arange(9.0) - 4.25) ** 2) / 8)
    >>> window, index = profile[1:8, None, None], np.full((1, 1), 4)
    >>> depth, _ = fit_peak(window, index, 10 * np.arange(9.0))
    >>> round(float(depth[0, 0]), 4)
    42.5
    """
    reach = len(window) // 2
    spacing = float(np.median(np.abs(np.diff(positions))))
    steps = positions / spacing
    outer = (steps[0], steps[-1]) if ends is None else (ends[0] / spacing, ends[1] / spacing)
    limits = fit_limits(steps, reach, outer).astype(np.float32)
    depth, inverse_variance = (np.empty(index.size, np.float32) for _ in range(2))
    fit_window(
        window.reshape(len(window), -1),
        index.ravel(),
        places(steps, reach),
        limits,
        steps,
        spacing,
        depth,
        inverse_variance,
    )
    return depth.reshape(index.shape), inverse_variance.reshape(index.shape)


def fit_limits(steps: Array, reach: int, ends: tuple[float, float]) -> Array:
    """Return for each frame the least and greatest vertex around it and half the fit's width.

    The vertex lies between the neighboring frames and within the stack. The fit looks equally far
    to both sides, as far as there are frames on the shorter one.
    """
    last = len(steps) - 1
    limits = np.empty((3, len(steps)))
    for k, here in enumerate(steps):
        # At an end there is but one side, and two frames on it make up the least three.
        count = min(k, last - k, reach) or 2
        seen = steps[max(k - count, 0) : k + count + 1] - here
        around = (*((ends[0],) if k == 0 else ()), *steps[max(k - 1, 0) : k + 2])
        near = np.array((*around, *((ends[1],) if k == last else ()))) - here
        # The window moves to the vertex, which is half a frame away at most, or a whole one at an
        # end of the stack: no frame of three may lose its weight by that.
        margin = (0.5 if count > 1 else 1.0) * np.abs(near).max()
        limits[:, k] = near.min(), near.max(), np.abs(seen).max() + margin
    return limits


@dataclass(frozen=True)
class PeakFit:
    """What a fit of more than three points tells of a peak beside its depth.

    Attributes
    ----------
    inverse_variance : ndarray of float32, shape (rows, cols)
        Inverse variance of the depth, up to a common factor.
    value : ndarray of float32, shape (rows, cols)
        The measure in the best frame.
    """

    inverse_variance: NDArray[np.float32]
    value: NDArray[np.float32]


@dataclass(frozen=True)
class Profile:
    """What is left of a stack once its frames have gone by.

    Attributes
    ----------
    depths : list of ndarray of float32, shape (rows, cols)
        Depth from each measure, µm.
    index, image : ndarray, shape (rows, cols)
        Number of the best frame by the first measure, and the grey level in it; an image without
        rows if it was not wanted.
    peak : PeakFit or None
        The peak of the first measure; None from a fit of three points.
    """

    depths: list[NDArray[np.float32]]
    index: NDArray[np.uint16]
    image: Image
    peak: PeakFit | None


class _Band:
    """A band of rows, with a tracker for each measure until its depths are known."""

    def __init__(
        self,
        rows: slice,
        measures: Sequence[RowsMeasure],
        reaches: Sequence[int],
        positions: Array,
        ends: tuple[float, float],
        result: Profile,
    ) -> None:
        index, image = result.index[rows], result.image[rows]
        self._rows = rows
        self._positions = positions
        self._ends = ends
        self._result = result
        self._work = []
        for measure, reach in zip(measures, reaches, strict=True):
            self._work.append((measure, _PeakTracker(reach, index, image)))
            # Index and image of the result are those by the first measure.
            index, image = np.empty_like(index), image[:0]

    def push(self, frames: Sequence[Image], last: bool) -> None:
        for measure, tracker in self._work:
            for frame in frames:
                tracker.push(measure(frame, self._rows), frame[self._rows])
        if last:
            self._finish()

    def _finish(self) -> None:
        """Write the depths of the band and let go of what they came from."""
        for (_, tracker), depth in zip(self._work, self._result.depths, strict=True):
            if len(tracker.window) == 3:
                fitted = _three_points(tracker.window, tracker.index, self._positions)
            else:
                fitted, inverse_variance = fit_peak(
                    tracker.window, tracker.index, self._positions, self._ends
                )
                if self._result.peak is not None:
                    self._result.peak.inverse_variance[self._rows] = inverse_variance
                    self._result.peak.value[self._rows] = tracker.window[len(tracker.window) // 2]
            depth[self._rows] = fitted
        self._work.clear()


def track_peaks(
    frames: Iterator[Image],
    positions: Array,
    measures: Sequence[RowsMeasure],
    *,
    reaches: Sequence[int],
    batch: int,
    workers: int,
    ends: tuple[float, float] | None = None,
    pictured: bool = True,
) -> Profile:
    """Read all frames once and follow the peak of every pixel by each measure.

    Parameters
    ----------
    frames : iterator of ndarray, shape (rows, cols)
        Frames of one size and type, at least one.
    positions : ndarray of float64, shape (n,)
        Position of each frame, µm.
    measures : sequence of RowsMeasure
        Focus measures; index and image follow the first.
    reaches : sequence of int
        For each measure, how many frames on either side of the best enter the fit.
    batch : int
        Frames that a band takes in while its state is in the cache; up to three times as many are
        held.
    workers : int
        Threads that share the bands of rows.
    ends : tuple of float, optional
        Where the stack begins and ends, µm, if not at the first and the last position.
    pictured : bool
        Whether the grey levels of the best frames are wanted.

    Returns
    -------
    Profile
        Depth by each measure, with what else the first one gives.

    Raises
    ------
    ValueError
        If there are not as many frames as positions.
    """
    first = next(frames)
    height, width = first.shape

    def empty() -> NDArray[np.float32]:
        return np.empty(first.shape, np.float32)

    result = Profile(
        depths=[empty() for _ in measures],
        index=np.empty(first.shape, np.uint16),
        image=np.empty_like(first if pictured else first[:0]),
        peak=PeakFit(empty(), empty()) if reaches[0] > 1 else None,
    )
    # Bands much thinner than what the measures look at would compute most of it twice; with four
    # times their reach it is half as much again.
    thinnest = 4 * max(measure.reach for measure in measures)
    rows = max(min(-(-height // workers), _BAND // width), thinnest, 1)
    limits = (positions[0], positions[-1]) if ends is None else ends
    bands = [
        _Band(slice(top, min(top + rows, height)), measures, reaches, positions, limits, result)
        for top in range(0, height, rows)
    ]

    def rounds() -> Iterator[Callable[[_Band], None]]:
        rest = chain([first], frames)
        taken = list(islice(rest, batch))
        count = len(taken)
        while taken:
            following = list(islice(rest, batch))
            count += len(following)
            if count > len(positions) or (count < len(positions) and not following):
                got = str(count) if not following else f"more than {len(positions)}"
                raise ValueError(
                    f"frames and positions must be as many, got {got} and {len(positions)}"
                )
            yield partial(_Band.push, frames=taken, last=not following)
            taken = following

    pipeline(rounds(), bands, workers)
    return result
