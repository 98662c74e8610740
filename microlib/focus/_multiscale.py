"""The default depth, stage after stage.

frames → averaged to the depth of field (`_axis`) → measures, the best frame, its neighbors and one
fit (`_follow`) → side at edges and rules for what is not to be believed (`_reliability`) → planes
(`_correction`) → relief and error (`_relief`) → full size, and a fit at full size where the depth
is steep or stepped. Depths are in steps of the averaged frames.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Image
from microlib.focus import _reliability as rules
from microlib.focus import _relief
from microlib.focus._axis import Axis
from microlib.focus._correction import smooth_planes
from microlib.focus._follow import COARSE, COARSE_WINDOW, FINE, WIDE, Followed, Levels, follow
from microlib.focus._measures import absolute_seconds, blur, doubled, halved
from microlib.focus._peaks import PeakFollower, fit_peaks
from microlib.focus._reliability import choose_side, fill_nearest, without_spikes
from microlib.focus._relief import depth_range, step_height
from microlib.focus._result import FocusResult, picked

#: Largest ratio of a pixel's weight to the median, either way: one pixel shall not decide alone.
_WEIGHTS = 1e4
#: Weight of a depth by the wide window, whose error is some seven times the others'.
_WIDE_WEIGHT = 0.02
#: Share of fine detail in coarse that blurred light stays below, and how often the noise the fine
#: detail is: for sure, as JPEG leaves sharp traces, too, and probably. 95 % of the halos of five
#: photographs and of lettering have shares below 0.4, 95 % of faint texture one above 0.6.
_SHARP, _FINER = (0.8, 8.0), (0.4, 4.0)
#: Least wide peak over its level on noise.
_CLEAR = 2.0
#: How far a pixel's own depth may lie from the smoothed one to tell of relief, and how far that may
#: rise, steps.
_OWN, _MOST_RELIEF = 1.2, 1.6
#: Rise at a step from which on the nearest depth is taken and no mean across it, steps.
_SUDDEN = 2.0
#: Error at a step above two jumps over its height: 0.2 to 0.3 on drawn texture, 0.5 where the near
#: side hides the far one, 0.5 to 0.8 on photographs.
_AT_EDGE = np.float32(0.28)
#: Least side of an image that is worked on, px: a smaller one is mirrored at its border.
_LEAST_SIDE = 8

# The constants of the fit at full size, in px of the full grid.

#: Range of depths in 3×3 px of the coarser grid that is steep, steps, and how far around it.
_STEEP, _STEEP_AROUND = 1.4, 5
#: Rows of a block, and what is seen around it, px.
_REFIT_ROWS, _SEEN = 64, 10
#: Side of the square whose coarse depths are looked at, and how far beyond them, steps.
_SQUARE, _BEYOND = 13, 3.0
#: A lost depth returns where it is within this distance of that by the edge measure, steps, and its
#: peak above this share of the strongest in a square of this side, px.
_AGREES, _SHARE, _STRONGEST = 0.4, 0.3, 21


def multiscale_result(
    frames: Sequence[Image],
    color: Sequence[Image] | None,
    axis: Axis,
    *,
    points: int,
    workers: int,
    done: Callable[[float], object] = lambda share: None,
) -> FocusResult:
    """Return the default depth of a stack in µm, with all that goes with it.

    Parameters
    ----------
    frames : sequence of ndarray, shape (rows, cols)
        All frames.
    color : sequence of ndarray, shape (rows, cols, 3), optional
        What the image is made of instead.
    axis : Axis
        How frames are averaged, and their noise.
    points : int
        Averaged frames in a fit.
    workers : int
        Threads.
    done : callable
        Told what share of the rows has been followed through all frames.
    """
    rows, cols = frames[0].shape
    more = [max(_LEAST_SIDE - n, 0) for n in (rows, cols)]
    if any(more):
        mirrored = cv2.BORDER_REFLECT
        frames = [cv2.copyMakeBorder(f, 0, more[0], 0, more[1], mirrored) for f in frames]
    shape = frames[0].shape
    seen = follow(frames, axis, points // 2, workers=workers, done=done)
    depth, weight, apart = believed(seen, axis)
    smooth = smooth_planes(depth, weight, jump=_relief.JUMP, sigma=_relief.RADIUS, workers=workers)
    relief, half_difference = relief_of(seen, smooth, axis)
    pull = _relief.frame_pull(smooth, axis)
    smooth -= pull
    light = np.interp(np.nan_to_num(smooth), axis.steps, axis.light).astype(np.float32)
    # By texture the frames pull up to half as much more or less.
    doubt = np.hypot(light, pull / 2)
    variance = _relief.error_variance(smooth + relief, half_difference, doubt, apart)
    steep = doubled(steep_mask(fill_nearest(smooth)), shape)
    known = doubled(np.isfinite(smooth), shape)
    steps, known = refit(enlarged(smooth, relief, shape), known, steep, frames, axis)
    height = step_height(steps)
    height[height < 2 * _relief.JUMP] = 0
    error = np.hypot(doubled(np.sqrt(variance), shape), _AT_EDGE * height)
    best = doubled(seen.best, shape, cv2.INTER_NEAREST)
    steps[~known] = error[~known] = np.nan
    steps, error, best = (part[:rows, :cols] for part in (steps, error, best))
    depth = axis.micrometers(steps)
    known = np.isfinite(depth)
    order = np.argsort(axis.positions)
    nearest = np.rint(np.interp(depth, axis.positions[order], order))
    middles = (axis.ends[:-1] + axis.ends[1:]) // 2
    number = np.where(known, nearest, middles[best]).astype(np.int32)
    shown = frames if color is None else color
    return FocusResult(
        depth=depth,
        uncertainty=error * np.float32(axis.spacing),
        confidence=np.where(known, 1 / (1 + error * error), np.float32(0)),
        index=np.where(known, number, np.int32(-1)),
        all_in_focus=picked((frame[:rows, :cols] for frame in shown), number),
        at_end=(best == 0) | (best == len(axis.steps) - 1),
    )


def believed(seen: Followed, axis: Axis) -> tuple[NDArray, NDArray, NDArray]:
    """Return each pixel's depth on its own side of an edge, NaN where lost, its weight, and how far
    the depths by both measures are apart."""
    levels = Levels.of(axis.noise)
    depth = seen.depth.copy()
    depth[rules.incoherent_mask(seen.best)] = np.nan
    fine, coarse = factors(seen, levels)
    # By noise either factor changes by a quarter of its level, simulated on textures and on noise.
    chance = np.float32(levels.fine / 4) * coarse + np.float32(levels.coarse / 4) * fine
    depth[rules.unchanged_mask(seen.top - seen.mean, chance, len(axis.steps))] = np.nan
    broad = without_spikes(fill_nearest(depth))
    sided, apart = choose_side(broad, fill_nearest(seen.edge), 3)
    depth = np.where(np.isfinite(depth), without_spikes(sided), np.float32(np.nan))
    weight = relative(seen.strength, axis.typical)
    wide = wide_depth(seen, levels, len(axis.steps), depth.shape)
    sharp, finer = sharp_mask(seen, levels, *_SHARP), sharp_mask(seen, levels, *_FINER)
    instead, neither = rules.check_wide(depth, wide, apart, sharp, finer)
    depth[neither] = np.nan
    depth[instead], weight[instead] = wide[instead], _WIDE_WEIGHT
    depth[rules.blurred_edge_mask(depth, weight) & ~sharp] = np.nan
    depth[rules.small_piece_mask(depth)] = np.nan
    depth[rules.isolated_mask(depth)] = np.nan
    return depth, weight, apart


def factors(seen: Followed, levels: Levels) -> tuple[NDArray, NDArray]:
    """Return the fine and the coarse factor of each peak, with their floors."""
    middle = len(seen.along) // 2
    fine = seen.along[middle] + seen.down[middle] + np.float32(levels.fine)
    return fine, seen.top / fine


def sharp_mask(seen: Followed, levels: Levels, share: float, noise: float) -> NDArray[np.bool_]:
    """Tell where the sharpest frame has fine detail of its own, which no blurred light has."""
    middle = len(seen.along) // 2
    fine = seen.along[middle] + seen.down[middle]
    coarse = seen.top / (fine + np.float32(levels.fine)) - np.float32(levels.coarse)
    above = blur(fine - np.float32(noise * levels.fine), 1.0)
    return np.asarray(above > share * blur(coarse, 1.0))


def relative(strength: NDArray, typical: float | None = None) -> NDArray:
    """Return strengths over their median, 1 where a depth came without a fit."""
    fitted = strength > 0
    if typical is None:
        typical = float(np.median(strength[fitted])) if fitted.any() else 1.0
    ratio = np.clip(strength / np.float32(typical), 1 / _WEIGHTS, _WEIGHTS)
    return np.where(fitted, ratio, np.float32(1))


def wide_depth(seen: Followed, levels: Levels, count: int, shape: tuple[int, ...]) -> NDArray:
    """Return the depth by the wide window, NaN where its peak is of noise or of a blurred edge."""
    wide = seen.wide.copy()
    wide[seen.wide_top < _CLEAR * levels.wide] = np.nan
    # Of a mean of N squares (s + e)² noise changes 2 √(s² e² / N).
    chance = np.sqrt(np.float32(4 * levels.wide / WIDE**2) * seen.wide_top)
    wide[rules.unchanged_mask(seen.wide_top - seen.wide_mean, chance, count)] = np.nan
    edges = rules.blurred_edge_mask(wide[::2, ::2], seen.wide_top[::2, ::2])
    wide[doubled(edges, wide.shape)] = np.nan
    return doubled(wide, shape)


def relief_of(seen: Followed, smooth: NDArray, axis: Axis) -> tuple[NDArray, NDArray]:
    """Return the fine relief that the smoothing took away, and half the directions' difference."""
    level = np.nan_to_num(smooth)
    there = np.isfinite(smooth) & (np.abs(seen.depth - smooth) < _OWN)
    offsets, strengths = [], []
    for window in (seen.along, seen.down):
        depth, strength = fit_peaks(window, seen.best, axis.steps, near=level)
        good = there & (strength > 0) & np.isfinite(depth)
        offset = np.clip(depth - level, -_MOST_RELIEF, _MOST_RELIEF)
        offsets.append(np.where(good, offset, np.float32(0)))
        strengths.append(np.where(good, strength, np.float32(0)))
    mass = np.sqrt(np.sqrt(strengths[0] * strengths[1]))
    middle = np.float32(max(np.median(mass), 1e-12))
    mass = np.where(mass > 0, np.clip(mass / middle, 0.01, 100), np.float32(0))
    return _relief.find_relief(offsets[0], offsets[1], mass)


def enlarged(smooth: NDArray, relief: NDArray, shape: tuple[int, ...]) -> NDArray:
    """Return the depth at full size: interpolated, but the nearest one at steps."""
    full = doubled(fill_nearest(smooth), shape)
    fine = np.where(np.isfinite(smooth), relief, np.float32(0))
    full = full + doubled(fine, shape, cv2.INTER_CUBIC)
    both = fill_nearest(smooth + relief)
    sudden = doubled(step_height(both) > _SUDDEN, shape)
    full[sudden] = doubled(both, shape, cv2.INTER_NEAREST)[sudden]
    return full


# --- At full size, where it is steep ------------------------------------------------------------


def steep_mask(depth: NDArray) -> NDArray[np.bool_]:
    """Tell where a depth on the coarser grid is steep or has a step, and just beside it."""
    steep = (depth_range(depth, 3) > _STEEP).astype(np.uint8)
    return np.asarray(cv2.dilate(steep, np.ones((_STEEP_AROUND, _STEEP_AROUND), np.uint8))) > 0


def refit(
    depth: NDArray,
    known: NDArray[np.bool_],
    steep: NDArray[np.bool_],
    frames: Sequence[Image],
    axis: Axis,
) -> tuple[NDArray, NDArray[np.bool_]]:
    """Fit again where it is steep, in blocks of rows.

    Parameters
    ----------
    depth : ndarray of float32, shape (rows, cols)
        Depth from the coarser grid, steps, everywhere.
    known, steep : ndarray of bool, shape (rows, cols)
        Where it is to be believed, and where to fit again.
    frames, axis
        The stack.

    Returns
    -------
    depth, known : ndarray, shape (rows, cols)
        With the new depths, and with those that were lost and returned.
    """
    result, there = depth.copy(), known.copy()
    around = np.ones((1, 2 * _SEEN + 1), np.uint8)
    for top in range(0, len(depth), _REFIT_ROWS):
        strip = steep[top : top + _REFIT_ROWS]
        columns = np.atleast_2d(strip.any(axis=0)).astype(np.uint8)
        busy = np.asarray(cv2.dilate(columns, around))[0]
        for left, right in np.flatnonzero(np.diff(busy, prepend=0, append=0)).reshape(-1, 2):
            rows = top + np.flatnonzero(strip[:, left:right].any(axis=1))
            first = max(int(rows[0]) - _SEEN, 0)
            view = np.s_[first : int(rows[-1]) + 1 + _SEEN, int(left) : int(right)]
            new = _closer(depth[view], known[view], frames, axis, view)
            good = np.isfinite(new) & steep[view]
            good[: int(rows[0]) - first] = good[int(rows[-1]) + 1 - first :] = False
            result[view][good] = new[good]
            there[view] |= good
    return result, there


def _closer(
    rough: NDArray,
    known: NDArray[np.bool_],
    frames: Sequence[Image],
    axis: Axis,
    view: tuple[slice, slice],
) -> NDArray:
    """Return the depths of one block from measures at full size; NaN where they are lost."""
    steps, levels = axis.steps, Levels.of(axis.noise)
    square = np.ones((_SQUARE, _SQUARE), np.uint8)
    low, high = cv2.erode(rough, square), cv2.dilate(rough, square)
    near = np.flatnonzero((steps > low.min() - _BEYOND - 1) & (steps < high.max() + _BEYOND + 1))
    first = min(int(near[0]), len(steps) - 3)
    part = steps[first : max(int(near[-1]) + 1, first + 3)]
    main = PeakFollower(len(part), 1, rough.shape, 3)
    edge = PeakFollower(len(part), 1, rough.shape, 1)
    fine, coarse = np.float32(levels.fine), np.float32(levels.coarse)
    floor = np.float32(2 * levels.edge)  # of noise that was not halved
    for k, step in enumerate(part):
        frame = axis.frame(frames, first + k, view).astype(np.float32)
        wider = blur(np.add(*absolute_seconds(halved(frame), COARSE, 7)), COARSE_WINDOW)
        own = blur(np.add(*absolute_seconds(frame, FINE, 5)), 0.8)
        np.multiply(own + fine, doubled(wider, frame.shape) + coarse, out=main.slot(k)[0])
        allowed = (low - _BEYOND <= step) & (step <= high + _BEYOND)
        main.push(k, allowed)
        off = cv2.absdiff(frame, blur(frame, 4.0))
        np.multiply(blur(off, 0.5) + floor, blur(off, 2.0) + floor, out=edge.slot(k)[0])
        edge.push(k, allowed)
    broad, strength = fit_peaks(main.windows()[0], main.best, part)
    sharp, _ = fit_peaks(edge.windows()[0], edge.best, part)
    broad = without_spikes(broad, 5)
    own, apart = choose_side(broad, sharp, 5)
    own = without_spikes(own)
    mean = blur(main.top, 2.0)
    clear = mean > _SHARE * cv2.dilate(mean, np.ones((_STRONGEST, _STRONGEST), np.uint8))
    agrees = cv2.medianBlur(apart, 5) < _AGREES
    # A depth that none has around it needs the evidence that a lost one needs.
    within = known & (low <= own) & (own <= high)
    depth = np.where(within | (clear & agrees), own, np.float32(np.nan))
    return smooth_planes(depth, relative(strength), jump=_relief.JUMP, sigma=2 * _relief.RADIUS)
