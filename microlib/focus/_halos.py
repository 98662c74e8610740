"""Depths that only blurred light gives, found by imaging the scene again, and what stands there.

Beside a strong edge the blur of the edge is the largest change of all frames, at a wrong depth. A
wide window sees the edge itself and is right there, but wrong beside a step. So where the two
differ, the scene as the wide depth has it is blurred as far as the other depth is out of its focus.
Light that is so blurred has no finer detail than the blurred scene has, however bright it is: where
no finer was measured, the wide depth stands. On bare ground noise and compression have the largest
change in some frame or other: there depths by two measures differ, and the wide depth stands too.
All at half the frames' size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.focus._filters import energy_rows, gaussian_taps, own_room
from microlib.focus._measures import Banded, Scale, blur, blur_side, box
from microlib.focus._nearest import enlarged, filled, gradients, halved
from microlib.focus._peaks import track_peaks
from microlib.focus._questions import Question, Steps
from microlib.focus._reliability import blurred_edge_mask, set_to_nan
from microlib.focus._window import Window

# What the default owes to each constant is measured in benchmarks/focus_depth.py. Pixels are those
# of the frames at half their size.

#: Smoothings before the second differences of fine and of coarse detail, px.
_FINE, _COARSE = 0.8, 1.8
#: Side of the wide window in every second pixel, and of the narrow one, px: 52 and 10 in the frame.
_WIDE, _NARROW = 13, 5
#: Difference from which two depths are not the same, frames.
_GAP = 1.2
#: Sides of the squares in which the wide depth is looked for nearby, px: what lies between its
#: depths there is believed. On a steep flank the wide window is late, by less than its reach;
#: beside a step it shows the better lit side up to its whole reach beyond the edge.
_NEARBY, _REACH = 11, 27
#: Mean distance of depths by two measures in a square of this side, px, from which on they have no
#: peak in common, and the most that one pixel counts, frames. Rendered: below 0.3 the mean error is
#: half a frame at the most, on relief too; above 0.4, on photographs, 1 to 5 frames.
_ERRATIC, _ERRATIC_SIDE, _MOST_DISAGREEMENT = 0.3, 11, 3.0
#: The difference there from which two depths are not the same, frames: twice that of a depth by
#: weak texture from the truth. Beside steps twice as much: unknown is what cannot be kept.
_ERRATIC_GAP = 0.4
#: Slope of the wide depth that is a step, frames/px.
_CLIFF = 0.5
#: How far from a step that was not seen itself no wide depth is taken, over its window's reach: at
#: 1.0 a fiftieth of all pixels beside a step with one faint side are wrong, from 1.25 on less.
_HIDDEN = 1.25
#: Further than any frame.
_FAR = 2.0**17
#: Distances from focus at which the scene is imaged again, frames.
_LADDER = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)
#: How far the light of an edge may lie from where it is expected, as frames are never quite of one
#: scale and place: side of a square, px.
_ASTRAY = 5
#: Share of fine detail over that of the blurred scene above which there is a thing of its own, and
#: its least energy over the noise. Of halos on rendered scenes 95 % stay below 1.0, on a real one
#: with JPEG and saturated lettering below 2.7; of things 36 px wide 5 % stay below 1.9.
_FINER, _ABOVE_NOISE = 2.5, 2.0
#: Least area of a thing of its own, px.
_AREA = 12
#: Least wide peak over the noise: averaged over 600 px² that varies by a tenth of itself, and the
#: highest of 300 frames is 1.3 times the mean.
_CLEAR = 2.0
#: Blurs among which that of a frame out of focus is sought, px, and distances of such frames.
_BLURS, _DISTANCES = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0), (1, 2, 3, 4, 5, 6)
#: Share of a frame that is taken for its quietest, %.
_QUIET = 5
#: Energy of white noise of unit variance in the full frame, at half its size, fine and coarse.
_NOISE_FINE, _NOISE_COARSE = (
    0.5 * (Scale(smooth, 1.0).gain / (2 * np.sqrt(2 / np.pi))) ** 2 for smooth in (_FINE, _COARSE)
)


@dataclass(frozen=True)
class Wide:
    """What the wide window says, at half the frames' size.

    Attributes
    ----------
    depth : ndarray of float32, shape (rows, cols)
        Depth, frames; NaN where no peak stands out of the noise.
    instead : ndarray of bool, shape (rows, cols)
        Where it is to be taken in place of the other depth.
    neither : ndarray of bool, shape (rows, cols)
        Where the other depth is that of blurred light or of noise, and the wide one is unknown or
        may be that of the other side of a step.
    """

    depth: NDArray[np.float32]
    instead: NDArray[np.bool_]
    neither: NDArray[np.bool_]


def check_halos(
    frames: Callable[[], Iterator[Image]],
    count: int,
    depth: Array,
    disagreement: NDArray,
    noise: float,
    *,
    window: Window,
    thorough: bool = False,
) -> Steps[Wide]:
    """Find where a depth is only that of blurred light, and the depth by a wide window.

    Parameters
    ----------
    frames : callable
        Gives the frames of the stack anew, each time it is called.
    count : int
        Number of frames.
    depth : ndarray, shape (rows, cols)
        Depth of every second pixel, as a number of frames; NaN where unknown.
    disagreement : ndarray, shape (rows, cols)
        How far it is from the depth by another measure there, frames.
    noise : float
        Standard deviation of the frames' noise, grey levels.
    window : Window
        Where the frames lie in the image.
    thorough : bool
        Whether to measure the growth of the blur even if no depth here asks for it.

    Returns
    -------
    Wide
        The wide depth, and where it takes the place of the other one.
    """
    wide, silence = yield from _wide_depth(frames(), count, _NOISE_FINE * noise**2)
    narrow = np.asarray(depth, np.float32)
    overhang = _overhang(window)
    # Between a step and what the wide window does not know it may show the wrong side.
    plain = _steepest(np.nan_to_num(wide)) < _CLIFF
    differs = _differs(narrow, wide, overhang, _NEARBY)
    differs &= plain | _differs(narrow, wide, overhang, _REACH)
    gap = np.isnan(narrow) & np.isfinite(wide)
    erratic = _erratic(disagreement)
    blurred = np.zeros_like(gap)
    if thorough or differs.any():
        scene, fine, coarse = _scene(frames(), wide, narrow, differs)
        rate = yield Question("blur_rate", lambda: _misfit(frames(), scene, wide), _growth)
        measured = _share(fine, coarse, silence)
        expected = _expected(scene, rate, np.abs(narrow - wide))
        finer = (measured > _FINER * expected) & (fine > _ABOVE_NOISE * silence)
        blurred = differs & ~_large(differs & finer & ~erratic)
    instead = (gap | blurred) & plain
    neither = blurred & ~plain
    if erratic.any():
        # A random depth is worse than the wide one; beside a step it is none if it is far off.
        stray, far = (
            erratic & _differs(narrow, wide, overhang, _NEARBY, k * _ERRATIC_GAP) for k in (1, 2)
        )
        instead |= stray & _away_from_steps(wide)
        neither = ((neither | far) & ~instead) | (erratic & np.isnan(wide))
    return Wide(wide, instead, neither)


def _erratic(disagreement: NDArray) -> NDArray[np.bool_]:
    """Tell where depths by two measures differ at random, at half the size."""
    half = np.minimum(disagreement, np.float32(_MOST_DISAGREEMENT)).astype(np.float32)
    return box(half, _ERRATIC_SIDE) > _ERRATIC


def _differs(
    narrow: NDArray[np.float32],
    wide: NDArray[np.float32],
    overhang: NDArray[np.float32],
    nearby: int,
    gap: float = _GAP,
) -> NDArray[np.bool_]:
    """Tell where a depth is none of the wide ones nearby."""
    known = np.isfinite(wide)
    tolerance = gap + overhang * _steepest(np.where(known, wide, 0))
    square = np.ones((nearby, nearby), np.uint8)
    lowest = cv2.erode(np.where(known, wide, np.float32(_FAR)), square)
    highest = cv2.dilate(np.where(known, wide, np.float32(-_FAR)), square)
    beyond = (narrow < lowest - tolerance) | (narrow > highest + tolerance)
    return np.asarray(known & beyond)


def _overhang(window: Window) -> NDArray[np.float32]:
    """Return by how many px the part of a wide window that is in the image lies further inside."""
    down, along = window.border(2)
    outside = np.add.outer(np.maximum(_WIDE - down, 0), np.maximum(_WIDE - along, 0))
    return (outside / 2).astype(np.float32)


def _away_from_steps(wide: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Tell where the wide depth is that of the pixel's own side, though it is not known all around.

    A step that lies somewhere in what is not known is taken for in its middle, so that the side
    that is shown beyond the step ends further away from there than a wide window reaches.
    """
    whole = filled(wide)
    hidden = np.isnan(wide) & (_slope(whole) >= _CLIFF)
    side = 2 * round(_HIDDEN * _WIDE) + 1
    reached = cv2.dilate(hidden.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    return np.asarray((_steepest(whole) < _CLIFF) & ~reached)


def _slope(wide: NDArray[np.float32]) -> NDArray[np.float32]:
    down, along = gradients(wide)
    return np.asarray(np.hypot(down, along))


def _steepest(wide: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the steepest slope within the reach of a wide window."""
    side = 2 * _WIDE + 1
    return np.asarray(cv2.dilate(_slope(wide), np.ones((side, side), np.uint8)))


def _energy(half: NDArray[np.float32], smooth: float = _FINE) -> NDArray[np.float32]:
    """Return the squared second differences, which add up where light does."""
    out = np.empty(half.shape, np.float32)
    energy_rows(half, gaussian_taps(smooth), own_room(), out)
    return out


def _wide_depth(
    frames: Iterator[Image], count: int, least: float
) -> Steps[tuple[NDArray[np.float32], float]]:
    """Return the depth by the wide window, in frames, and the energy of noise.

    That is the energy of the quietest windows of all frames, and no less than `least`.
    """
    quiet = []
    shape = (0, 0)

    def coarse() -> Iterator[NDArray[np.float32]]:
        nonlocal shape
        for frame in frames:
            energy = _energy(halved(frame))
            shape = energy.shape
            averaged = box(halved(energy), _WIDE)
            quiet.append(averaged[::4, ::4].copy())
            yield averaged

    measure = Banded(lambda image: image, reach=0)
    found = track_peaks(
        coarse(),
        np.arange(float(count)),
        [measure],
        reaches=[2],
        batch=8,
        workers=1,
        pictured=False,
    )
    silence = yield Question("silence", lambda: quiet, _silence)
    noise = max(silence, least)
    depth = found.depths[0]
    if found.peak is not None:
        depth[found.peak.value < _CLEAR * noise] = np.nan
        # The wide window has halos of its own, where only blurred light reaches into it.
        set_to_nan(depth, blurred_edge_mask(depth, found.peak.value))
    return enlarged(depth, shape), noise


def _silence(samples: list[list[NDArray[np.float32]]]) -> float:
    """Return the energy of the quietest windows of the quietest frame."""
    frames = (
        np.concatenate([part.ravel() for part in parts]) for parts in zip(*samples, strict=True)
    )
    return min(float(np.percentile(frame, _QUIET)) for frame in frames)


def _share(
    fine: NDArray[np.float32], coarse: NDArray[np.float32], noise: float
) -> NDArray[np.float32]:
    """Return the energy of fine detail over that of coarse detail, both without the noise's."""
    rest = np.maximum(coarse - noise * _NOISE_COARSE / _NOISE_FINE, np.float32(1e-6))
    return np.asarray(np.maximum(fine - noise, 0) / rest)


def _scene(
    frames: Iterator[Image],
    wide: NDArray[np.float32],
    narrow: NDArray[np.float32],
    differs: NDArray[np.bool_],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return every pixel from its frame by the wide depth, and its energies by the other depth.

    The energies are 0 where both depths are the same.
    """
    first, second = (np.rint(np.nan_to_num(d)).astype(np.int32) for d in (wide, narrow))
    scene, fine, coarse = (np.zeros_like(wide) for _ in range(3))
    for number, frame in enumerate(frames):
        half = halved(frame)
        np.copyto(scene, half, where=first == number)
        there = differs & (second == number)
        if not there.any():
            continue
        for energy, smooth in ((fine, _FINE), (coarse, _COARSE)):
            np.copyto(energy, box(_energy(half, smooth), _NARROW), where=there)
    return scene, fine, coarse


def _misfit(
    frames: Iterator[Image], scene: NDArray[np.float32], wide: NDArray[np.float32]
) -> Array:
    """Return how far frames are from the scene blurred, for distances from focus and for blurs."""
    blurred = [scene if s == 0 else blur(scene, s) for s in _BLURS]
    blurred = [image[::2, ::2] for image in blurred]
    level = wide[::2, ::2]
    misfit = np.zeros((len(_DISTANCES), len(_BLURS)))
    for number, frame in enumerate(frames):
        half = halved(frame)[::2, ::2]
        away = np.abs(level - number)
        for row, distance in zip(misfit, _DISTANCES, strict=True):
            there = np.abs(away - distance) < 0.25
            seen = half[there]
            row += [float(np.sum((seen - image[there]) ** 2)) for image in blurred]
    return misfit


def _growth(samples: list[Array]) -> float:
    """Return by how many px the blur grows for each frame out of focus.

    For every distance, the blur of the scene that is most like the frames so far away.
    """
    misfit = np.sum(samples, axis=0)
    blurs = np.array(_BLURS)
    used = misfit.sum(axis=1) > 0
    best = np.clip(misfit.argmin(axis=1), 1, len(blurs) - 1)
    return float(np.median((blurs[best] / _DISTANCES)[used])) if used.any() else 0.0


def scene_around(rate: float) -> int:
    """Return how far around a pixel the scene is looked at where it is blurred anew, full px."""
    # Two boxes for the widest blur; a detail's energy 8, its window 2 and what goes astray 2.
    return 2 * (2 * (blur_side(rate * _LADDER[-1]) // 2) + 12)


def _expected(
    scene: NDArray[np.float32], rate: float, away: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the share of fine detail of the scene, out of focus by a distance for every pixel."""
    square = np.ones((_ASTRAY, _ASTRAY), np.uint8)
    place = np.interp(np.nan_to_num(away), _LADDER, np.arange(len(_LADDER)))
    expected = np.zeros_like(scene)
    for k, distance in enumerate(_LADDER):
        blurred = blur(scene, rate * distance) if rate > 0 else scene
        fine, coarse = (box(_energy(blurred, smooth), _NARROW) for smooth in (_FINE, _COARSE))
        share = cv2.dilate(_share(fine, coarse, 0.0), square)
        # Shares fall by powers of the distance: their logarithms are interpolated.
        near = np.maximum(1 - np.abs(place - k), 0)
        expected += near * np.log(np.maximum(share, 1e-12))
    return np.asarray(np.exp(expected))


def _large(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    _, label, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    large = stats[:, cv2.CC_STAT_AREA] >= _AREA
    large[0] = False
    return np.asarray(large[label])
