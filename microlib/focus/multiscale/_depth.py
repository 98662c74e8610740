"""The default depth: measure, choose a peak, reject, and refine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.focus.common import DepthMap, doubled
from microlib.focus.multiscale._axis import Axis, describe_axis
from microlib.focus.multiscale._fits import fit_stack
from microlib.focus.multiscale._maps import typical
from microlib.focus.multiscale._peaks import find_peaks
from microlib.focus.multiscale._refine import enlarge, refine
from microlib.focus.multiscale._rules import RULES, Rule
from microlib.focus.multiscale._settings import FocusSettings

DEFAULT = FocusSettings()


def multiscale_depth(
    frames: Sequence[Image],
    positions: Array,
    *,
    workers: int = 1,
    done: Callable[[float], object] = lambda share: None,
    rules: Sequence[Rule] = RULES,
    settings: FocusSettings = DEFAULT,
) -> DepthMap:
    """Return the default depth of a stack.

    Parameters
    ----------
    frames : sequence of ndarray, shape (rows, cols)
        All frames, grey.
    positions : ndarray, shape (n,)
        Position of each frame, µm.
    workers : int
        Threads.
    done : callable
        Called with the share of the rows that has been measured in all frames.
    rules : sequence of callable
        Rules that reject peaks.
    settings : FocusSettings
        Settings of all stages.
    """
    shape = frames[0].shape
    more = [max(8 - n, 0) for n in shape]
    if any(more):  # smaller ones are mirrored at their border
        mirrored = cv2.BORDER_REFLECT
        frames = [cv2.copyMakeBorder(f, 0, more[0], 0, more[1], mirrored) for f in frames]
    with ThreadPoolExecutor(workers) as pool:
        spread = pool.map if workers > 1 else map
        axis = describe_axis(frames, positions, settings, spread)
        fits = fit_stack(frames, axis, settings, spread=spread, done=done)
        strength = typical(fits.strength)
        peaks = find_peaks(fits, axis, settings, strength)
        for rule in rules:
            peaks = peaks.without(rule(peaks, settings))
        refined = refine(peaks, fits, axis, settings, strength, spread=spread)
    full, known = enlarge(refined, frames[0].shape)
    depth = np.where(known, full, np.float32(np.nan))
    error = doubled(refined.error, full.shape)
    part = slice(shape[0]), slice(shape[1])
    return _depth_map(depth[part], error[part], fits.best, axis)


def _depth_map(depth: NDArray, error: NDArray, best: NDArray, axis: Axis) -> DepthMap:
    """Return depth and error in µm, and the frame numbers."""
    depth = axis.micrometers(depth)
    error = error * np.float32(axis.spacing)
    if axis.symmetry.bend:  # frame coordinates are not proportional to positions
        error /= axis.symmetry.slope(depth)
    best = doubled(best, depth.shape, cv2.INTER_NEAREST)
    order = np.argsort(axis.positions)
    nearest = np.rint(np.interp(depth, axis.positions[order], order))
    middle = (axis.ends[:-1] + axis.ends[1:]) // 2
    return DepthMap(
        depth=depth,
        uncertainty=np.asarray(error, np.float32),
        frame=np.where(np.isfinite(depth), nearest, middle[best]).astype(np.int32),
        at_end=(best == 0) | (best == len(axis.coordinates) - 1),
        spacing=axis.spacing,
    )
