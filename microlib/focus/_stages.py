"""The default depth, stage after stage; the guide's section "How a height is found" tells the same.

A stage is a function from what is known to what is known next. `STAGES` has them in their order;
`default_depth` runs those that it is given, all but for measurements of what each is worth.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.focus import _reliability as rules
from microlib.focus import _relief
from microlib.focus._axis import Axis, find_axis, mosaic
from microlib.focus._correction import smooth_planes
from microlib.focus._follow import Followed, Levels, follow, peak_asymmetry
from microlib.focus._measures import TINY, absolute_seconds, blur, doubled, halved
from microlib.focus._peaks import PeakFollower, fit_peaks
from microlib.focus._reliability import choose_side, fill_nearest, without_spikes
from microlib.focus._relief import depth_range, step_height
from microlib.focus._result import FocusResult, finished
from microlib.focus._settings import Settings
from microlib.focus._significance import judge_peaks

#: Rows of a block that is fitted at full size, and what is seen around it, px.
GRID, _SEEN = 64, 10
_NOTHING: Any = None


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of a stack: more after each stage.

    Depths are in steps of the averaged frames, maps are of every second pixel unless it says
    otherwise, and NaN is an unknown depth.

    Attributes
    ----------
    frames, positions, workers, done, settings
        As for `default_depth`.
    axis : Axis
        How frames are averaged, and their noise.
    seen : Followed
        The peaks of all measures.
    levels : Levels
        What the measures are on noise alone.
    depth, weight : ndarray
        The depth, and its weight in a mean.
    apart : ndarray
        How far the depths by two measures are apart.
    sharp : ndarray of bool
        Where there is fine detail that no blurred light has, for sure.
    relief, half_difference : ndarray
        Fine relief that the smoothing took away, and half of what both directions differ by.
    pull : ndarray
        How far the frames pulled the depth, before that was undone.
    error : ndarray
        Standard deviation of the depth.
    full, there : ndarray, shape of a frame
        Depth at full size, and where it is known.
    """

    frames: Sequence[Image]
    positions: Array
    workers: int
    done: Callable[[float], object]
    settings: Settings
    axis: Axis | Any = None
    seen: Followed = _NOTHING
    levels: Levels = _NOTHING
    depth: NDArray = _NOTHING
    wide: NDArray = _NOTHING
    weight: NDArray = _NOTHING
    apart: NDArray = _NOTHING
    sharp: NDArray = _NOTHING
    relief: NDArray = _NOTHING
    half_difference: NDArray = _NOTHING
    pull: NDArray = _NOTHING
    error: NDArray = _NOTHING
    full: NDArray = _NOTHING
    there: NDArray = _NOTHING


def default_depth(
    frames: Sequence[Image],
    color: Sequence[Image] | None,
    positions: Array,
    *,
    workers: int = 1,
    done: Callable[[float], object] = lambda share: None,
    axis: Axis | None = None,
    stages: Collection[str] | None = None,
    settings: Settings | None = None,
) -> FocusResult:
    """Return the default depth of a stack in µm, with all that goes with it.

    Parameters
    ----------
    frames : sequence of ndarray, shape (rows, cols)
        All frames.
    color : sequence of ndarray, shape (rows, cols, 3), optional
        What the image is made of instead.
    positions : ndarray, shape (n,)
        Position of each frame, µm.
    workers : int
        Threads.
    done : callable
        Told what share of the rows has been followed through all frames.
    axis : Axis, optional
        What the first stage finds, where that was found from the whole of a larger stack.
    stages : collection of str, optional
        Those of `STAGES` that run, in their order; by default all.
    settings : Settings, optional
        Others than the usual ones.
    """
    shape = frames[0].shape
    more = [max(8 - n, 0) for n in shape]
    if any(more):  # smaller ones are mirrored at their border
        mirrored = cv2.BORDER_REFLECT
        frames = [cv2.copyMakeBorder(f, 0, more[0], 0, more[1], mirrored) for f in frames]
    known = Known(frames, positions, workers, done, settings or Settings(), axis)
    for name, stage in STAGES.items():
        if stages is None or name in stages:
            known = stage(known)
    return result_of(known, frames if color is None else color, shape)


def average_frames(known: Known) -> Known:
    """Average as many frames as make a peak as wide as the settings want it."""
    if known.axis is not None:
        return known
    squares = [mosaic(frame) for frame in known.frames]
    axis = find_axis(squares, known.positions, known.settings.width)
    return replace(known, axis=replace(axis, bias=peak_asymmetry(squares, axis, known.settings)))


def follow_measures(known: Known) -> Known:
    """Follow the measures through the frames, and fit the peak of each pixel."""
    seen = follow(known.frames, known.axis, known.settings, workers=known.workers, done=known.done)
    levels = Levels.of(known.axis.noise, known.settings)
    nothing = np.zeros_like(seen.depth)
    return replace(
        known,
        seen=seen,
        levels=levels,
        depth=seen.depth.copy(),
        wide=doubled(seen.wide, seen.depth.shape),
        weight=relative(seen.strength, known.axis.typical),
        apart=np.nan_to_num(np.abs(seen.depth - seen.edge)),
        sharp=sharp_mask(seen, levels, *known.settings.sharp),
        relief=nothing,
        half_difference=nothing,
        pull=nothing,
        error=nothing,
    )


def mask_insignificant(known: Known) -> Known:
    """Set to NaN where the peak is no more than noise, and note the error of random depths."""
    seen, depth = known.seen, known.depth.copy()
    insignificant, random, near = judge_peaks(seen.profiles, seen.top, 2)
    depth[insignificant] = np.nan
    wide = np.where(near, known.wide, np.float32(np.nan))
    return replace(known, depth=depth, wide=wide, error=np.float32(known.axis.steps[-1]) * random)


def choose_sides(known: Known) -> Known:
    """Give each pixel the depth of its own side of a step."""
    unknown = np.isnan(known.depth)
    broad = without_spikes(fill_nearest(known.depth))
    sided, apart = choose_side(broad, fill_nearest(known.seen.edge), 3, known.settings.jump)
    depth = np.where(unknown, np.float32(np.nan), without_spikes(sided))
    return replace(known, depth=depth, apart=apart)


def ask_wide_windows(known: Known) -> Known:
    """Take the depth by a wide window where the others are of blurred light."""
    depth, weight = known.depth.copy(), known.weight.copy()
    finer = sharp_mask(known.seen, known.levels, *known.settings.finer)
    instead, neither = rules.check_wide(
        depth, known.wide, known.apart, known.sharp, finer, known.settings
    )
    depth[neither] = np.nan
    depth[instead], weight[instead] = known.wide[instead], known.settings.wide_weight
    return replace(known, depth=depth, weight=weight)


def refuse_halos(known: Known) -> Known:
    """Set faint peaks beside bright ones to NaN."""
    halo = rules.blurred_edge_mask(known.depth, known.weight, known.settings) & ~known.sharp
    return replace(known, depth=np.where(halo, np.float32(np.nan), known.depth))


def refuse_specks(known: Known) -> Known:
    """Set specks, and what has few known pixels around it, to NaN."""
    settings, depth = known.settings, known.depth.copy()
    depth[rules.small_piece_mask(depth, settings.speck, settings.jump)] = np.nan
    depth[rules.isolated_mask(depth, settings.surroundings)] = np.nan
    return replace(known, depth=depth)


def smooth(known: Known) -> Known:
    """Smooth the depth by planes, on its own side of a step."""
    jump, sigma, workers = known.settings.jump, known.settings.radius, known.workers
    depth = smooth_planes(known.depth, known.weight, jump=jump, sigma=sigma, workers=workers)
    return replace(known, depth=depth)


def add_relief(known: Known) -> Known:
    """Find the relief that the smoothing took away, on which two directions agree."""
    seen, most = known.seen, known.settings.most_relief
    level = np.nan_to_num(known.depth)
    there = np.isfinite(known.depth) & (np.abs(seen.depth - known.depth) < known.settings.own)
    offsets, strengths = [], []
    for window in (seen.along, seen.down):
        depth, strength = fit_peaks(window, seen.best, known.axis.steps, near=level, within=most)
        good = there & (strength > 0) & np.isfinite(depth)
        offset = np.clip(depth - level, -most, most)
        offsets.append(np.where(good, offset, np.float32(0)))
        strengths.append(np.where(good, strength, np.float32(0)))
    mass = np.sqrt(np.sqrt(strengths[0] * strengths[1]))
    middle = np.maximum(np.median(mass), TINY)
    mass = np.where(mass > 0, np.clip(mass / middle, 0.01, 100), np.float32(0))
    relief, half = _relief.find_relief(offsets[0], offsets[1], mass, known.settings)
    return replace(known, relief=relief, half_difference=half)


def undo_pull(known: Known) -> Known:
    """Undo what the frames pull the depth towards themselves."""
    pull = _relief.frame_pull(known.depth, known.axis)
    return replace(known, depth=known.depth - pull, pull=pull)


def state_errors(known: Known) -> Known:
    """State how far the depth may be wrong."""
    axis = known.axis
    light = np.interp(np.nan_to_num(known.depth), axis.steps, axis.light).astype(np.float32)
    # By texture the frames pull up to half as much more or less.
    pull = np.hypot(light, known.pull / 2)
    variance = _relief.error_variance(
        known.depth + known.relief, known.half_difference, pull, known.apart, known.settings
    )
    # A thing too thin for the windows has a peak of its own, by two measures.
    own = cv2.medianBlur(fill_nearest(known.seen.depth), 3)
    gap = np.minimum(relative(known.seen.strength, axis.typical), 1) * np.abs(own - known.depth)
    gap[~(gap > known.settings.jump)] = 0
    variance += (0.5 * cv2.dilate(gap, np.ones((7, 7), np.uint8))) ** 2
    return replace(known, error=np.sqrt(variance + known.error**2))


def enlarge(known: Known) -> Known:
    """Interpolate the depth at full size, but take the nearest one at steps."""
    shape, depth, relief = known.frames[0].shape, known.depth, known.relief
    full = doubled(fill_nearest(depth), shape)
    fine = np.where(np.isfinite(depth), relief, np.float32(0))
    full = full + doubled(fine, shape, cv2.INTER_CUBIC)
    both = fill_nearest(depth + relief)
    sudden = doubled(step_height(both) > 2, shape)
    full[sudden] = doubled(both, shape, cv2.INTER_NEAREST)[sudden]
    return replace(known, full=full, there=doubled(np.isfinite(depth), shape))


def fit_at_full_size(known: Known) -> Known:
    """Fit the peaks again at full size where the depth is steep or has a step, and just beside."""
    rises = depth_range(fill_nearest(known.depth), 3) > known.settings.jump
    steep = cv2.dilate(rises.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    steep = doubled(steep, known.full.shape)
    full, there = known.full.copy(), known.there.copy()
    for rows, cols in steep_blocks(steep):
        start = max(rows.start - _SEEN, 0)
        new = _closer(known, (slice(start, rows.stop + _SEEN), cols))
        new = new[rows.start - start :][: rows.stop - rows.start]
        good = np.isfinite(new) & steep[rows, cols]
        full[rows, cols][good] = new[good]
        there[rows, cols] |= good
    return replace(known, full=full, there=there)


#: Stages of the default depth, in their order. Frames are not averaged if the settings' `width` is
#: infinite.
STAGES: dict[str, Callable[[Known], Known]] = {
    "averaged frames": average_frames,
    "measures and peaks": follow_measures,
    "significance": mask_insignificant,
    "sides of steps": choose_sides,
    "wide windows": ask_wide_windows,
    "halos": refuse_halos,
    "specks": refuse_specks,
    "smoothing": smooth,
    "relief": add_relief,
    "pull of frames": undo_pull,
    "stated errors": state_errors,
    "enlarged": enlarge,
    "full size": fit_at_full_size,
}


#: Stages that cannot be left out.
NEEDED = ("averaged frames", "measures and peaks", "enlarged")


def result_of(known: Known, shown: Sequence[Image], shape: tuple[int, ...]) -> FocusResult:
    """Return what is known at last, in µm."""
    axis, full, here = known.axis, known.full, tuple(slice(n) for n in shape)
    height = step_height(full)
    height[height < 2 * known.settings.jump] = 0
    # 0.2 to 0.3 of the height on drawn texture, 0.5 where the near side hides the far one, 0.5 to
    # 0.8 on photographs.
    error = np.hypot(doubled(known.error, full.shape), np.float32(0.28) * height)
    depth = axis.micrometers(np.where(known.there, full, np.float32(np.nan)))[here]
    bias = np.polyval(axis.bias, depth).astype(np.float32)
    # A quarter of the bias remains at most where it changes along the axis.
    error = np.hypot(error[here] * np.float32(axis.spacing), bias / 4)
    depth = np.clip(depth - bias, axis.positions.min(), axis.positions.max()).astype(np.float32)
    best = doubled(known.seen.best, full.shape, cv2.INTER_NEAREST)[here]
    order = np.argsort(axis.positions)
    nearest = np.rint(np.interp(depth, axis.positions[order], order))
    middles = (axis.ends[:-1] + axis.ends[1:]) // 2
    return finished(
        depth,
        error,
        np.where(np.isfinite(depth), nearest, middles[best]).astype(np.int32),
        spacing=axis.spacing,
        at_end=(best == 0) | (best == len(axis.steps) - 1),
        shown=(frame[here] for frame in shown),
    )


# --- What the stages are made of ----------------------------------------------------------------


def factors(seen: Followed, levels: Levels) -> tuple[NDArray, NDArray]:
    """Return the fine and the coarse factor of each peak, with their floors."""
    middle = len(seen.along) // 2
    fine = seen.along[middle] + seen.down[middle] + np.float32(levels.fine)
    return fine, seen.top / fine


def sharp_mask(seen: Followed, levels: Levels, share: float, noise: float) -> NDArray[np.bool_]:
    """Tell where the sharpest frame has fine detail of its own, which no blurred light has."""
    fine, coarse = factors(seen, levels)
    above = blur(fine - np.float32((1 + noise) * levels.fine), 1.0)
    return np.asarray(above > share * blur(coarse - np.float32(levels.coarse), 1.0))


def typical(strength: NDArray) -> float:
    """Return the median of the strengths of all peaks."""
    fitted = strength > 0
    return float(np.median(strength[fitted])) if fitted.any() else 1.0


def relative(strength: NDArray, usual: float | None = None) -> NDArray:
    """Return strengths over the usual or their median, 1 where a depth came without a fit."""
    share = strength / np.float32(usual or typical(strength))
    return np.where(strength > 0, share, np.float32(1))


# --- At full size, where it is steep ------------------------------------------------------------


def steep_blocks(steep: NDArray[np.bool_]) -> Iterator[tuple[slice, slice]]:
    """Yield the parts of strips of rows in which it is steep, with some columns beside them."""
    around = np.ones((1, 2 * _SEEN + 1), np.uint8)
    for top in range(0, len(steep), GRID):
        strip = steep[top : top + GRID]
        columns = np.atleast_2d(strip.any(axis=0)).astype(np.uint8)
        busy = np.asarray(cv2.dilate(columns, around))[0]
        for left, right in np.flatnonzero(np.diff(busy, prepend=0, append=0)).reshape(-1, 2):
            first, last = top + np.flatnonzero(strip[:, left:right].any(axis=1))[[0, -1]]
            yield slice(int(first), int(last) + 1), slice(int(left), int(right))


def _closer(known: Known, view: tuple[slice, slice]) -> NDArray:
    """Return the depths of one block from measures at full size; NaN where they are lost."""
    settings, rough = known.settings, known.full[view]
    # No further from the depths around than two jumps.
    square, beyond = np.ones((13, 13), np.uint8), 2 * settings.jump
    low, high = cv2.erode(rough, square), cv2.dilate(rough, square)
    main, edge, part = _follow_view(known, view, low - beyond, high + beyond)
    broad, strength = fit_peaks(main.windows()[0], main.best, part)
    sharp, _ = fit_peaks(edge.windows()[0], edge.best, part)
    own, apart = choose_side(without_spikes(broad, 5), sharp, 5, settings.jump)
    own = without_spikes(own)
    mean = blur(main.top, 2.0)
    strongest = cv2.dilate(mean, np.ones((settings.strongest,) * 2, np.uint8))
    clear = (mean > settings.share * strongest) & (cv2.medianBlur(apart, 5) < settings.agrees)
    # A depth that none has around it needs the evidence that a lost one needs.
    within = known.there[view] & (low <= own) & (own <= high)
    depth = np.where(within | clear, own, np.float32(np.nan))
    sigma = 2 * settings.radius
    return smooth_planes(depth, relative(strength), jump=settings.jump, sigma=sigma)


def _follow_view(
    known: Known, view: tuple[slice, slice], low: NDArray, high: NDArray
) -> tuple[PeakFollower, PeakFollower, Array]:
    """Follow the measures of a part of the image at full size, at steps from low to high.

    Returns
    -------
    main, edge : PeakFollower
    part : ndarray
        The steps that were looked at.
    """
    axis, levels, settings = known.axis, known.levels, known.settings
    near = np.flatnonzero((axis.steps > low.min() - 1) & (axis.steps < high.max() + 1))
    first = min(int(near[0]), len(axis.steps) - 3)
    part = axis.steps[first : max(int(near[-1]) + 1, first + 3)]
    main = PeakFollower(len(part), 1, low.shape, 3)
    edge = PeakFollower(len(part), 1, low.shape, 1)
    fine, coarse = np.float32(levels.fine), np.float32(levels.coarse)
    floor = np.float32(2 * levels.edge)  # of noise that was not halved
    for k, step in enumerate(part):
        frame = axis.frame(known.frames, first + k, view).astype(np.float32)
        wider = np.add(*absolute_seconds(halved(frame), settings.coarse))
        wider = doubled(blur(wider, settings.coarse_window), frame.shape)
        own = blur(np.add(*absolute_seconds(frame, settings.fine)), 0.8)
        np.multiply(own + fine, wider + coarse, out=main.slot(k)[0])
        allowed = (low <= step) & (step <= high)
        main.push(k, allowed)
        off = cv2.absdiff(frame, blur(frame, 2 * settings.edge_mean))
        np.multiply(blur(off, 0.5) + floor, blur(off, 2.0) + floor, out=edge.slot(k)[0])
        edge.push(k, allowed)
    return main, edge, part
