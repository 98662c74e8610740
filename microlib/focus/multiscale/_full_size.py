"""Peaks fitted again at full size where the depth is steep or has a step, and just beside."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.focus._correction import smooth_planes
from microlib.focus._filters import blur
from microlib.focus.multiscale._axis import Axis
from microlib.focus.multiscale._fit import PeakTracker, fit_peaks
from microlib.focus.multiscale._measure import NoiseFloor, doubled_mask, measure
from microlib.focus.multiscale._reject import choose_side, despiked, fill_nearest, relative, typical
from microlib.focus.multiscale._relief import depth_range
from microlib.focus.multiscale._settings import Settings

#: Rows of a block that is fitted at full size, and the overlap around it, px.
GRID, _OVERLAP = 64, 10


def fit_steps(
    frames: Sequence[Image],
    axis: Axis,
    settings: Settings,
    depth: NDArray,
    full: NDArray,
    known: NDArray[np.bool_],
) -> tuple[NDArray, NDArray[np.bool_]]:
    """Return the depth at full size and where it is known, fitted again where it is steep.

    Parameters
    ----------
    frames, axis, settings
        As for `fit_stack`.
    depth : ndarray, shape (rows / 2, cols / 2)
        Depth of every second pixel, steps; NaN where unknown.
    full, known : ndarray, shape (rows, cols)
        The same at full size, and where it is known.
    """
    rises = depth_range(fill_nearest(depth), 3) > settings.jump
    steep = cv2.dilate(rises.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    steep = doubled_mask(steep, full.shape)
    result, found = full.copy(), known.copy()
    for rows, cols in _steep_blocks(steep):
        start = max(rows.start - _OVERLAP, 0)
        view = slice(start, rows.stop + _OVERLAP), cols
        new = _fit_block(frames, axis, settings, view, full[view], known[view])
        new = new[rows.start - start :][: rows.stop - rows.start]
        good = np.isfinite(new) & steep[rows, cols]
        result[rows, cols][good] = new[good]
        found[rows, cols] |= good
    return result, found


def _steep_blocks(steep: NDArray[np.bool_]) -> Iterator[tuple[slice, slice]]:
    """Yield the parts of strips of rows in which it is steep, with some columns beside them."""
    around = np.ones((1, 2 * _OVERLAP + 1), np.uint8)
    for top in range(0, len(steep), GRID):
        strip = steep[top : top + GRID]
        columns = np.atleast_2d(strip.any(axis=0)).astype(np.uint8)
        busy = np.asarray(cv2.dilate(columns, around))[0]
        for left, right in np.flatnonzero(np.diff(busy, prepend=0, append=0)).reshape(-1, 2):
            first, last = top + np.flatnonzero(strip[:, left:right].any(axis=1))[[0, -1]]
            yield slice(int(first), int(last) + 1), slice(int(left), int(right))


def _fit_block(
    frames: Sequence[Image],
    axis: Axis,
    settings: Settings,
    view: tuple[slice, slice],
    rough: NDArray,
    known: NDArray[np.bool_],
) -> NDArray:
    """Return the depths of one block from measures at full size; NaN where they are unreliable."""
    # No further from the depths around than two jumps.
    square, margin = np.ones((13, 13), np.uint8), 2 * settings.jump
    low, high = cv2.erode(rough, square), cv2.dilate(rough, square)
    main, edge, steps = _track_block(frames, axis, settings, view, low - margin, high + margin)
    depth, strength = fit_peaks(main.windows()[0], main.best, steps)
    edges, _ = fit_peaks(edge.windows()[0], edge.best, steps)
    own, disagreement = choose_side(despiked(depth, 5), edges, 5, settings.jump)
    own = despiked(own)
    height = blur(main.top, 2.0)
    highest = cv2.dilate(height, np.ones((2 * settings.local_window - 1,) * 2, np.uint8))
    # A rejected depth returns where the edge measure confirms it, and its peak is none of a halo.
    clear = height > settings.faint * highest
    clear &= cv2.medianBlur(disagreement, 5) < settings.agreement
    # A depth that none around has needs the same evidence as a rejected one.
    expected = known & (low <= own) & (own <= high)
    accepted = np.where(expected | clear, own, np.float32(np.nan))
    weight, sigma = relative(strength, typical(strength)), 2 * settings.radius
    return smooth_planes(accepted, weight, jump=settings.jump, sigma=sigma)


def _track_block(
    frames: Sequence[Image],
    axis: Axis,
    settings: Settings,
    view: tuple[slice, slice],
    low: NDArray,
    high: NDArray,
) -> tuple[PeakTracker, PeakTracker, Array]:
    """Return the profiles of product and edge measure at steps from low to high, and those."""
    near = np.flatnonzero((axis.steps > low.min() - 1) & (axis.steps < high.max() + 1))
    first = min(int(near[0]), len(axis.steps) - 3)
    steps = axis.steps[first : max(int(near[-1]) + 1, first + 3)]
    main = PeakTracker(len(steps), 1, low.shape, 3)
    edge = PeakTracker(len(steps), 1, low.shape, 1)
    floor = NoiseFloor.of(axis.noise, settings)
    for k, step in enumerate(steps):
        frame = axis.frame(frames, first + k, view).astype(np.float32)
        found = measure(frame, 1, settings, floor)
        allowed = (low <= step) & (step <= high)
        main.push(k, found.product, allowed=allowed)
        edge.push(k, found.edge, allowed=allowed)
    return main, edge, steps
