"""The vertex of a parabola through the logarithm of a peak, compiled, for blocks of pixels.

Their samples lie one array after another, so that every step is done for sixteen pixels at once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.focus._compiled import compiled

__all__ = ["FLAT", "fit_near", "fit_window", "places", "three_points"]

#: Smallest focus measure a logarithm is taken of, as a share of the peak's. It holds three points
#: finite; a fit of more weights frames with their share. No default depth of the benchmark changes
#: from 1e-9 to 1e-3.
_FAINTEST = 1e-6
#: Fall of the logarithm of a measure below which it is flat. No default depth of the benchmark
#: changes from 1e-6 to 0.03.
FLAT = 1e-3

#: Pixels that are fitted at a time: their samples stay in the processor's first or second cache.
_BLOCK = 256
#: Samples whose sums are made in one go, without putting them away in between.
_GROUP = 4
#: Least part of the spread that samples have in a parabola, squared: a thousand times the rounding
#: of single precision.
_LEAST_BOW = np.float32(1e-8)
# Whole numbers without a sign, which need no test for counting from an array's end.
_B = np.uintp(_BLOCK)
_1, _2, _3, _4, _5, _6, _7 = (np.uintp(k * _BLOCK) for k in range(1, 8))
_FOUR = np.uintp(_GROUP)
_ZERO, _ONE, _HALF, _LEAST = (np.float32(v) for v in (0.0, 1.0, 0.5, _FAINTEST))


def places(steps: Array, reach: int) -> NDArray[np.float32]:
    """Return where frames lie, seen from each frame: from `reach` before to `reach` after it.

    Parameters
    ----------
    steps : ndarray of float64, shape (n,)
        Position of each frame, in frames.
    reach : int
        How many frames are looked at on either side.

    Returns
    -------
    ndarray of float32, shape (n, 2 reach + 1)
        Distances, in frames; NaN beyond the stack.

    Examples
    --------
    >>> places(np.array([0.0, 1.0, 3.0]), 1).tolist()
    [[nan, 0.0, 1.0], [-1.0, 0.0, 2.0], [-2.0, 0.0, nan]]
    """
    around = np.pad(steps, reach, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(around, 2 * reach + 1)
    return np.ascontiguousarray(windows - steps[:, None], np.float32)


@compiled
def three_points(
    window: NDArray, index: NDArray, places_: NDArray[np.float32], depth: NDArray[np.float32]
) -> None:
    """Write the vertex of the Gaussian through three measures.

    Parameters
    ----------
    window : ndarray, shape (3, pixels)
        Measures of the best frame, in the middle, and of its neighbors.
    index : ndarray of int, shape (pixels,)
        Number of the best frame.
    places_ : ndarray of float32, shape (3, n)
        For each frame its own position, and those of the one before and after it from there, µm;
        NaN where there is none.
    depth : ndarray of float32, shape (pixels,)
        Results, as of `three_point_peak`.
    """
    near = np.empty(3 * _BLOCK, np.float32)
    for start in range(0, len(depth), _BLOCK):
        here = slice(start, min(start + _BLOCK, len(depth)))
        at = index[here]
        for k in range(3):
            _look_up(places_[k], at, near[k * _BLOCK : (k + 1) * _BLOCK])
        _put_vertex(window[0, here], window[1, here], window[2, here], near, depth[here])


@compiled
def _look_up(table: NDArray[np.float32], index: NDArray, out: NDArray[np.float32]) -> None:
    for x in range(np.uintp(len(index))):
        out[x] = table[np.uintp(index[x])]


@compiled
def _put_vertex(
    first: NDArray,
    middle: NDArray,
    third: NDArray,
    near: NDArray[np.float32],
    depth: NDArray[np.float32],
) -> None:
    for x in range(np.uintp(len(depth))):
        left, right = near[_1 + x], near[_2 + x]
        best = np.float32(middle[x])
        # The logarithm is of a share: a difference of logarithms would lose digits.
        before, after = np.float32(first[x]) / best, np.float32(third[x]) / best
        before = _logarithm(before if before > _LEAST else _LEAST)
        after = _logarithm(after if after > _LEAST else _LEAST)
        bow = left * after - right * before
        shift = _HALF * (left * left * after - right * right * before) / bow
        # Where a neighbor is missing, NaN stands for its place.
        shift = shift if (left == left) & (right == right) else _ZERO
        depth[x] = near[x] + shift if best > 0 else np.float32(np.nan)


@compiled
def fit_window(
    window: NDArray,
    index: NDArray[np.uint16],
    place: NDArray[np.float32],
    limits: NDArray[np.float32],
    steps: Array,
    spacing: float,
    depth: NDArray[np.float32],
    inverse_variance: NDArray[np.float32],
) -> None:
    """Fit the peaks of windows centered on the best frame.

    Parameters
    ----------
    window : ndarray, shape (2 reach + 1, pixels)
        Measures of the best frame, in the middle, and of its neighbors.
    index : ndarray of int, shape (pixels,)
        Number of the best frame.
    place : ndarray of float32, shape (n, 2 reach + 1)
        As from `places`.
    limits : ndarray of float32, shape (3, n)
        For each frame the least and greatest vertex around it and half the fit's width, in frames.
    steps : ndarray of float64, shape (n,)
        Position of each frame, in frames.
    spacing : float
        Length of a frame, µm.
    depth, inverse_variance : ndarray of float32, shape (pixels,)
        Results, as of `fit_peak`.
    """
    count, pixels = window.shape
    samples, sums, state = _scratch(count)
    for start in range(0, pixels, _BLOCK):
        here = slice(start, min(start + _BLOCK, pixels))
        best = window[count // 2, here]
        _take_limits(index[here], limits, state)
        alike = _are_inside(index[here], place)
        for j in range(count):
            _take_sample(window[j, here], best, index[here], place, alike, j, samples, state)
        _fit(samples, sums, state)
        _put_depth(state, best, index[here], steps, spacing, depth[here], inverse_variance[here])


@compiled
def _put_depth(
    state: NDArray[np.float32],
    best: NDArray,
    index: NDArray,
    steps: Array,
    spacing: float,
    depth: NDArray[np.float32],
    inverse_variance: NDArray[np.float32],
) -> None:
    last = len(steps) - 1
    for x in range(np.uintp(len(depth))):
        vertex, square, lowest = state[_3 + x], state[_4 + x], state[_5 + x]
        at, top = np.uintp(index[x]), np.float32(best[x])
        peak = square < 0
        at_end = _ZERO if at == 0 or at == last else np.float32(np.nan)
        vertex = vertex if peak else at_end
        # Rounding makes peaks too.
        vertex = vertex if top > 0 and lowest < -FLAT else np.float32(np.nan)
        depth[x] = np.float32((steps[at] + vertex) * spacing)
        inverse_variance[x] = -square * top if top > 0 and peak else _ZERO


@compiled
def fit_near(
    windows: NDArray[np.float32],
    center: NDArray[np.int32],
    depth: NDArray,
    place: NDArray[np.float32],
    limits: NDArray[np.float32],
    steps: Array,
    offsets: NDArray[np.float32],
    weights: NDArray[np.float32],
) -> None:
    """Fit the peaks of the sum of two measures and of each of them, near a frame that is known.

    Parameters
    ----------
    windows : ndarray of float32, shape (2, 2 (reach + near) + 1, pixels)
        Measures of the known frame, in the middle, and of its neighbors. The best frame is sought
        among those up to `near` away.
    center : ndarray of int32, shape (pixels,)
        Number of the known frame.
    depth : ndarray of float, shape (pixels,)
        Known depth, in frames; NaN where there is none.
    place, limits, steps : ndarray
        As for `fit_window`; `place` tells the reach.
    offsets, weights : ndarray of float32, shape (3, pixels)
        Distance of the vertex from `depth`, in frames, and root of its inverse variance, up to a
        common factor; both 0 where there is no peak.
    """
    pixels = len(center)
    frames, count = place.shape
    near = (windows.shape[1] - count) // 2
    samples, sums, state = _scratch(count)
    values = np.zeros((windows.shape[1], _BLOCK), np.float32)
    best = np.zeros(_BLOCK, np.int32)
    top = np.zeros(_BLOCK, np.float32)
    middle = np.zeros(_BLOCK, np.int32)
    shifted = np.zeros(_BLOCK, np.float32)
    for start in range(0, pixels, _BLOCK):
        stop = min(start + _BLOCK, pixels)
        here = slice(start, stop)
        size = stop - start
        for kind in range(3):
            for k in range(len(values)):
                _take_kind(windows[0, k, here], windows[1, k, here], kind, values[k])
            _seek_best(values, center[here], near, count // 2, frames, best, top, middle)
            _take_limits(middle[:size], limits, state)
            alike = _are_inside(middle[:size], place)
            for j in range(count):
                shifted[:] = values[j]
                for k in range(1, 2 * near + 1):
                    _replace(best, k, values[j + k], shifted)
                _take_sample(
                    shifted[:size], top[:size], middle[:size], place, alike, j, samples, state
                )
            _fit(samples, sums, state)
            _put_offsets(
                state,
                best,
                top,
                middle,
                depth[here],
                steps,
                offsets[kind, here],
                weights[kind, here],
            )


@compiled
def _put_offsets(
    state: NDArray[np.float32],
    best: NDArray[np.int32],
    top: NDArray[np.float32],
    middle: NDArray[np.int32],
    depth: NDArray,
    steps: Array,
    offsets: NDArray[np.float32],
    weights: NDArray[np.float32],
) -> None:
    for x in range(np.uintp(len(depth))):
        vertex, square, lowest = state[_3 + x], state[_4 + x], state[_5 + x]
        # Too few frames within the stack leave the parabola open or endless.
        known = best[x] >= 0 and -np.inf < square < 0 and lowest < -FLAT and depth[x] == depth[x]
        place = steps[np.uintp(middle[x])] - depth[x] + vertex
        offsets[x] = np.float32(place) if known else _ZERO
        weights[x] = np.sqrt(-square * top[x]) if known else _ZERO


@compiled
def _scratch(count: int) -> tuple[NDArray, NDArray, NDArray]:
    """Return room for a block: distance, logarithm, share and weight of samples; sums; state.

    State is the least and the greatest vertex, half the fit's width, the vertex, the square
    coefficient, and the lowest logarithm. There are samples without a share to a full group.
    """
    full = -(-count // _GROUP) * _GROUP
    return (
        np.zeros(4 * full * _BLOCK, np.float32),
        np.zeros(8 * _BLOCK, np.float32),
        np.zeros(6 * _BLOCK, np.float32),
    )


@compiled
def _take_limits(index: NDArray, limits: NDArray[np.float32], state: NDArray[np.float32]) -> None:
    for x in range(np.uintp(len(index))):
        at = np.uintp(index[x])
        state[x], state[_1 + x], state[_2 + x] = limits[0, at], limits[1, at], limits[2, at]
        state[_5 + x] = _ZERO


@compiled
def _are_inside(index: NDArray, place: NDArray[np.float32]) -> bool:
    """Tell whether all neighbors of all pixels are in the stack, at whole distances."""
    frames, count = place.shape
    lowest, highest = frames, -1
    for x in range(len(index)):
        at = int(index[x])
        lowest = at if at < lowest else lowest
        highest = at if at > highest else highest
    if lowest < count // 2 or highest >= frames - count // 2:
        return False
    for k in range(lowest, highest + 1):
        for j in range(count):
            if place[k, j] != place[lowest, j]:
                return False
    return True


@compiled
def _take_kind(
    one: NDArray[np.float32], other: NDArray[np.float32], kind: int, out: NDArray[np.float32]
) -> None:
    """Put the sum of both measures (0), the first (1) or the second (2)."""
    first, second = np.float32(kind != 2), np.float32(kind != 1)
    for x in range(len(one)):
        out[x] = first * one[x] + second * other[x]


@compiled
def _seek_best(
    values: NDArray[np.float32],
    center: NDArray[np.int32],
    near: int,
    reach: int,
    frames: int,
    best: NDArray[np.int32],
    top: NDArray[np.float32],
    middle: NDArray[np.int32],
) -> None:
    """Find the first of the highest measures up to `near` frames away: -1 if there is none."""
    best[:] = -1
    top[:] = 0
    for k in range(2 * near + 1):
        which, away = np.int32(k), np.int32(k - near)
        row = values[reach + k]
        for x in range(np.uintp(len(center))):
            frame = center[x] + away
            found, most, value = best[x], top[x], row[x]
            better = frame >= 0 and frame < frames and value > most
            best[x] = which if better else found
            top[x] = value if better else most
    for x in range(np.uintp(len(center))):
        found, most = best[x], top[x]
        top[x] = most if found >= 0 else _ONE
        middle[x] = np.int32(center[x] + found - near) if found >= 0 else center[x]


@compiled
def _replace(
    best: NDArray[np.int32], k: int, values: NDArray[np.float32], out: NDArray[np.float32]
) -> None:
    which = np.int32(k)
    for x in range(len(out)):
        now, other = out[x], values[x]
        out[x] = other if best[x] == which else now


@compiled
def _take_sample(
    measure: NDArray,
    best: NDArray,
    index: NDArray,
    place: NDArray[np.float32],
    alike: bool,
    j: int,
    samples: NDArray[np.float32],
    state: NDArray[np.float32],
) -> None:
    """Put sample j of every pixel: its distance, the logarithm of its share, and the share."""
    at = np.uintp(4 * j * _BLOCK)
    if alike:
        t = place[index[0], j]
        for x in range(np.uintp(len(measure))):
            share = np.float32(measure[x]) / np.float32(best[x])
            share = share if share > _LEAST else _LEAST
            y = _logarithm(share)
            lowest = state[_5 + x]
            samples[at + x] = t
            samples[at + _1 + x] = y
            samples[at + _2 + x] = share
            state[_5 + x] = y if y < lowest else lowest
        return
    row = place.shape[1]
    flat = place.reshape(place.size)
    for x in range(np.uintp(len(measure))):
        samples[at + x] = flat[np.uintp(index[x] * row + j)]
    for x in range(np.uintp(len(measure))):
        t = samples[at + x]
        inside = t == t
        share = np.float32(measure[x]) / np.float32(best[x])
        share = share if share > _LEAST else _LEAST
        share = share if inside else _ONE
        y = _logarithm(share)
        lowest = state[_5 + x]
        samples[at + x] = t if inside else _ZERO
        samples[at + _1 + x] = y
        samples[at + _2 + x] = share if inside else _ZERO
        state[_5 + x] = y if y < lowest else lowest


@compiled
def _logarithm(value: np.float32) -> np.float32:
    """Return the natural logarithm of a positive float32, to its last digit (Cephes, logf)."""
    bits = np.float32(value).view(np.int32)
    # The mantissa from the root of a half up to that of two.
    exponent = np.int32((bits - 0x3F3504F3) >> 23)
    x = np.int32(bits - (exponent << 23)).view(np.float32) - _ONE
    e = np.float32(exponent)
    p = np.float32(7.0376836292e-2)
    p = p * x + np.float32(-1.1514610310e-1)
    p = p * x + np.float32(1.1676998740e-1)
    p = p * x + np.float32(-1.2420140846e-1)
    p = p * x + np.float32(1.4249322787e-1)
    p = p * x + np.float32(-1.6668057665e-1)
    p = p * x + np.float32(2.0000714765e-1)
    p = p * x + np.float32(-2.4999993993e-1)
    p = p * x + np.float32(3.3333331174e-1)
    square = x * x
    rest = p * x * square + e * np.float32(-2.12194440e-4) - _HALF * square
    return e * np.float32(0.693359375) + (x + rest)


@compiled
def _fit(
    samples: NDArray[np.float32], sums: NDArray[np.float32], state: NDArray[np.float32]
) -> None:
    """Fit a parabola to every pixel of the block, and another around the first one's vertex.

    In steps, by polynomials that are orthogonal: near the ends of a stack one of three samples
    hardly weighs, and the normal equations of powers would lose all digits of single precision.
    """
    state[_3 : _3 + _B] = 0
    for _ in range(2):
        sums[:] = 0
        for first in range(0, len(samples), 4 * _GROUP * _BLOCK):
            _weigh(samples, np.uintp(first), state, sums)
        for first in range(0, len(samples), 4 * _GROUP * _BLOCK):
            _add_central(samples, np.uintp(first), sums)
        for first in range(0, len(samples), 4 * _GROUP * _BLOCK):
            _project(samples, np.uintp(first), sums)
        _find_vertex(sums, state)


@compiled
def _weigh(
    samples: NDArray[np.float32],
    first: int,
    state: NDArray[np.float32],
    sums: NDArray[np.float32],
) -> None:
    """Put the weights of four samples, less far from the vertex; add w, wt and wy."""
    for x in range(_B):
        center, narrow = state[_3 + x], _ONE / state[_2 + x]
        s0, s1, p0 = sums[x], sums[_1 + x], sums[_6 + x]
        for k in range(_FOUR):
            at = first + k * _4 + x
            t, share = samples[at], samples[at + _2]
            away = (t - center) * narrow
            bow = _ONE - away * away
            bow = _ZERO if bow < 0 else bow
            w = share * bow * bow
            samples[at + _3] = w
            s0 += w
            s1 += w * t
            p0 += w * samples[at + _1]
        sums[x], sums[_1 + x], sums[_6 + x] = s0, s1, p0


@compiled
def _add_central(samples: NDArray[np.float32], first: int, sums: NDArray[np.float32]) -> None:
    """Add wu², wu³ and wuy of four samples, u from the weighted mean of t."""
    for x in range(_B):
        mean = sums[_1 + x] / sums[x]
        s2, s3, p1 = sums[_2 + x], sums[_3 + x], sums[_4 + x]
        for k in range(_FOUR):
            at = first + k * _4 + x
            u = samples[at] - mean
            v = u * samples[at + _3]
            s2 += v * u
            s3 += v * u * u
            p1 += v * samples[at + _1]
        sums[_2 + x], sums[_3 + x], sums[_4 + x] = s2, s3, p1


@compiled
def _project(samples: NDArray[np.float32], first: int, sums: NDArray[np.float32]) -> None:
    """Add wq² and wqr of four samples: u² and y, without their means and slopes."""
    for x in range(_B):
        s0, s2 = sums[x], sums[_2 + x]
        mean, slope, level = sums[_1 + x] / s0, sums[_3 + x] / s2, s2 / s0
        height, rise = sums[_6 + x] / s0, sums[_4 + x] / s2
        s4, p2 = sums[_5 + x], sums[_7 + x]
        for k in range(_FOUR):
            at = first + k * _4 + x
            u = samples[at] - mean
            q = u * (u - slope) - level
            v = q * samples[at + _3]
            s4 += v * q
            p2 += v * (samples[at + _1] - height - rise * u)
        sums[_5 + x], sums[_7 + x] = s4, p2


@compiled
def _find_vertex(sums: NDArray[np.float32], state: NDArray[np.float32]) -> None:
    """Put the vertex, within its limits, and the square coefficient of every pixel."""
    for x in range(_B):
        mean, slope = sums[_1 + x] / sums[x], sums[_3 + x] / sums[_2 + x]
        linear, square = sums[_4 + x] / sums[_2 + x], sums[_7 + x] / sums[_5 + x]
        # Two samples bear no parabola.
        spread = sums[_2 + x]
        square = square if sums[_5 + x] * sums[x] > _LEAST_BOW * spread * spread else _ZERO
        vertex = mean + _HALF * (slope - linear / square)
        least, most = state[x], state[_1 + x]
        vertex = least if vertex < least else vertex
        state[_3 + x] = most if vertex > most else vertex
        state[_4 + x] = square
