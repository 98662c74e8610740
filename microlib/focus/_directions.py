"""Depths from the second difference along rows, along columns and from both, near a known depth.

Their windows see the same surface, but the noise and the texture that disturb the one are nearly
independent of those that disturb the other: what both agree on is on the object.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image, pipeline
from microlib.focus._filters import direction_rows, own_room
from microlib.focus._loops import keep_near, nearest_rows
from microlib.focus._measures import blur_taps, rows_around
from microlib.focus._peaks import fit_limits
from microlib.focus._vertex import fit_near, places

#: Rows of a band: its windows, 72 bytes a pixel, stay near the processor.
_ROWS = 64
#: Smoothing before the second difference and spread after it, px: little, as what they blur is lost
#: to the relief. Table "constant changed" of benchmarks/focus_depth.py.
_SMOOTH, _SPREAD = 0.7, 1.0
#: Frames on either side in the fit, as by default, and how far from the known depth its middle may
#: lie: the vertex may lie one further, and larger relief is no relief to the smoothing either.
_FIT, _NEAR = 3, 1


@dataclass(frozen=True)
class Directions:
    """Three depths of every pixel, in frames from the known one, and the weight of each.

    Attributes
    ----------
    offsets : ndarray of float32, shape (3, rows, cols)
        From both directions, along rows, along columns; 0 where there is none.
    weights : ndarray of float32, shape (3, rows, cols)
        Root of the inverse variance, up to a common factor; 0 where there is none.
    """

    offsets: NDArray[np.float32]
    weights: NDArray[np.float32]


def directional_depths(
    frames: Iterator[Image], positions: Array, base: Array, *, batch: int, workers: int
) -> Directions:
    """Fit the peaks of directional second differences near a depth that is known.

    Parameters
    ----------
    frames : iterator of ndarray, shape (rows, cols)
        Frames of one size and type, one for each position.
    positions : ndarray of float64, shape (n,)
        Position of each frame, µm.
    base : ndarray of float64, shape (rows, cols)
        Known depth, µm; NaN where there is none.
    batch, workers : int
        As in `track_peaks`.

    Returns
    -------
    Directions
        Offsets in frames and weights.
    """
    spacing = float(np.median(np.abs(np.diff(positions))))
    steps = positions / spacing
    depth = base / spacing
    center = nearest_frames(depth, steps).astype(np.int32)
    limits = fit_limits(steps, _FIT, (steps[0], steps[-1])).astype(np.float32)
    result = Directions(
        np.zeros((3, *base.shape), np.float32), np.zeros((3, *base.shape), np.float32)
    )
    height = len(base)
    bands = [
        _Band(slice(top, min(top + _ROWS, height)), depth, center, steps, limits, result)
        for top in range(0, height, _ROWS)
    ]

    def rounds() -> Iterator[Callable[[_Band], None]]:
        number = 0
        while taken := list(islice(frames, batch)):
            last = number + len(taken) == len(positions)
            yield partial(_Band.push, frames=taken, number=number, last=last)
            number += len(taken)

    pipeline(rounds(), bands, workers)
    return result


def nearest_frames(depth: Array, positions: Array) -> NDArray[np.uint16]:
    """Return the number of the frame nearest to each depth, any where it is NaN."""
    order = np.argsort(positions)
    between = (positions[order][1:] + positions[order][:-1]) / 2
    nearest = np.empty(depth.shape, np.uint16)
    nearest_rows(depth, between, order.astype(np.uint16), nearest)
    return nearest


class _Band:
    """A band of rows with the measures around its known depth, until the peaks are fitted."""

    def __init__(
        self,
        rows: slice,
        depth: Array,
        center: NDArray[np.int32],
        steps: Array,
        limits: NDArray[np.float32],
        result: Directions,
    ) -> None:
        self._rows = rows
        self._depth = depth[rows]
        self._center = center[rows]
        self._range = self._center.min(axis=0), self._center.max(axis=0)
        self._steps = steps
        self._limits = limits
        self._result = result

    def push(self, frames: Sequence[Image], number: int, last: bool) -> None:
        if number == 0:
            count = 2 * (_FIT + _NEAR) + 1
            self._windows = np.zeros((2, count, *self._depth.shape), np.float32)
        for k, frame in enumerate(frames, number):
            cols = self._near(k)
            if cols.start < cols.stop:
                measures = _second_differences(frame, self._rows, cols)
                keep_near(measures, k, self._center[:, cols], self._windows[..., cols])
        if last:
            self._fit()
            del self._windows

    def _near(self, number: int) -> slice:
        """Return the columns between which a frame lies in some pixel's window."""
        lowest, highest = self._range
        reach = _FIT + _NEAR
        near = np.flatnonzero((lowest - reach <= number) & (number <= highest + reach))
        return slice(int(near[0]), int(near[-1]) + 1) if len(near) else slice(0, 0)

    def _fit(self) -> None:
        """Write the offsets and weights of the band."""
        shape = self._depth.shape
        found = np.empty((2, 3, self._depth.size), np.float32)
        fit_near(
            self._windows.reshape(*self._windows.shape[:2], -1),
            self._center.ravel(),
            self._depth.ravel(),
            places(self._steps, _FIT),
            self._limits,
            self._steps,
            found[0],
            found[1],
        )
        self._result.offsets[:, self._rows] = found[0].reshape(3, *shape)
        self._result.weights[:, self._rows] = found[1].reshape(3, *shape)


def _second_differences(
    image: Image, rows: slice, cols: slice | None = None
) -> NDArray[np.float32]:
    """Return the measures along rows and along columns of some rows and columns of an image."""
    filters = blur_taps(_SMOOTH), blur_taps(_SPREAD)
    seen = cols or slice(0, image.shape[1])
    # The length of taps is one more than the radius; the second difference looks one further.
    part, first = rows_around(image, rows, len(filters[0]) + len(filters[1]) - 1)
    found = np.empty((2, rows.stop - rows.start, seen.stop - seen.start), np.float32)
    at = first, len(image), rows.start, seen.start
    direction_rows(part, *at, filters, own_room(), (found[0], found[1]))
    return found
