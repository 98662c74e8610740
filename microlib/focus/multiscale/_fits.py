"""The one pass through the frames: measures of every second pixel, and the fits to their peaks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.focus._filters import halved
from microlib.focus.multiscale._axis import Axis, every_other_tile, find_axis
from microlib.focus.multiscale._fit import PeakTracker, fit_peaks
from microlib.focus.multiscale._measure import NoiseFloor, measure
from microlib.focus.multiscale._settings import Settings
from microlib.focus.multiscale._symmetry import find_symmetry, shape_error

#: Rows that are read on either side of a strip, the reach of the measures' windows. Rows of a
#: strip, of which fewer are taken of more frames, so that its measures stay below 64 MB.
_MARGIN, _MAX_ROWS = 32, 256


@dataclass(frozen=True)
class Fits:
    """Peaks of the measures at every second pixel, of the wide ones at every fourth, in steps.

    Attributes
    ----------
    depth, strength, top, best : ndarray, shape (rows, cols)
        Of the product of the fine and the coarse measure: position and strength of the fit, height
        of the peak, and number of the best frame.
    profiles : ndarray, shape (n, rows / 4, cols / 4)
        Product of each frame, as means of blocks.
    along, down : ndarray, shape (7, rows, cols)
        The fine measure of either direction in the frames around the best one.
    edge : ndarray, shape (rows, cols)
        Depth by the edge measure.
    wide : ndarray, shape (rows / 2, cols / 2)
        Depth by the wide window.
    """

    depth: NDArray[np.float32]
    strength: NDArray[np.float32]
    top: NDArray[np.float32]
    best: NDArray[np.uint16]
    profiles: NDArray[np.float32]
    along: NDArray[np.float32]
    down: NDArray[np.float32]
    edge: NDArray[np.float32]
    wide: NDArray[np.float32]


def fit_stack(
    frames: Sequence[Image],
    axis: Axis,
    settings: Settings,
    *,
    workers: int = 1,
    done: Callable[[float], object] = lambda share: None,
) -> Fits:
    """Measure every pixel in all frames and fit the peaks, in strips of rows.

    Parameters
    ----------
    frames : sequence of ndarray, shape (rows, cols)
        All frames.
    axis : Axis
        Groups of averaged frames.
    settings : Settings
        Settings of the measures.
    workers : int
        Threads that share the strips.
    done : callable
        Called after each strip with the share of the rows that is done.
    """
    shape = frames[0].shape
    rows = 2**24 // max(shape[1] * len(axis.steps), 1) - 2 * _MARGIN
    # A multiple of eight, as blocks of eight rows are averaged.
    tops = range(0, shape[0], int(np.clip(rows // 8 * 8, 64, _MAX_ROWS)))

    def strip(top: int) -> Fits:
        bottom = min(top + tops.step, shape[0])
        start = max(top - _MARGIN, 0)
        view = slice(start, min(bottom + _MARGIN, shape[0]))
        keep = slice(top - start, bottom - start)
        return _fit_strip(frames, axis, settings, view, keep)

    parts = []
    with ThreadPoolExecutor(workers) as pool:
        for part in pool.map(strip, tops):  # in their order, from this thread
            parts.append(part)
            done(len(parts) / len(tops))
    whole = {}
    for field in fields(Fits):
        block = {"profiles": 8, "wide": 4}.get(field.name, 2)
        rows, cols = (-(-n // block) for n in shape)
        joined = np.concatenate([getattr(part, field.name) for part in parts], axis=-2)
        whole[field.name] = np.ascontiguousarray(joined[..., :rows, :cols])
    return Fits(**whole)


def _fit_strip(
    frames: Sequence[Image], axis: Axis, settings: Settings, rows: slice, keep: slice
) -> Fits:
    """Measure some rows of the frames, and fit those to keep."""
    main, edge, wide = _track(frames, axis, settings, rows)
    here = slice(keep.start // 2, -(-keep.stop // 2))
    coarse = slice(keep.start // 4, -(-keep.stop // 4))
    windows, steps = main.windows(here), axis.steps
    beyond = (1 - len(steps) / len(axis.positions)) / 2  # the first mean lies half a group inside
    depth, strength = fit_peaks(windows[0], main.best[here], steps, beyond=beyond)
    edges, _ = fit_peaks(edge.windows(here)[0], edge.best[here], steps, beyond=beyond)
    far, _ = fit_peaks(wide.windows(coarse)[0], wide.best[coarse], steps)
    return Fits(
        depth=depth,
        strength=strength,
        top=main.top[here],
        best=main.best[here],
        profiles=np.stack([halved(image, 2) for image in main.profiles(here)]),
        along=windows[1],
        down=windows[2],
        edge=edges,
        wide=far,
    )


def _track(
    frames: Sequence[Image], axis: Axis, settings: Settings, rows: slice
) -> tuple[PeakTracker, PeakTracker, PeakTracker]:
    """Return the profiles of the product with its directions, of the edge and the wide measure."""
    count, floor = len(axis.steps), NoiseFloor.of(axis.noise, settings)
    size = [-(-n // 4) for n in frames[0][rows].shape]  # every fourth pixel
    main = PeakTracker(count, 3, (2 * size[0], 2 * size[1]), 3)
    edge = PeakTracker(count, 1, (2 * size[0], 2 * size[1]), 1)
    wide = PeakTracker(count, 1, (size[0], size[1]), 2)
    for k in range(count):
        frame = axis.frame(frames, k, (rows, slice(None)))
        down, right = (-n % 4 for n in frame.shape)
        if down or right:
            frame = cv2.copyMakeBorder(frame, 0, down, 0, right, cv2.BORDER_REPLICATE)
        found = measure(frame, settings, floor)
        main.push(k, found.product, found.along, found.down)
        edge.push(k, found.edge)
        energy = found.coarse_along**2 + found.coarse_down**2
        wide.push(k, cv2.blur(halved(energy), (settings.wide, settings.wide)))
    return main, edge, wide


def describe_axis(tiles: Sequence[Image], positions: Array, settings: Settings) -> Axis:
    """Return the groups of averaged frames of a stack and their biases.

    Parameters
    ----------
    tiles : sequence of ndarray
        The `sample_tiles` of each frame.
    positions : ndarray, shape (n,)
        Position of each frame, µm.
    settings : Settings
        Settings of all steps.
    """
    axis = find_axis(tiles, positions, settings.width)
    few = [every_other_tile(image) for image in tiles]
    single = replace(
        axis,
        ends=np.arange(len(positions) + 1),
        means=positions,
        steps=np.arange(float(len(positions))),
    )
    curves = _track(few, single, settings, slice(None))[0]
    profiles = np.stack([halved(image) for image in curves.profiles(slice(None))])
    symmetry, centers = find_symmetry(profiles, positions, axis.spacing)
    if symmetry.bend:
        axis = find_axis(tiles, positions, settings.width, symmetry)
    if len(axis.steps) < len(positions):
        curves = _track(few, axis, settings, slice(None))[0]
    # What the shape of the peaks leaves shows between the fit, the center and a narrower fit.
    window, best, steps = curves.windows()[0], curves.best, axis.steps
    depth, narrow = (
        halved(fit_peaks(window, best, steps, narrowing=factor)[0]) for factor in (1.0, np.sqrt(2))
    )
    center = axis.step(centers)
    pairs = (shape_error(other, center, steps) for other in (depth, center + depth - narrow))
    constant, periodic = np.hypot(*np.array(list(pairs)))
    return replace(axis, shape_error=(float(constant), float(periodic)))
