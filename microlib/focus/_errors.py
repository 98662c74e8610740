"""How far a smoothed depth is likely to be wrong: noise, pull towards frames, steps and halos.

All depths are in frames. What each part is worth is measured in benchmarks/focus_depth.py; the
factors were fitted to errors that are known, of rendered scenes: domes, tilts and steps, with drawn
texture and with photographs, other than those of the benchmark.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.focus._measures import blur
from microlib.focus._nearest import enlarged, gradients
from microlib.focus._questions import Question, Steps

#: Radius over which weights tell how much texture a depth rests on, px, and the number of groups of
#: such pixels: in each, a few hundred independent differences tell their variance.
_SUPPORT, _GROUPS = 2.0, 16
#: Pixels that tell it, at the most: they are alike over some 6 px, and a group of these holds a few
#: thousand.
_SAMPLES = 2**16
#: Median of the square of a normal variate of unit variance. Halos and steps hold few pixels but
#: most of the mean square, so that the median speaks for the rest.
_MEDIAN_SQUARE = 0.455
#: Variance of the smoothed depth over that of half the difference of both directions: 0.4 on coarse
#: texture, 0.6 to 0.8 on others.
_NOISE_SHARE = 0.6
#: Variance that neither direction shows, everywhere and where the depth is level, frames²; the fit
#: pulls depths towards frames, and a smoothing over this radius, px, takes the mean over a slope.
_UNSEEN, _PULL, _PULL_RADIUS = 0.0065**2, 0.016**2, 5.2
#: How far a texture moves a depth along a slope, px, as it lies unevenly in the measure's windows:
#: 0.15 to 0.2 on fine grain, twice that on a photograph. The steepest slope for which that holds,
#: frames/px: smoothing over 7 px ends at jumps of 1.5 frames.
_SHIFT, _STEEPEST = 0.15, 0.3
#: Radius over which the slope is looked at for both, px.
_SLOPE_RADIUS = 3.0
#: Rise over 3 px, beyond that of a slope as it is over 7 px, that is an edge, frames: ten times the
#: error of a depth on weak texture.
_EDGE = 0.25
#: Error at an edge, within 3 px of it, and further away under the smoothing, over its height.
_AT_EDGE, _BESIDE_EDGE, _NEAR_EDGE, _NEAR = 0.4, 0.09, 0.029, 7.0
#: Mean square error over the square of the range of depths in a square of this side, px, for each
#: share of pixels within a radius (sigma), px, that are halos or unknown: some halos are left.
_HALOS = ((43, 6.0, 0.006), (23, 3.0, 0.0125))


def smooth_variance(
    base: Array,
    half_difference: NDArray[np.float32],
    weight: NDArray[np.float32],
    doubtful: NDArray[np.bool_],
) -> Steps[NDArray[np.float32]]:
    """Return the mean square error of a smoothed depth.

    Parameters
    ----------
    base : ndarray of float64, shape (rows, cols)
        Smoothed depth, frames; NaN where unknown.
    half_difference : ndarray of float32, shape (rows, cols)
        Half the difference of two independent depths, smoothed as widely, frames.
    weight : ndarray of float32, shape (rows, cols)
        Weight of each pixel's own depth; 0 where there is none.
    doubtful : ndarray of bool, shape (rows, cols)
        Where light from elsewhere was found, or no depth.

    Returns
    -------
    ndarray of float32, shape (rows, cols)
        Variance, frames².
    """
    known = np.isfinite(base)
    noise = yield from _noise_variance(half_difference, weight, known)
    if not known.any():
        return np.zeros(base.shape, np.float32)
    rest = _pull_variance(base) + _edge_variance(base) + _halo_variance(base, doubtful)
    return np.asarray(noise + rest, np.float32)


@dataclass(frozen=True)
class NoiseCurve:
    """The variance from noise, for how little texture there is.

    Attributes
    ----------
    scarcity, variance : ndarray of float64, shape (n,)
        Points of the curve, which never falls, frames².
    offset, slope : float
        The line through them.
    """

    scarcity: Array
    variance: Array
    offset: float
    slope: float


def _noise_variance(
    half_difference: NDArray, weight: NDArray, known: NDArray[np.bool_]
) -> Steps[NDArray[np.float32]]:
    """Return the variance from noise, as a function of how much texture there is around a pixel.

    A local mean square would be of few independent differences, and be lowest where it happens to
    be too low. All pixels with as much texture together tell it well.
    """
    scarcity = 1 / np.maximum(blur(weight[::2, ::2], _SUPPORT / 2), np.float32(0.01))
    there = known[::2, ::2]
    curve: NoiseCurve | None = yield Question(
        "noise_curve",
        lambda: (half_difference[::2, ::2][there], scarcity[there]),
        _noise_curve,
    )
    if curve is None:
        return np.zeros(known.shape, np.float32)
    level = np.interp(scarcity, curve.scarcity, curve.variance)
    # Beyond the scarcest group the line goes on, but not far: nothing was measured there.
    line = curve.offset + curve.slope * np.minimum(scarcity, 3 * float(curve.scarcity[-1]))
    variance = (_NOISE_SHARE / 2 * (level + line)).astype(np.float32)
    return enlarged(variance, known.shape)


def _noise_curve(samples: list[tuple[NDArray, NDArray]]) -> NoiseCurve | None:
    """Return the medians of groups with as much texture, made to rise, and the line through them.

    The line has less scatter. None where no depth is known.
    """
    difference, scarcity = (np.concatenate(part) for part in zip(*samples, strict=True))
    if not len(scarcity):
        return None
    every = -(-len(scarcity) // _SAMPLES)
    square, sample = difference[::every] ** 2, scarcity[::every]
    groups = np.array_split(np.argsort(sample), min(_GROUPS, len(sample)))
    center = np.array([sample[group].mean() for group in groups], np.float64)
    median = np.array([np.median(square[group]) for group in groups], np.float64)
    level = median / _MEDIAN_SQUARE
    return NoiseCurve(center, _never_falling(level), *_rising_line(center, level))


def _rising_line(x: Array, y: Array) -> tuple[float, float]:
    """Return offset and slope, neither below zero, of a line through points."""
    variance, covariance = float(np.var(x)), float(np.mean((x - x.mean()) * (y - y.mean())))
    slope = max(covariance / variance, 0.0) if variance > 0 else 0.0
    offset = float(y.mean()) - slope * float(x.mean())
    return (offset, slope) if offset >= 0 else (0.0, float(y.mean()) / float(x.mean()))


def _never_falling(values: Array) -> Array:
    """Return the nearest sequence that never falls: neighbors that do are put to their mean."""
    blocks: list[tuple[float, int]] = []
    for value in values:
        mean, count = float(value), 1
        while blocks and blocks[-1][0] > mean:
            before, several = blocks.pop()
            mean = (mean * count + before * several) / (count + several)
            count += several
        blocks.append((mean, count))
    return np.repeat([mean for mean, _ in blocks], [count for _, count in blocks])


def _pull_variance(base: Array) -> NDArray[np.float32]:
    """Return the mean square of what the fit pulls towards frames, and of shifts on slopes."""
    level = blur(np.nan_to_num(base[::2, ::2]).astype(np.float32), _SLOPE_RADIUS / 2)
    down, along = (slope / 2 for slope in gradients(level))
    steepness = down**2 + along**2
    # A step is no slope: its errors are those of edges.
    shift = _SHIFT**2 * np.minimum(steepness, _STEEPEST**2)
    pull = _PULL * np.exp(-((2 * np.pi * _PULL_RADIUS) ** 2) * steepness) + shift + _UNSEEN
    return enlarged(pull.astype(np.float32), base.shape)


def _range(base: Array, side: int) -> NDArray[np.float32]:
    """Return the range of depths in a square; what is unknown does not count."""
    level, square = base.astype(np.float32), np.ones((side, side), np.uint8)
    unknown, most = np.isnan(level), np.float32(2**16)
    if not unknown.any():
        return np.asarray(cv2.dilate(level, square) - cv2.erode(level, square))
    low = cv2.erode(np.where(unknown, most, level), square)
    high = cv2.dilate(np.where(unknown, -most, level), square)
    return np.asarray(np.maximum(high - low, 0))


def _edge_variance(base: Array) -> NDArray[np.float32]:
    """Return the mean square error around steps, where a pixel may be on either side."""
    # A plane rises three times as far over 7 px as over 3, a step as far. It goes on outside.
    wide = np.pad(base, 3, mode="reflect", reflect_type="odd")
    near = _range(wide, 3)
    if near.max() < _EDGE:
        return np.zeros(base.shape, np.float32)
    rise = np.maximum(1.5 * near - 0.5 * _range(wide, 7), 0)[3:-3, 3:-3].copy()
    rise[rise < _EDGE] = 0
    if not rise.any():
        return np.zeros(base.shape, np.float32)
    beside = cv2.dilate(rise, np.ones((7, 7), np.uint8))
    around = _NEAR_EDGE**2 * blur(rise * rise, _NEAR)
    return np.asarray((_AT_EDGE * rise) ** 2 + (_BESIDE_EDGE * beside) ** 2 + around)


def _halo_variance(base: Array, doubtful: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the mean square error around halos, of which some are left."""
    if not doubtful.any():
        return np.zeros(base.shape, np.float32)
    coarse, mask = base[::2, ::2], doubtful[::2, ::2].astype(np.float32)
    total = np.zeros(coarse.shape, np.float32)
    for side, radius, factor in _HALOS:
        share = np.maximum(blur(mask, radius / 2), 0)
        total += np.float32(factor) * share * _range(coarse, side // 2) ** 2
    return enlarged(total, base.shape)
