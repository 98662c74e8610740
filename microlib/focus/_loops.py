"""The inner loops of shape from focus, compiled: each looks at a row while it is in the cache.

They hold no lock of the interpreter, so that threads work side by side. Loops that read all their
operands before they write are turned into vector instructions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray


def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    try:
        return numba.njit(nogil=True, cache=True, error_model="numpy")(function)
    except RuntimeError:  # no folder may be written to: compile again in every process
        return numba.njit(nogil=True, error_model="numpy")(function)


@_compiled
def sum_rows(
    image: NDArray, top: int, window: int, step: int, threshold: float, out: NDArray
) -> None:
    """Write rows `top` and following of the sum-modified-Laplacian (3.11)–(3.12) to `out`.

    Beyond its border the image is mirrored about the outermost pixel. All numbers are of the type
    of `out`, which must hold the largest sum.
    """
    height, width = image.shape
    half = window // 2
    kept = 2 * step + 1
    grey = np.empty((kept, width + 2 * step), out.dtype)
    laplacian = np.empty((window, width), out.dtype)
    total = np.empty(width + 2 * half, out.dtype)
    for y in range(top - half - step, top + len(out) + half + step):
        newest = grey[y % kept]
        _copy(image[_mirror(y, height)], newest[step:])
        for j in range(step):
            newest[j] = newest[2 * step - j]
            newest[width + step + j] = newest[width + step - 2 - j]
        center = y - step
        if center >= top - half:
            here, above = grey[center % kept], grey[(center - step) % kept]
            _laplace(here, above[step:], newest[step:], step, threshold, laplacian[center % window])
        done = center - half - top
        if done >= 0:
            _add_up(laplacian, window, total[half : half + width])
            for j in range(half):
                total[j] = total[half + _mirror(j - half, width)]
                total[half + width + j] = total[half + _mirror(width + j, width)]
            _slide(total, window, out[done])


@_compiled
def _mirror(k: int, length: int) -> int:
    """Return the pixel that stands for pixel `k`, which may lie outside 0 … length - 1."""
    period = max(2 * length - 2, 1)
    k = abs(k) % period
    return min(k, period - k)


@_compiled
def _copy(source: NDArray, target: NDArray) -> None:
    for x in range(len(source)):
        target[x] = source[x]


@_compiled
def _laplace(
    here: NDArray, above: NDArray, below: NDArray, step: int, threshold: float, out: NDArray
) -> None:
    """Write the modified Laplacian where it exceeds the threshold, and 0 elsewhere."""
    # Without the casts a sum of short integers is a long one, and fewer fit into a vector.
    kind = out.dtype.type
    least = kind(threshold)
    width = len(out)
    left, center, right = here[:width], here[step : step + width], here[2 * step :]
    for x in range(width):
        twice = kind(center[x] + center[x])
        across, along = kind(left[x] + right[x]), kind(above[x] + below[x])
        second_x = kind(twice - across) if twice > across else kind(across - twice)
        second_y = kind(twice - along) if twice > along else kind(along - twice)
        value = kind(second_x + second_y)
        out[x] = value if value > least else kind(0)


@_compiled
def _add_up(rows: NDArray, count: int, out: NDArray) -> None:
    """Add an odd number of rows, in few passes."""
    kind = out.dtype.type
    if count == 1:
        _copy(rows[0], out)
        return
    one, two, three = rows[0], rows[1], rows[2]
    for x in range(len(out)):
        out[x] = kind(one[x] + two[x] + three[x])
    for j in range(3, count, 2):
        one, two = rows[j], rows[j + 1]
        for x in range(len(out)):
            out[x] = kind(out[x] + one[x] + two[x])


@_compiled
def _slide(row: NDArray, count: int, out: NDArray) -> None:
    """Add an odd number of neighbors, this one and those to the right, in few passes."""
    kind = out.dtype.type
    if count == 1:
        _copy(row, out)
        return
    one, two = row[1:], row[2:]
    for x in range(len(out)):
        out[x] = kind(row[x] + one[x] + two[x])
    for j in range(3, count, 2):
        one, two = row[j:], row[j + 1 :]
        for x in range(len(out)):
            out[x] = kind(out[x] + one[x] + two[x])


@_compiled
def track_rows(
    measure: NDArray,
    frame: NDArray,
    number: int,
    window: NDArray,
    recent: NDArray,
    index: NDArray[np.uint16],
    image: NDArray,
) -> None:
    """Take in frame `number`: where it is the sharpest so far, remember it and those before.

    `window` (2 reach + 1 measures) is centered on the best frame, `recent` is a ring of the last
    `reach` measures.
    """
    reach = len(recent)
    now = np.uint16(number)
    for y in range(len(measure)):
        for j in range(1, reach + 1):
            _move(
                measure[y],
                np.uint16(number - j),
                window[reach, y],
                index[y],
                recent[(number - j) % reach, y],
                window[reach - j, y],
                window[reach + j, y],
            )
        _choose(measure[y], now, window[reach, y], index[y], recent[number % reach, y])
        _pick(frame[y], now, index[y], image[y])


@_compiled
def _move(
    measure: NDArray,
    then: np.uint16,
    best: NDArray,
    index: NDArray,
    earlier: NDArray,
    before: NDArray,
    after: NDArray,
) -> None:
    """Fill in a neighbor of the best frame: from the past of a new one, to the future of one."""
    for x in range(len(measure)):
        new, top, at, past = measure[x], best[x], index[x], earlier[x]
        old_before, old_after = before[x], after[x]
        before[x] = past if new > top else old_before
        after[x] = new if at == then else old_after


@_compiled
def _choose(
    measure: NDArray, now: np.uint16, best: NDArray, index: NDArray, newest: NDArray
) -> None:
    for x in range(len(measure)):
        new, top, at = measure[x], best[x], index[x]
        index[x] = now if new > top else at
        best[x] = new if new > top else top
        newest[x] = new


@_compiled
def _pick(frame: NDArray, now: np.uint16, index: NDArray, image: NDArray) -> None:
    for x in range(len(frame)):
        new, old = frame[x], image[x]
        image[x] = new if index[x] == now else old


@_compiled
def keep_near(
    measures: NDArray[np.float32],
    number: int,
    center: NDArray[np.int32],
    windows: NDArray[np.float32],
) -> None:
    """Keep the measures of frame `number` where it lies in the window around the center.

    `windows` holds 2 reach + 1 measures of every kind.
    """
    kinds, count, rows, cols = windows.shape
    reach = count // 2
    for y in range(rows):
        for x in range(cols):
            k = number - center[y, x] + reach
            if 0 <= k < count:
                for kind in range(kinds):
                    windows[kind, k, y, x] = measures[kind, y, x]


@_compiled
def fit_near(
    windows: NDArray[np.float32],
    center: NDArray[np.int32],
    depth: NDArray,
    steps: NDArray,
    limits: NDArray,
    reach: int,
    offsets: NDArray[np.float32],
    weights: NDArray[np.float32],
) -> None:
    """Fit a parabola to the logarithm around the best of the frames in the window's middle.

    As `fit_peak`, for the sum of two measures and for each of them. Offsets are from `depth`, and
    weights the root of the inverse variance; both stay as they are where there is no peak.
    """
    count, rows, cols = windows.shape[1:]
    near = count // 2 - reach
    y = np.empty(2 * reach + 1)
    share = np.empty(2 * reach + 1)
    t = np.empty(2 * reach + 1)
    for row in range(rows):
        for col in range(cols):
            if np.isnan(depth[row, col]):
                continue
            for kind in range(3):
                best, top = -1, 0.0
                for k in range(count // 2 - near, count // 2 + near + 1):
                    frame = center[row, col] + k - count // 2
                    value = _kind_of(windows, kind, k, row, col)
                    if 0 <= frame < len(steps) and value > top:
                        best, top = k, value
                if best < 0:
                    continue
                middle = center[row, col] + best - count // 2
                lowest = 0.0
                for j in range(2 * reach + 1):
                    frame = middle + j - reach
                    inside = 0 <= frame < len(steps)
                    t[j] = steps[min(max(frame, 0), len(steps) - 1)] - steps[middle]
                    value = _kind_of(windows, kind, best + j - reach, row, col) / top
                    share[j] = max(value, 1e-6) if inside else 0.0
                    y[j] = np.log(share[j]) if inside else 0.0
                    lowest = min(lowest, y[j])
                vertex, square = 0.0, 0.0
                for _ in range(2):
                    linear, square = _parabola(t, y, share, vertex, limits[2, middle])
                    vertex = min(max(-linear / (2 * square), limits[0, middle]), limits[1, middle])
                # Too few frames within the stack leave the parabola open or endless.
                if -np.inf < square < 0 and lowest < -1e-3:
                    offsets[kind, row, col] = steps[middle] + vertex - depth[row, col]
                    weights[kind, row, col] = np.sqrt(-square * top)


@_compiled
def _kind_of(windows: NDArray[np.float32], kind: int, k: int, row: int, col: int) -> float:
    """Return the sum of both measures (0), the first (1) or the second (2)."""
    if kind == 0:
        return windows[0, k, row, col] + windows[1, k, row, col]
    return windows[kind - 1, k, row, col]


@_compiled
def _parabola(
    t: NDArray, y: NDArray, share: NDArray, center: float, reach: float
) -> tuple[float, float]:
    """Return the linear and the square coefficient of a weighted parabola y(t)."""
    s0, s1, s2, s3, s4, p0, p1, p2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(len(t)):
        bow = max(1 - ((t[j] - center) / reach) ** 2, 0.0)
        w = share[j] * bow * bow
        s0 += w
        p0 += w * y[j]
        w *= t[j]
        s1 += w
        p1 += w * y[j]
        w *= t[j]
        s2 += w
        p2 += w * y[j]
        w *= t[j]
        s3 += w
        s4 += w * t[j]
    m02, m12, m22 = s2 * s4 - s3 * s3, s1 * s4 - s2 * s3, s1 * s3 - s2 * s2
    det = s0 * m02 - s1 * m12 + s2 * m22
    linear = (-p0 * m12 + p1 * (s0 * s4 - s2 * s2) - p2 * (s0 * s3 - s1 * s2)) / det
    square = (p0 * m22 - p1 * (s0 * s3 - s1 * s2) + p2 * (s0 * s2 - s1 * s1)) / det
    return linear, square


@_compiled
def fill_in(
    depth: NDArray,
    best: NDArray[np.uint16],
    spacing: np.float32,
    uncertainty: NDArray[np.float32],
    confidence: NDArray[np.float32],
    index: NDArray[np.int32],
) -> None:
    """Turn the uncertainty, in frames, into µm, and fill in what follows from it and the depth."""
    for y in range(len(depth)):
        for x in range(depth.shape[1]):
            error = uncertainty[y, x]
            known = not np.isnan(depth[y, x])
            uncertainty[y, x] = error * spacing if known else np.float32(np.nan)
            confidence[y, x] = 1 / (1 + error * error) if known else np.float32(0)
            index[y, x] = np.int32(best[y, x]) if known else np.int32(-1)
