"""The inner loops of shape from focus, compiled: each looks at a row while it is in the cache.

Loops that read all their operands before they write are turned into vector instructions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from microlib.focus._compiled import compiled


@compiled
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


@compiled
def _mirror(k: int, length: int) -> int:
    """Return the pixel that stands for pixel `k`, which may lie outside 0 … length - 1."""
    period = max(2 * length - 2, 1)
    k = abs(k) % period
    return min(k, period - k)


@compiled
def _copy(source: NDArray, target: NDArray) -> None:
    for x in range(len(source)):
        target[x] = source[x]


@compiled
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


@compiled
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


@compiled
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


@compiled
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
    `reach` measures. An `image` without rows is not wanted.
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
        if len(image) > 0:
            _pick(frame[y], now, index[y], image[y])


@compiled
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


@compiled
def _choose(
    measure: NDArray, now: np.uint16, best: NDArray, index: NDArray, newest: NDArray
) -> None:
    for x in range(len(measure)):
        new, top, at = measure[x], best[x], index[x]
        index[x] = now if new > top else at
        best[x] = new if new > top else top
        newest[x] = new


@compiled
def _pick(frame: NDArray, now: np.uint16, index: NDArray, image: NDArray) -> None:
    for x in range(len(frame)):
        new, old = frame[x], image[x]
        image[x] = new if index[x] == now else old


#: Pixels of a row that are looked at together: on most surfaces they are near few frames.
_PART = 128


@compiled
def keep_near(
    measures: NDArray[np.float32],
    number: int,
    center: NDArray[np.int32],
    windows: NDArray[np.float32],
) -> None:
    """Keep the measures of frame `number` where it lies in the window around the center.

    `measures` are of two kinds, and `windows` holds 2 reach + 1 of either.
    """
    count, rows, cols = windows.shape[1:]
    reach = count // 2
    for y in range(rows):
        for left in range(0, cols, _PART):
            part = slice(left, min(left + _PART, cols))
            near = center[y, part]
            lowest, highest = near[0], near[0]
            for x in range(len(near)):
                lowest, highest = min(lowest, near[x]), max(highest, near[x])
            first = max(number + reach - highest, 0)
            for k in range(first, min(number + reach - lowest, count - 1) + 1):
                _keep(near, number + reach - k, measures[0, y, part], windows[0, k, y, part])
                _keep(near, number + reach - k, measures[1, y, part], windows[1, k, y, part])


@compiled
def _keep(
    center: NDArray[np.int32], here: int, measure: NDArray[np.float32], out: NDArray[np.float32]
) -> None:
    wanted = np.int32(here)
    for x in range(len(center)):
        new, old = measure[x], out[x]
        out[x] = new if center[x] == wanted else old


@compiled
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


@compiled
def nearest_rows(
    depth: NDArray, between: NDArray, order: NDArray[np.uint16], out: NDArray[np.uint16]
) -> None:
    """Write the number of the frame nearest to each depth; that of the lowest where it is NaN.

    `between` are the middles between frames in rising order, and `order` the numbers of the frames
    in that order.
    """
    for y in range(len(depth)):
        row, counts = depth[y], out[y]
        counts[:] = 0
        for k in range(len(between)):
            _count_above(row, between[k], counts)
        for x in range(len(row)):
            counts[x] = order[counts[x]]


@compiled
def _count_above(values: NDArray, limit: float, counts: NDArray[np.uint16]) -> None:
    for x in range(len(values)):
        counts[x] = np.uint16(counts[x] + np.uint16(1)) if values[x] > limit else counts[x]


@compiled
def fixed_point(depth: NDArray, least: float, parts: float, out: NDArray[np.int16]) -> None:
    """Write whole numbers of a depth's parts above `least`: 2¹⁵ - 1 at most, -2¹⁵ for NaN."""
    for y in range(len(depth)):
        row, levels = depth[y], out[y]
        for x in range(len(row)):
            level = np.floor(parts * (row[x] - least)) - 32767.0
            level = level if level < 32767.0 else 32767.0
            level = level if level > -32767.0 else -32767.0
            levels[x] = np.int16(level) if row[x] == row[x] else np.int16(-32768)


@compiled
def balance(weights: NDArray[np.float32], typical: np.float32, most: np.float32) -> None:
    """Divide positive weights by a typical one, and hold them within a factor of it."""
    one = np.float32(1)
    for y in range(len(weights)):
        row = weights[y]
        for x in range(len(row)):
            raw = row[x]
            relative = raw / typical
            relative = relative if relative < most else most
            relative = relative if relative > one / most else one / most
            row[x] = relative if raw > 0 else np.float32(0)
