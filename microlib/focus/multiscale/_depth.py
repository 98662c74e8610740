"""The default depth: measure, choose a peak, reject, and refine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.focus.common import (
    END_REACH,
    Band,
    DepthMap,
    Frame,
    Spread,
    bands,
    doubled,
    smooth_planes,
)
from microlib.focus.multiscale._axis import Axis, describe_axis
from microlib.focus.multiscale._fits import fit_stack
from microlib.focus.multiscale._maps import fill_nearest, typical
from microlib.focus.multiscale._peaks import find_peaks
from microlib.focus.multiscale._refine import Refined, refine
from microlib.focus.multiscale._relief import direction_offsets
from microlib.focus.multiscale._rules import RULES, Rule
from microlib.focus.multiscale._settings import FocusSettings

DEFAULT = FocusSettings()
#: Rows that are enlarged at a time, and the reach of the interpolation.
_BAND, _REACH = 128, 4


def multiscale_depth(
    frames: Sequence[Frame],
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
        frames = [cv2.copyMakeBorder(f[:], 0, more[0], 0, more[1], mirrored) for f in frames]
    with ThreadPoolExecutor(workers) as pool:
        spread = pool.map if workers > 1 else map
        axis = describe_axis(frames, positions, settings, spread)
        fits = fit_stack(frames, axis, settings, spread=spread, done=done)
        strength = typical(fits.strength)
        peaks = find_peaks(fits, axis, settings, strength, spread=spread)
        for rule in rules:
            peaks = peaks.without(rule(peaks, settings))
        smooth = smooth_planes(
            peaks.depth,
            peaks.weight,
            jump=settings.jump,
            sigma=settings.smoothing_sigma,
            spread=spread,
        )
        offsets = direction_offsets(smooth, fits, axis, settings, spread)
        best, fits = fits.best, fits.without_windows()
        refined = refine(smooth, offsets, peaks, fits, axis, settings, strength, spread=spread)
        del fits, peaks, smooth, offsets  # to save memory
        ended = ended_mask(refined.depth, best, len(axis.coordinates) - 1, settings)
        return _enlarged(refined, best, ended, axis, shape, spread)


def ended_mask(
    depth: NDArray, best: NDArray, last: int, settings: FocusSettings
) -> NDArray[np.bool_]:
    """Return where the surface may lie outside of the stack.

    Its frame 0 or `last` is the sharpest there, by the measure or by the depth. Noise makes another
    frame the sharpest in some pixels; near an end the pixels around decide.
    """
    ended = (best == 0) | (best == last) | (depth <= 0.5) | (depth >= last - 0.5)
    around = cv2.blur(ended.astype(np.float32), (settings.local_window,) * 2)
    near = (depth < END_REACH) | (depth > last - END_REACH)
    return np.asarray(ended | (near & (around > settings.end_share)))


def _enlarged(
    refined: Refined,
    best: NDArray,
    ended: NDArray[np.bool_],
    axis: Axis,
    shape: tuple[int, ...],
    spread: Spread,
) -> DepthMap:
    """Return the depth of every pixel in µm, computed in bands of rows."""
    unknown = np.isnan(refined.depth)
    filled, relief = fill_nearest(refined.depth), np.where(unknown, 0, refined.relief)
    order, middle = np.argsort(axis.positions), (axis.ends[:-1] + axis.ends[1:]) // 2
    depth, error = (np.empty(shape, np.float32) for _ in range(2))
    frame, at_end = np.empty(shape, np.int32), np.empty(shape, bool)

    def enlarge(band: Band) -> None:
        here, padded, own = band
        every_second = slice(padded.start // 2, -(-padded.stop // 2))

        def full(half: NDArray, how: int = cv2.INTER_LINEAR) -> NDArray:
            return doubled(half[every_second], shape, how)[own]

        depth[here] = axis.micrometers(full(filled) + full(relief, cv2.INTER_CUBIC))
        depth[here][full(unknown.view(np.uint8), cv2.INTER_NEAREST) > 0] = np.nan
        error[here] = full(refined.error) * np.float32(axis.spacing)
        number = full(best, cv2.INTER_NEAREST)
        nearest = np.rint(np.interp(depth[here], axis.positions[order], order))
        frame[here] = np.where(np.isfinite(depth[here]), nearest, middle[number])
        at_end[here] = full(ended.view(np.uint8), cv2.INTER_NEAREST) > 0

    list(spread(enlarge, bands(shape[0], _BAND, _REACH)))
    return DepthMap(depth, error, frame, at_end, axis.spacing)
