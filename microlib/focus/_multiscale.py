"""The default depth of a part of an image, step by step, as it would be in the whole image.

What needs the whole image is asked for (`_questions.py`), and what is looked at around a pixel
reaches so far and no further (`_AROUND`): a tile has the depth of the whole image to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.focus._bands import median_above_zero
from microlib.focus._correction import smooth_by_planes
from microlib.focus._directions import directional_depths, nearest_frames
from microlib.focus._flicker import flicker_variance
from microlib.focus._halos import Wide, check_halos, scene_around
from microlib.focus._measures import (
    edge_measure,
    multiscale_measure,
    noise_level,
    noise_response,
    noise_sample,
)
from microlib.focus._nearest import enlarged, filled
from microlib.focus._peaks import track_peaks
from microlib.focus._questions import Question, Steps
from microlib.focus._reliability import (
    below_noise_mask,
    blurred_edge_mask,
    incoherent_mask,
    isolated_mask,
    set_to_nan,
    small_component_mask,
)
from microlib.focus._relief import find_relief
from microlib.focus._scale import averaged, averaged_positions, group_sizes
from microlib.focus._window import Window

__all__ = ["Axis", "Maps", "Part", "depth_steps", "seen_around"]

# The constants of the default depth. What the result owes to each is measured in the table
# "constant changed" of benchmarks/focus.py; lengths along the axis are in frames.

#: Sides of the medians that find spikes before and after the choice of a side, px, and how far from
#: its median a spike lies, frames.
_SPIKE_WINDOWS, _SPIKE = (5, 3), 1.0
#: Side of the medians that steady the fine depth, px, and its spread below which it is trusted.
_FINE_WINDOW, _FINE_SPREAD = 5, 1.0
#: Distances at which a pixel's own side is sought, px; the difference of fine and broad depth from
#: which it is sought, and up to which a neighbor agrees, frames; how much better one must agree for
#: each px that it is further away, frames.
_SIDE_DISTANCES, _SIDE_GAP, _SIDE_AGREES, _SIDE_SLOPE = (3, 6), 1.5, 1.0, 0.05
#: Difference in depth across which nothing is smoothed, frames, and the smoothing's radius, px.
_JUMP, _WIDE = 1.5, 7.0
#: Largest ratio of a pixel's inverse variance to the median, either way: one pixel shall not decide
#: alone. From 1e3 to 1e5 nothing changes.
_WEIGHTS = 1e4
#: Weight of a depth by the wide window, where the median of the others is 1: its error is some
#: seven times theirs.
_WIDE_WEIGHT = 0.02
#: Reach of the broad windows that matters, px; the least share of it that a pixel is given, and the
#: power of that share that weighs it. In the outermost 8 px the weights pay on patchy texture and
#: JPEG (error 0.8 times that without) and cost on planes (up to 1.9 times); table "outermost 8 px"
#: of benchmarks/focus.py. Further in nothing depends on them.
_BORDER_REACH, _BORDER_LEAST, _BORDER_POWER = 8, 0.1, 4

# How far around a pixel something is looked at, px: what is further away changes no bit of it.
# Each is the sum of what its steps look at, one after the other, in pixels of the full frame.

#: For relief, in the smoothed depth and in frames: the mean of what is composed 36, two
#: enlargements 4, the widest window of agreement 68, the widest band 14, the measures 8.
_RELIEF_AROUND = 130
#: For the smoothed depth, in frames by its peaks: two planes 28, what is isolated 14, small
#: surfaces 51, blurred edges 26, things of their own 24, disagreement 11, and depths that are
#: filled in 21; and for the peak itself, noise around it 14 and the measure 24.
_PEAKS_AROUND = _RELIEF_AROUND + 213
#: For the same by the wide window: as for peaks up to things of their own 143,
#: the wide window's own blurred edges 104, its window 24, and what it averages 16; between them
#: steps hidden in the unknown 82 or, if that is more, the scene blurred anew.
_WIDE_AROUND, _HIDDEN_AROUND = _RELIEF_AROUND + 143 + 144, 82


@dataclass(frozen=True)
class Axis:
    """The frames of a stack along the optical axis.

    Attributes
    ----------
    positions : ndarray of float64, shape (n,)
        Position of each frame, µm.
    levels : ndarray of float64, shape (n,)
        Mean grey level of each frame.
    width : float
        Width of the stack's peaks, frames, as `peak_width` returns it.
    """

    positions: Array
    levels: Array
    width: float

    @property
    def sizes(self) -> NDArray[np.intp]:
        """How many frames are averaged into each."""
        return group_sizes(len(self.positions), self.width)

    @property
    def means(self) -> Array:
        """Positions of the averaged frames, µm."""
        return averaged_positions(self.positions, self.sizes)

    @property
    def spacing(self) -> float:
        """Distance of averaged frames, µm."""
        return float(np.median(np.abs(np.diff(self.means))))


@dataclass(frozen=True)
class Part:
    """A part of a stack.

    Attributes
    ----------
    frames : callable
        Gives the frames of `window` anew, each time it is called.
    window : Window
        What the frames show.
    wanted : Window
        What is to be computed.
    """

    frames: Callable[[], Iterator[Image]]
    window: Window
    wanted: Window

    def seen(self, window: Window) -> Iterator[Image]:
        """Yield what the frames show of a smaller window."""
        return _cut(self.frames(), window, self.window)


@dataclass(frozen=True)
class Maps:
    """The default depth of a part of an image.

    Attributes
    ----------
    depth : ndarray of float64, shape (rows, cols)
        Depth, µm; NaN where unknown.
    error : ndarray of float32, shape (rows, cols)
        Its error, averaged frames.
    best : ndarray of uint16, shape (rows, cols)
        Number of the frame nearest to it, or where there is none of the sharpest.
    image : ndarray, shape (rows, cols)
        Every pixel from that frame.
    at_end : ndarray of bool, shape (rows, cols)
        Whether the sharpest averaged frame is the first or the last.
    """

    depth: Array
    error: NDArray[np.float32]
    best: NDArray[np.uint16]
    image: Image
    at_end: NDArray[np.bool_]


def depth_steps(
    part: Part,
    axis: Axis,
    *,
    points: int,
    batch: int,
    workers: int,
    thorough: bool = False,
) -> Steps[Maps]:
    """Find the depth by the product of two scales, correct it, and put fine relief back.

    Parameters
    ----------
    part : Part
        Frames, and what of them is wanted.
    axis : Axis
        Where the frames lie.
    points, batch, workers : int
        As for `depth_from_focus` and `track_peaks`.
    thorough : bool
        Whether to ask what no pixel here, but perhaps another, has need of.

    Returns
    -------
    Maps
        The depth and what goes with it.
    """
    z, sizes, spacing = axis.means, axis.sizes, axis.spacing
    positions = axis.positions
    near = part.wanted.grown(_PEAKS_AROUND, part.window)
    coarse = _coarse_steps(
        part, axis, near, points=points, batch=batch, workers=workers, thorough=thorough
    )
    smooth, doubtful, index = yield from coarse
    inner = part.wanted.grown(_RELIEF_AROUND, near)
    here = inner.inside(near)
    smooth, doubtful, index = smooth[here], doubtful[here], index[here]
    frames = _averaged(part, axis, inner)
    # Not held here: the relief lets go of them as soon as it can.
    relief = yield from find_relief(
        smooth,
        directional_depths(frames, z, smooth * spacing, batch=batch, workers=workers),
        doubtful,
        workers=workers,
    )
    depth = np.clip((smooth + relief.offset) * spacing, positions.min(), positions.max())
    # The pull changes with the depth alone: every second pixel tells it.
    half = np.interp(depth[::2, ::2], *_rising(z))
    pull = flicker_variance(half, axis.levels, sizes, axis.width)
    error = np.sqrt(relief.variance + enlarged(pull, depth.shape))
    here = part.wanted.inside(inner)
    depth, error, index = (np.ascontiguousarray(map_[here]) for map_ in (depth, error, index))
    middles = (np.cumsum(sizes) - sizes + sizes // 2).astype(np.uint16)
    best = _nearest_frame(depth, positions, middles[index])
    at_end = (index == 0) | (index == len(z) - 1)
    return Maps(depth, error, best, _picked(part.seen(part.wanted), best), at_end)


def _averaged(part: Part, axis: Axis, window: Window) -> Iterator[Image]:
    """Yield what the averaged frames show of a window."""
    frames, sizes = part.seen(window), axis.sizes
    return frames if len(sizes) == len(axis.positions) else averaged(frames, sizes)


def _coarse_steps(
    part: Part,
    axis: Axis,
    near: Window,
    *,
    points: int,
    batch: int,
    workers: int,
    thorough: bool,
) -> Steps[tuple[Array, NDArray[np.bool_], NDArray[np.uint16]]]:
    """Find the smoothed depth of a window, where it is doubtful, and the sharpest frames."""
    z, spacing, positions = axis.means, axis.spacing, axis.positions
    window = part.window

    def frames(inner: Window = window) -> Iterator[Image]:
        return _averaged(part, axis, inner)

    noise = yield Question("noise", lambda: [noise_sample(next(frames()))], _noise)
    profile = track_peaks(
        frames(near),
        z,
        [multiscale_measure(noise), edge_measure(noise)],
        reaches=[points // 2, 1],
        ends=(positions[0], positions[-1]),
        pictured=False,
        batch=batch,
        workers=workers,
    )
    (depth, fine), index = profile.depths, profile.index
    set_to_nan(depth, incoherent_mask(index, len(z)))
    inverse_variance = None
    if profile.peak is not None:
        with np.errstate(invalid="ignore", divide="ignore"):  # a stack without any noise
            ratio = profile.peak.value / np.float32(noise_response(noise))
        depth[below_noise_mask(ratio, len(z))] = np.nan
        inverse_variance = profile.peak.inverse_variance
        del ratio
    del profile
    sided, disagreement = _sided(depth, fine, spacing)
    del depth, fine
    place = np.interp(sided[::2, ::2] * spacing, *_rising(z))
    wide = yield from check_halos(
        frames,
        len(z),
        _put_into(window, near, place, np.nan),
        _put_into(window, near, disagreement[::2, ::2], 0),
        noise,
        window=window,
        thorough=thorough,
    )
    wide = _part_of(wide, near.inside(window, 2))
    del disagreement
    steps, weight = yield from _with_wide(sided, inverse_variance, wide, z / spacing)
    del sided, inverse_variance
    smooth = _smoothed(steps, weight, near, z / spacing, workers)
    doubtful = np.isnan(smooth) | _doubled(wide.instead | wide.neither, smooth.shape)
    return smooth, doubtful, index


def seen_around(wanted: Window, blur_rate: float | None) -> Window:
    """Return what must be seen of an image for the depth of a part of it."""
    return wanted.grown(_WIDE_AROUND + max(_HIDDEN_AROUND, scene_around(blur_rate or 0.0)))


def _noise(samples: list[list]) -> float:
    return noise_level([part for parts in samples for part in parts])


def _cut(frames: Iterable[Image], inner: Window, outer: Window) -> Iterator[Image]:
    if inner == outer:
        yield from frames
        return
    here = inner.inside(outer)
    for frame in frames:
        yield np.ascontiguousarray(frame[here])


def _put_into(outer: Window, inner: Window, values: NDArray, otherwise: float) -> NDArray:
    """Return an array of every second pixel of the outer window with the inner one's values."""
    if inner == outer:
        return values
    result = np.full([-(-length // 2) for length in outer.size], otherwise, values.dtype)
    result[inner.inside(outer, 2)] = values
    return result


def _part_of(wide: Wide, here: tuple[slice, slice]) -> Wide:
    return Wide(wide.depth[here], wide.instead[here], wide.neither[here])


def _rising(positions: Array) -> tuple[Array, Array]:
    """Return positions in rising order, and the number of the frame at each."""
    order = np.argsort(positions)
    return positions[order], order.astype(float)


def _sided(depth: NDArray, fine: NDArray, spacing: float) -> tuple[Array, NDArray]:
    """Take out spikes and put pixels at steps on their own side; in frames.

    Also returned is how far both depths lie from each other.
    """
    known = np.isfinite(depth)
    if not known.any():
        return depth / spacing, np.zeros(depth.shape, np.float32)
    broad = _without_spikes(filled(depth) / np.float32(spacing), _SPIKE_WINDOWS[0])
    sharp = filled(fine) / np.float32(spacing)
    median = cv2.medianBlur(sharp, _FINE_WINDOW)
    spread = np.asarray(cv2.medianBlur(np.abs(sharp - median), _FINE_WINDOW))
    steady = np.asarray(cv2.medianBlur(median, _FINE_WINDOW))
    sided = _choose_side(broad, steady, spread < _FINE_SPREAD)
    own = np.where(known, _without_spikes(sided, _SPIKE_WINDOWS[1]), np.nan)
    return own, np.abs(broad - median)


def _with_wide(
    depth: Array, inverse_variance: NDArray | None, wide: Wide, steps: Array
) -> Steps[tuple[Array, NDArray]]:
    """Put the wide depth where it is the better, and return the weight of every depth too."""
    there, neither = (_doubled(mask, depth.shape) for mask in (wide.instead, wide.neither))
    broad = enlarged(wide.depth, depth.shape)
    there &= np.isfinite(broad)
    weight = np.ones(depth.shape, np.float32)
    if inverse_variance is not None:
        # At an end of the stack a depth may come without a fit and so without a variance.
        fitted = np.isfinite(depth) & (inverse_variance > 0)
        typical = yield Question(
            "strength",
            lambda: inverse_variance[::2, ::2][fitted[::2, ::2]],
            lambda samples: median_above_zero(np.concatenate(samples)),
        )
        relative = np.clip(inverse_variance / typical, 1 / _WEIGHTS, _WEIGHTS)
        weight = np.where(fitted, relative, 1).astype(np.float32)
    weight[there] = _WIDE_WEIGHT
    depth = np.where(neither, np.nan, depth)
    depth[there] = np.interp(broad[there], np.arange(len(steps)), steps)
    return depth, weight


def _doubled(mask: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return the mask for which one of half the size stands, two pixels by two."""
    rows, cols = shape
    return mask.repeat(2, axis=0)[:rows].repeat(2, axis=1)[:, :cols]


def _smoothed(
    steps: Array, weight: NDArray, window: Window, positions: Array, workers: int
) -> Array:
    """Leave out what is not to be believed, and smooth on both sides of steps."""
    lowest, highest = positions.min(), positions.max()
    set_to_nan(steps, blurred_edge_mask(steps, weight))
    steps[small_component_mask(steps, lowest)] = np.nan
    steps[isolated_mask(steps)] = np.nan
    if np.isnan(steps).all():
        return steps
    # At the image's border the windows see one side only and pull a slope inwards: there the planes
    # are to be laid through what lies further in.
    weight *= _inside(window) ** _BORDER_POWER
    options = {"middle": (lowest + highest) / 2, "jump": _JUMP, "radius": _WIDE}
    return smooth_by_planes(steps, weight, **options, workers=workers)


def _inside(window: Window) -> NDArray[np.float32]:
    """Return 1 where the broad windows stay inside the image, less towards its border."""
    down, along = window.border()
    far = (1 + np.minimum.outer(down, along).astype(np.float32)) / _BORDER_REACH
    return np.clip(far, _BORDER_LEAST, 1.0)


def _without_spikes(depth: NDArray, window: int) -> NDArray:
    """Replace by the median what is too far from it."""
    median = cv2.medianBlur(depth, window)
    return np.where(np.abs(depth - median) > _SPIKE, median, depth)


def _choose_side(broad: NDArray, fine: NDArray, sure: NDArray[np.bool_]) -> NDArray:
    """Where fine and broad depth differ, take a neighbor's broad depth that agrees with the fine.

    Next to a step the broad window sees the other side as well, and the better textured side
    wins. A few pixels away, on the pixel's own side, it does not.
    """
    far = max(_SIDE_DISTANCES)
    padded = np.pad(broad, far, mode="symmetric")
    rows, cols = np.nonzero(sure & (np.abs(broad - fine) > _SIDE_GAP))
    own, found = fine[rows, cols], broad[rows, cols]
    gap = np.abs(found - own)
    for distance in _SIDE_DISTANCES:
        for dy, dx in product((-distance, 0, distance), repeat=2):
            there = padded[rows + (far + dy), cols + (far + dx)]
            # Nearer neighbors first: what is further away must agree the better.
            other = np.abs(there - own) + np.float32(_SIDE_SLOPE * distance)
            better = (other < gap) & (other < _SIDE_AGREES)
            found = np.where(better, there, found)
            gap = np.where(better, other, gap)
    result = broad.copy()
    result[rows, cols] = found
    return result


def _nearest_frame(depth: Array, positions: Array, otherwise: NDArray) -> NDArray[np.uint16]:
    """Return the number of the frame nearest to each depth, or another where there is none."""
    nearest = nearest_frames(depth, positions)
    np.copyto(nearest, otherwise, where=np.isnan(depth))
    return nearest


def _picked(frames: Iterable[Image], number: NDArray[np.uint16]) -> Image:
    """Return every pixel from the frame of that number."""
    for k, frame in enumerate(frames):
        if k == 0:
            image = frame.copy()
        else:
            np.copyto(image, frame, where=number == k)
    return image
