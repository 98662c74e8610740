"""Focus measures made of separable filters: compiled, a tile of the image at a time.

A tile lies in flat memory whose rows are a fixed number of pixels apart, so that one loop runs over
all of its rows and every operand is at a fixed distance. What is beyond the image's border is its
mirror image about the outermost pixel; filters that are symmetric leave it one.
"""

from __future__ import annotations

import threading

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib.focus._compiled import compiled

__all__ = [
    "COLS",
    "FRONT",
    "MOST_REACH",
    "STRIDE",
    "along",
    "box_rows",
    "direction_rows",
    "down",
    "edge_rows",
    "energy_rows",
    "gaussian_taps",
    "laplacian_rows",
    "load",
    "own_room",
    "product_rows",
    "smooth_rows",
    "taps",
]

#: Rows and columns of a tile: with what the widest filter needs around it, three of them stay in
#: the processor's second cache.
_ROWS, COLS = 64, 512
#: Pixels around a tile; no measure may look further.
MOST_REACH = 24
#: Taps on either side that are added in one go, without putting the sum away in between. Filters
#: are filled up with zeros to a multiple.
_GROUP = 4
#: Bytes that a processor loads at once; rows and tiles below are whole multiples.
_CACHE_LINE = 64
#: Distance of the rows in memory, and pixels in front of the first row.
STRIDE, FRONT = COLS + 2 * MOST_REACH, 64
# Whole numbers without a sign, which need no test for counting from an array's end.
_1, _2, _3, _4 = (np.uintp(k) for k in range(1, 5))
_S, _2S, _3S, _4S, _5S = (np.uintp(k * STRIDE) for k in range(1, 6))
_TWO = np.float32(2)


def taps(kernel: NDArray) -> NDArray[np.float32]:
    """Return the middle of a symmetric filter and its right side, filled up to whole groups.

    Examples
    --------
    >>> taps(np.array([1.0, 2.0, 1.0])).tolist()
    [2.0, 1.0, 0.0, 0.0, 0.0]
    """
    side = kernel[len(kernel) // 2 + 1 :]
    full = -(-len(side) // _GROUP) * _GROUP
    result = np.zeros(1 + full, np.float32)
    result[: len(side) + 1] = kernel[len(kernel) // 2 :]
    return result


def gaussian_taps(sigma: float) -> NDArray[np.float32]:
    """Return the `taps` of a Gaussian, cut off where OpenCV cuts one of float32 off."""
    size = round(8 * sigma + 1) | 1
    return taps(cv2.getGaussianKernel(size, sigma).ravel())


_kept = threading.local()


def own_room() -> NDArray[np.float32]:
    """Return memory for five tiles that no other thread uses.

    The same each time: to get it from the system would take as long as the filters. Every row of a
    tile begins with a line of the processor's cache, so that loads from rows below each other touch
    one line and not two: a tenth of the filters' time.
    """
    if not hasattr(_kept, "room"):
        tile = 2 * FRONT + (_ROWS + 2 * MOST_REACH + 2) * STRIDE
        memory = np.empty(4 * 5 * tile + _CACHE_LINE, np.uint8)
        begin = -memory.ctypes.data % _CACHE_LINE
        _kept.room = memory[begin : begin + 4 * 5 * tile].view(np.float32).reshape(5, tile)
    return _kept.room


@compiled
def product_rows(
    image: NDArray[np.float32],
    first: int,
    height: int,
    top: int,
    filters: tuple[NDArray, NDArray, NDArray, NDArray],
    floors: tuple[np.float32, np.float32],
    room: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Write the product of modified Laplacians at two scales, each raised by a floor.

    Parameters
    ----------
    image : ndarray of float32, shape (part, cols)
        Rows `first` and following of an image of `height` rows: all that is looked at.
    first, height, top : int
        `top` is the first row that is wanted.
    filters : tuple of ndarray
        The `taps` before and after the Laplacian at the first scale, and at the second.
    floors : tuple of float32
        What is added to either.
    room : ndarray of float32
        As from `own_room`.
    out : ndarray of float32, shape (rows, cols)
        Rows `top` and following of the measure.
    """
    smooth, spread, wide_smooth, wide_spread = filters
    one, two = len(spread), len(wide_spread)  # the radius and the pixel of a second difference
    reach = max(one + len(smooth), two + len(wide_smooth)) - 1
    grey, other, third = room[0], room[1], room[2]
    rows, cols = out.shape
    for y in range(0, rows, _ROWS):
        count = min(_ROWS, rows - y)
        for x in range(0, cols, COLS):
            load(image, first, height, top + y - reach, count + 2 * reach, x, grey)
            _smooth(grey, third, other, reach - one, count + 2 * one, smooth)
            _laplace(other, third, reach - one + 1, count + 2 * one - 2)
            tile = out[y : y + count, x : x + COLS]
            down(third, other, reach, count, spread)
            along(other, third, reach, count, spread)
            _put(third, reach, floors[0], tile)
            _smooth(grey, third, other, reach - two, count + 2 * two, wide_smooth)
            _laplace(other, third, reach - two + 1, count + 2 * two - 2)
            _smooth(third, grey, other, reach, count, wide_spread)
            _multiply(other, reach, floors[1], tile)


@compiled
def laplacian_rows(
    image: NDArray[np.float32],
    filters: tuple[NDArray, NDArray],
    room: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Write the modified Laplacian of a whole image at one scale; as `product_rows`."""
    smooth, spread = filters
    one = len(spread)
    reach = one + len(smooth) - 1
    grey, other, third = room[0], room[1], room[2]
    rows, cols = out.shape
    for y in range(0, rows, _ROWS):
        count = min(_ROWS, rows - y)
        for x in range(0, cols, COLS):
            load(image, 0, rows, y - reach, count + 2 * reach, x, grey)
            _smooth(grey, third, other, reach - one, count + 2 * one, smooth)
            _laplace(other, third, reach - one + 1, count + 2 * one - 2)
            _smooth(third, grey, other, reach, count, spread)
            _put(other, reach, np.float32(0), out[y : y + count, x : x + COLS])


@compiled
def edge_rows(
    image: NDArray[np.float32],
    first: int,
    height: int,
    top: int,
    filters: tuple[NDArray, NDArray, NDArray],
    floors: tuple[np.float32, np.float32],
    room: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Write the product of two means of the deviation from a wider mean; as `product_rows`."""
    wide, fine, coarse = filters
    beyond = max(len(fine), len(coarse)) - 1
    reach = len(wide) - 1 + beyond
    grey, other, third = room[0], room[1], room[2]
    rows, cols = out.shape
    for y in range(0, rows, _ROWS):
        count = min(_ROWS, rows - y)
        for x in range(0, cols, COLS):
            load(image, first, height, top + y - reach, count + 2 * reach, x, grey)
            _smooth(grey, third, other, reach - beyond, count + 2 * beyond, wide)
            _deviate(other, grey, third, reach - beyond, count + 2 * beyond)
            tile = out[y : y + count, x : x + COLS]
            _smooth(third, other, grey, reach, count, fine)
            _put(grey, reach, floors[0], tile)
            _smooth(third, other, grey, reach, count, coarse)
            _multiply(grey, reach, floors[1], tile)


@compiled
def direction_rows(
    image: NDArray[np.float32],
    first: int,
    height: int,
    top: int,
    left: int,
    filters: tuple[NDArray, NDArray],
    room: NDArray[np.float32],
    outs: tuple[NDArray, NDArray],
) -> None:
    """Write the moduli of second differences along rows and along columns, averaged.

    As `product_rows`, of the columns from `left` on.
    """
    smooth, spread = filters
    beyond = len(spread)
    reach = len(smooth) - 1 + beyond
    grey, other, third = room[0], room[1], room[2]
    rows, cols = outs[0].shape
    for y in range(0, rows, _ROWS):
        count = min(_ROWS, rows - y)
        for x in range(0, cols, COLS):
            load(image, first, height, top + y - reach, count + 2 * reach, left + x, grey)
            _smooth(grey, third, other, reach - beyond, count + 2 * beyond, smooth)
            for out, step in ((outs[0], 1), (outs[1], STRIDE)):
                _second_difference(other, third, step, reach - beyond + 1, count + 2 * beyond - 2)
                down(third, grey, reach, count, spread)
                along(grey, third, reach, count, spread)
                _put(third, reach, np.float32(0), out[y : y + count, x : x + COLS])


@compiled
def smooth_rows(
    image: NDArray[np.float32],
    filter_: NDArray[np.float32],
    room: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Filter a whole image in both directions; as `product_rows`."""
    reach = len(filter_) - 1
    grey, other, third = room[0], room[1], room[2]
    rows, cols = out.shape
    for y in range(0, rows, _ROWS):
        count = min(_ROWS, rows - y)
        for x in range(0, cols, COLS):
            load(image, 0, rows, y - reach, count + 2 * reach, x, grey)
            _smooth(grey, third, other, reach, count, filter_)
            _put(other, reach, np.float32(0), out[y : y + count, x : x + COLS])


@compiled
def energy_rows(
    image: NDArray[np.float32],
    filter_: NDArray[np.float32],
    room: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Write the squares of both second differences of a smoothed image; as `product_rows`."""
    reach = len(filter_)
    grey, other, third = room[0], room[1], room[2]
    rows, cols = out.shape
    for y in range(0, rows, _ROWS):
        count = min(_ROWS, rows - y)
        for x in range(0, cols, COLS):
            load(image, 0, rows, y - reach, count + 2 * reach, x, grey)
            _smooth(grey, third, other, reach - 1, count + 2, filter_)
            _square(other, third, reach, count)
            _put(third, reach, np.float32(0), out[y : y + count, x : x + COLS])


@compiled
def box_rows(
    image: NDArray[np.float32],
    side: int,
    room: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Write the mean over a square of an odd `side` of up to 2 MOST_REACH + 1 px.

    Sums of two, four, eight and so on neighbors make up the side, always in the same order: running
    sums would depend on where they began.
    """
    reach = side // 2
    grey, one, two, third = room[0], room[1], room[2], room[3]
    rows, cols = out.shape
    share = np.float32(1 / (side * side))
    for y in range(0, rows, _ROWS):
        count = min(_ROWS, rows - y)
        for x in range(0, cols, COLS):
            load(image, 0, rows, y - reach, count + 2 * reach, x, grey)
            tall = (count + 2 * reach) * STRIDE
            _add_powers(grey, one, two, third, side, 1, FRONT, FRONT + tall, reach)
            _add_powers(third, one, two, grey, side, STRIDE, FRONT, FRONT + count * STRIDE, 0)
            for r in range(count):
                at = FRONT + r * STRIDE + MOST_REACH
                _scale_to(grey[at : at + COLS], share, out[y + r, x : x + COLS])


@compiled
def _add_powers(
    source: NDArray[np.float32],
    fours: NDArray[np.float32],
    sixteens: NDArray[np.float32],
    out: NDArray[np.float32],
    side: int,
    step: int,
    start: int,
    stop: int,
    before: int,
) -> None:
    """Add up `side` pixels that are `step` apart, from `before` steps before each pixel on.

    One, two, four, eight, … of them, as the bits of `side` say. Only sums of four and of sixteen
    are put away: twice as many are two of those.
    """
    first = start - before * step
    target = out[start:stop]
    _first_odd(source[first:], step, side & 2 > 0, target)
    done, width, earlier = side & 3, 4, source
    for sums in (fours, sixteens):
        if side < width:
            break
        # As many as the widest sums to come are made of.
        last = stop + (side - before - width) * step
        _add_four(earlier[first:], width // 4 * step, sums[first:last])
        bits = side // width & 3
        if bits:
            _add_sums(sums[first + done * step :], width * step, bits, target)
        done, width, earlier = done + bits * width, 4 * width, sums


@compiled
def _first_odd(
    source: NDArray[np.float32], step: int, three: bool, out: NDArray[np.float32]
) -> None:
    """Write one pixel, or the sum of three."""
    if three:
        one, two = source[step:], source[2 * step :]
        for p in range(np.uintp(len(out))):
            out[p] = source[p] + (one[p] + two[p])
    else:
        for p in range(np.uintp(len(out))):
            out[p] = source[p]


@compiled
def _add_four(source: NDArray[np.float32], step: int, out: NDArray[np.float32]) -> None:
    """Write the sum of two neighbors and the next two."""
    one, two, three = source[step:], source[2 * step :], source[3 * step :]
    for p in range(np.uintp(len(out))):
        out[p] = (source[p] + one[p]) + (two[p] + three[p])


@compiled
def _add_sums(sums: NDArray[np.float32], width: int, bits: int, out: NDArray[np.float32]) -> None:
    """Add one sum (`bits` 1), that of two neighbors (2), or one and then two more (3)."""
    one, two = sums[width:], sums[2 * width :]
    if bits == 1:
        for p in range(np.uintp(len(out))):
            out[p] += sums[p]
    elif bits == 2:
        for p in range(np.uintp(len(out))):
            out[p] += sums[p] + one[p]
    else:
        for p in range(np.uintp(len(out))):
            out[p] = (out[p] + sums[p]) + (one[p] + two[p])


@compiled
def _scale_to(source: NDArray[np.float32], share: np.float32, out: NDArray[np.float32]) -> None:
    for x in range(np.uintp(len(out))):
        out[x] = share * source[x]


@compiled
def _square(source: NDArray[np.float32], out: NDArray[np.float32], row: int, count: int) -> None:
    """Write the sum of the squared second differences."""
    for p in range(np.uintp(FRONT + row * STRIDE), np.uintp(FRONT + (row + count) * STRIDE)):
        twice = _TWO * source[p]
        across = twice - (source[p - _1] + source[p + _1])
        upright = twice - (source[p - _S] + source[p + _S])
        out[p] = across * across + upright * upright


@compiled
def _mirror(k: int, length: int) -> int:
    """Return the pixel that stands for pixel `k`, which may lie outside 0 … length - 1."""
    period = max(2 * length - 2, 1)
    k = abs(k) % period
    return min(k, period - k)


@compiled
def load(
    image: NDArray[np.float32],
    first: int,
    height: int,
    top: int,
    count: int,
    left: int,
    out: NDArray[np.float32],
) -> None:
    """Copy rows of the image, mirrored at its border, with the margin of a tile at `left`."""
    width = image.shape[1]
    start = left - MOST_REACH
    begin, end = max(-start, 0), min(width - start, STRIDE)
    for r in range(count):
        row = image[_mirror(top + r, height) - first]
        at = FRONT + r * STRIDE
        source, target = row[begin + start : end + start], out[at + begin : at + end]
        for c in range(np.uintp(len(target))):
            target[c] = source[c]
        for c in range(begin):
            out[at + c] = row[_mirror(c + start, width)]
        for c in range(end, STRIDE):
            out[at + c] = row[_mirror(c + start, width)]


@compiled
def _smooth(
    source: NDArray[np.float32],
    between: NDArray[np.float32],
    out: NDArray[np.float32],
    row: int,
    count: int,
    filter_: NDArray[np.float32],
) -> None:
    """Filter `count` rows of a tile in both directions."""
    down(source, between, row, count, filter_)
    along(between, out, row, count, filter_)


@compiled
def along(
    source: NDArray[np.float32],
    out: NDArray[np.float32],
    row: int,
    count: int,
    filter_: NDArray[np.float32],
) -> None:
    """Filter `count` rows of a tile along its rows."""
    start, stop = FRONT + row * STRIDE, FRONT + (row + count) * STRIDE
    k0, k1, k2, k3, k4 = filter_[0], filter_[1], filter_[2], filter_[3], filter_[4]
    for p in range(np.uintp(start), np.uintp(stop)):
        out[p] = (
            k0 * source[p]
            + k1 * (source[p - _1] + source[p + _1])
            + k2 * (source[p - _2] + source[p + _2])
            + k3 * (source[p - _3] + source[p + _3])
            + k4 * (source[p - _4] + source[p + _4])
        )
    for j in range(_GROUP, len(filter_) - 1, _GROUP):
        low = source[start - (j + _GROUP) :]
        high = source[start + (j + 1) :]
        _add_along(low, high, filter_[j + 1 : j + 5], out[start:stop])


@compiled
def _add_along(
    low: NDArray[np.float32],
    high: NDArray[np.float32],
    group: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    k1, k2, k3, k4 = group[0], group[1], group[2], group[3]
    for p in range(np.uintp(len(out))):
        out[p] += (
            k1 * (low[p + _3] + high[p])
            + k2 * (low[p + _2] + high[p + _1])
            + k3 * (low[p + _1] + high[p + _2])
            + k4 * (low[p] + high[p + _3])
        )


@compiled
def down(
    source: NDArray[np.float32],
    out: NDArray[np.float32],
    row: int,
    count: int,
    filter_: NDArray[np.float32],
) -> None:
    """Filter `count` rows of a tile along its columns, and one more if they are odd.

    Two at a time, because most of what they are made of is the same.
    """
    start = FRONT + row * STRIDE
    _first_columns(source, out, start, (count + 1) // 2, filter_)
    for j in range(_GROUP, len(filter_) - 1, _GROUP):
        low = source[start - (j + _GROUP) * STRIDE :]
        high = source[start + (j + 1) * STRIDE :]
        _add_columns(low, high, filter_[j + 1 : j + 5], (count + 1) // 2, out[start:])


@compiled
def _first_columns(
    source: NDArray[np.float32],
    out: NDArray[np.float32],
    start: int,
    pairs: int,
    filter_: NDArray[np.float32],
) -> None:
    k0, k1, k2, k3, k4 = filter_[0], filter_[1], filter_[2], filter_[3], filter_[4]
    for first in range(np.uintp(start), np.uintp(start + pairs * 2 * STRIDE), _2S):
        for p in range(first, first + _S):
            a, b, c, d = source[p - _4S], source[p - _3S], source[p - _2S], source[p - _S]
            e, f, g, h = source[p], source[p + _S], source[p + _2S], source[p + _3S]
            i, j = source[p + _4S], source[p + _5S]
            out[p] = k0 * e + k1 * (d + f) + k2 * (c + g) + k3 * (b + h) + k4 * (a + i)
            out[p + _S] = k0 * f + k1 * (e + g) + k2 * (d + h) + k3 * (c + i) + k4 * (b + j)


@compiled
def _add_columns(
    low: NDArray[np.float32],
    high: NDArray[np.float32],
    group: NDArray[np.float32],
    pairs: int,
    out: NDArray[np.float32],
) -> None:
    k1, k2, k3, k4 = group[0], group[1], group[2], group[3]
    for first in range(np.uintp(0), np.uintp(pairs * 2 * STRIDE), _2S):
        for p in range(first, first + _S):
            a, b, c, d = low[p], low[p + _S], low[p + _2S], low[p + _3S]
            e, f, g, h = high[p], high[p + _S], high[p + _2S], high[p + _3S]
            i, j = low[p + _4S], high[p + _4S]
            one, two = out[p], out[p + _S]
            out[p] = one + (k1 * (d + e) + k2 * (c + f) + k3 * (b + g) + k4 * (a + h))
            out[p + _S] = two + (k1 * (i + f) + k2 * (d + g) + k3 * (c + h) + k4 * (b + j))


@compiled
def _laplace(source: NDArray[np.float32], out: NDArray[np.float32], row: int, count: int) -> None:
    """Write the modified Laplacian."""
    for p in range(np.uintp(FRONT + row * STRIDE), np.uintp(FRONT + (row + count) * STRIDE)):
        twice = _TWO * source[p]
        across = twice - (source[p - _1] + source[p + _1])
        upright = twice - (source[p - _S] + source[p + _S])
        out[p] = abs(across) + abs(upright)


@compiled
def _second_difference(
    source: NDArray[np.float32], out: NDArray[np.float32], step: int, row: int, count: int
) -> None:
    before, after = np.uintp(-step), np.uintp(step)
    for p in range(np.uintp(FRONT + row * STRIDE), np.uintp(FRONT + (row + count) * STRIDE)):
        out[p] = abs(_TWO * source[p] - (source[p + before] + source[p + after]))


@compiled
def _deviate(
    mean: NDArray[np.float32],
    image: NDArray[np.float32],
    out: NDArray[np.float32],
    row: int,
    count: int,
) -> None:
    for p in range(np.uintp(FRONT + row * STRIDE), np.uintp(FRONT + (row + count) * STRIDE)):
        out[p] = abs(image[p] - mean[p])


@compiled
def _put(
    tile: NDArray[np.float32], reach: int, floor: np.float32, out: NDArray[np.float32]
) -> None:
    """Write a tile without its margin, raised by a floor."""
    for y in range(len(out)):
        start = FRONT + (reach + y) * STRIDE + MOST_REACH
        source, row = tile[start : start + COLS], out[y]
        for x in range(np.uintp(len(row))):
            row[x] = source[x] + floor


@compiled
def _multiply(
    tile: NDArray[np.float32], reach: int, floor: np.float32, out: NDArray[np.float32]
) -> None:
    """Multiply by a tile without its margin, raised by a floor."""
    for y in range(len(out)):
        start = FRONT + (reach + y) * STRIDE + MOST_REACH
        source, row = tile[start : start + COLS], out[y]
        for x in range(np.uintp(len(row))):
            row[x] *= source[x] + floor
