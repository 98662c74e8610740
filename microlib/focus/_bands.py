"""The inner loops of the relief, compiled: harmonics of the depth, octaves, and their sums."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from microlib.focus._compiled import compiled, summing
from microlib.focus._filters import COLS, FRONT, MOST_REACH, STRIDE, along, down, load

__all__ = ["TILE_ROWS", "add_products", "compose_rows", "median_above_zero", "split_rows", "unlock"]

#: Rows of a tile: six of them, with what the widest filter needs, stay in the second cache.
TILE_ROWS = 32
#: Pixels of a row whose harmonics are made together.
_BLOCK = 512
# Whole numbers without a sign, which need no test for counting from an array's end.
_1, _2, _3 = (np.uintp(k * _BLOCK) for k in range(1, 4))
_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)


@compiled
def split_rows(
    offsets: NDArray[np.float32],
    weights: NDArray[np.float32],
    filter_: NDArray[np.float32],
    top: int,
    bottom: int,
    room: NDArray[np.float32],
    band: NDArray[np.float32],
    smooth: NDArray[np.float32],
) -> None:
    """Put a weighted mean in the place of a finer one, and write the difference.

    Parameters
    ----------
    offsets, weights : ndarray of float32, shape (kinds, rows, cols)
        What is averaged, and with what weights.
    filter_ : ndarray
        The `taps` of the mean.
    top, bottom : int
        Rows that are wanted.
    room : ndarray of float32
        As from `own_room`.
    band : ndarray of float32, shape (kinds, rows, cols)
        Difference between the finer mean and this one.
    smooth : ndarray of float32, shape (kinds, rows, cols)
        The finer mean, then this one.
    """
    kinds, height, width = offsets.shape
    product, weight, between, upper, lower = room[0], room[1], room[2], room[3], room[4]
    reach = len(filter_) - 1
    for kind in range(kinds):
        for y in range(top, bottom, TILE_ROWS):
            count = min(TILE_ROWS, bottom - y)
            for x in range(0, width, COLS):
                load(offsets[kind], 0, height, y - reach, count + 2 * reach, x, product)
                load(weights[kind], 0, height, y - reach, count + 2 * reach, x, weight)
                _scale(product, weight, (count + 2 * reach) * STRIDE)
                down(product, between, reach, count, filter_)
                along(between, upper, reach, count, filter_)
                down(weight, between, reach, count, filter_)
                along(between, lower, reach, count, filter_)
                tile = smooth[kind, y : y + count, x : x + COLS]
                above = band[kind, y : y + count, x : x + COLS]
                for r in range(count):
                    at = FRONT + (reach + r) * STRIDE + MOST_REACH
                    _divide(upper[at : at + COLS], lower[at : at + COLS], tile[r], above[r])


@compiled
def _scale(image: NDArray[np.float32], weight: NDArray[np.float32], count: int) -> None:
    for p in range(np.uintp(FRONT), np.uintp(FRONT + count)):
        image[p] *= weight[p]


@compiled
def _divide(
    upper: NDArray[np.float32],
    lower: NDArray[np.float32],
    finer: NDArray[np.float32],
    band: NDArray[np.float32],
) -> None:
    """Put the weighted mean, and by how much the finer one, whose place it takes, is above it."""
    # Beyond the reach of any weight there is nothing to smooth.
    least = np.float32(1e-12)
    for x in range(np.uintp(len(finer))):
        total = lower[x]
        mean = upper[x] / (total if total > least else least)
        band[x] = finer[x] - mean
        finer[x] = mean


@compiled
def compose_rows(
    band: NDArray[np.float32],
    share: NDArray[np.float32],
    agreed: NDArray[np.float32],
    relief: NDArray[np.float32],
    held: NDArray[np.float32],
) -> None:
    """Add the share of relief in a band, and what is held back of it.

    Parameters
    ----------
    band : ndarray of float32, shape (3, rows, cols)
        The band by both directions, and by each alone.
    share, agreed : ndarray of float32, shape (rows, cols)
        Share of relief, and how far it is more than chance.
    relief : ndarray of float32, shape (3, rows, cols)
        Sum of the shares.
    held : ndarray of float32, shape (2, rows, cols)
        What is agreed on but no share, by each direction.
    """
    kinds, rows, _ = band.shape
    for y in range(rows):
        for kind in range(kinds):
            _add_share(band[kind, y], share[y], relief[kind, y])
        for kind in range(1, kinds):
            _add_held(band[kind, y], share[y], agreed[y], held[kind - 1, y])


@compiled
def _add_share(
    band: NDArray[np.float32], share: NDArray[np.float32], out: NDArray[np.float32]
) -> None:
    for x in range(np.uintp(len(out))):
        out[x] += share[x] * band[x]


@compiled
def _add_held(
    band: NDArray[np.float32],
    share: NDArray[np.float32],
    sure: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    for x in range(np.uintp(len(out))):
        out[x] += sure[x] * (_ONE - share[x]) * band[x]


@compiled
def add_products(
    level: NDArray[np.float32],
    large: NDArray[np.float32],
    alike: float,
    offsets: NDArray[np.float32],
    weights: NDArray[np.float32],
    sums: NDArray[np.float64],
) -> None:
    """Add up weighted products of 1 and four harmonics of the depth with each other and offsets.

    Parameters
    ----------
    level, large : ndarray of float32, shape (rows, cols)
        Depth, and a wide mean of it whose harmonics are taken; pixels count where both differ by
        less than `alike`.
    offsets, weights : ndarray of float32, shape (kinds, rows, cols)
        What is fitted, and with what weights.
    sums : ndarray of float64, shape (kinds, 5, 6)
        Products of 1, sin, cos, sin 2, cos 2 with the same and with the offset.
    """
    kinds, rows, cols = offsets.shape
    waves = np.empty(4 * _BLOCK, np.float32)
    certain = np.empty(_BLOCK, np.float32)
    for y in range(rows):
        for left in range(0, cols, _BLOCK):
            part = slice(left, min(left + _BLOCK, cols))
            here = level[y, part]
            _put_harmonics(large[y, part], waves)
            for kind in range(kinds):
                _put_certain(
                    here, large[y, part], np.float32(alike), weights[kind, y, part], certain
                )
                _add_block(waves, certain[: len(here)], offsets[kind, y, part], sums[kind])


@compiled
def _put_certain(
    level: NDArray[np.float32],
    large: NDArray[np.float32],
    alike: np.float32,
    weight: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    for x in range(np.uintp(len(level))):
        w = weight[x]
        out[x] = w if abs(large[x] - level[x]) < alike else _ZERO


@compiled
def _put_harmonics(depth: NDArray[np.float32], waves: NDArray[np.float32]) -> None:
    """Put sine and cosine of the place between frames, and of twice that."""
    for x in range(np.uintp(len(depth))):
        # Half the angle, at most a right one to either side, where powers up to 12 are enough.
        half = np.float32(np.pi) * (depth[x] - np.rint(depth[x]))
        q = half * half
        s = np.float32(-1 / 39916800) * q + np.float32(1 / 362880)
        s = s * q + np.float32(-1 / 5040)
        s = s * q + np.float32(1 / 120)
        s = s * q + np.float32(-1 / 6)
        s = half + half * q * s
        c = np.float32(1 / 479001600) * q + np.float32(-1 / 3628800)
        c = c * q + np.float32(1 / 40320)
        c = c * q + np.float32(-1 / 720)
        c = c * q + np.float32(1 / 24)
        c = c * q + np.float32(-1 / 2)
        c = _ONE + q * c
        sine, cosine = _TWO * s * c, _ONE - _TWO * s * s
        waves[x] = sine
        waves[_1 + x] = cosine
        waves[_2 + x] = _TWO * sine * cosine
        waves[_3 + x] = _ONE - _TWO * sine * sine


@summing
def _add_block(
    waves: NDArray[np.float32],
    weight: NDArray[np.float32],
    offset: NDArray[np.float32],
    sums: NDArray[np.float64],
) -> None:
    s0 = sa = sb = sc = sd = so = _ZERO
    aa = ab = ac = ad = ao = bb = bc = bd = bo = cc = cd = co = dd = do = _ZERO
    for x in range(np.uintp(len(weight))):
        w, o = weight[x], offset[x]
        a, b, c, d = waves[x], waves[_1 + x], waves[_2 + x], waves[_3 + x]
        s0 += w
        so += w * o
        wa, wb, wc, wd = w * a, w * b, w * c, w * d
        sa += wa
        sb += wb
        sc += wc
        sd += wd
        aa += wa * a
        ab += wa * b
        ac += wa * c
        ad += wa * d
        ao += wa * o
        bb += wb * b
        bc += wb * c
        bd += wb * d
        bo += wb * o
        cc += wc * c
        cd += wc * d
        co += wc * o
        dd += wd * d
        do += wd * o
    rows = (
        (s0, sa, sb, sc, sd, so),
        (sa, aa, ab, ac, ad, ao),
        (sb, ab, bb, bc, bd, bo),
        (sc, ac, bc, cc, cd, co),
        (sd, ad, bd, cd, dd, do),
    )
    for i in range(5):
        for j in range(6):
            sums[i, j] += rows[i][j]


@compiled
def unlock(
    level: NDArray[np.float32],
    offsets: NDArray[np.float32],
    factors: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Take from the offsets of each kind its `factors` (kinds, 4) times the depth's harmonics."""
    kinds, rows, cols = offsets.shape
    waves = np.empty(4 * _BLOCK, np.float32)
    for y in range(rows):
        for left in range(0, cols, _BLOCK):
            part = slice(left, min(left + _BLOCK, cols))
            _put_harmonics(level[y, part], waves)
            for kind in range(kinds):
                _take_waves(waves, factors[kind], offsets[kind, y, part], out[kind, y, part])


@compiled
def _take_waves(
    waves: NDArray[np.float32],
    factors: NDArray[np.float32],
    offset: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    a, b, c, d = factors[0], factors[1], factors[2], factors[3]
    for x in range(np.uintp(len(offset))):
        pull = a * waves[x] + b * waves[_1 + x] + c * waves[_2 + x] + d * waves[_3 + x]
        out[x] = offset[x] - pull


def median_above_zero(values: NDArray[np.float32]) -> float:
    """Return the median of the positive values, 1 if there are none.

    Examples
    --------
    >>> median_above_zero(np.array([0, 5, 1, 2, 0, 4], np.float32))
    3.0
    """
    counts = np.zeros(2**16, np.int64)
    _count_bits(values.ravel(), counts)
    total = int(counts.sum())
    if total == 0:
        return 1.0
    middle = np.array([(total - 1) // 2, total // 2])
    before = np.cumsum(counts) - counts
    low, high = np.searchsorted(before + counts, middle, side="right")
    near = np.empty(counts[low : high + 1].sum(), np.float32)
    _take_bits(values.ravel(), int(low), int(high), near)
    return float(np.partition(near, middle - before[low])[middle - before[low]].mean())


@compiled
def _count_bits(values: NDArray[np.float32], counts: NDArray[np.int64]) -> None:
    """Count positive values by their upper 16 bits, which are in the order of the values."""
    for k in range(np.uintp(len(values))):
        if values[k] > 0:
            counts[np.uintp(np.float32(values[k]).view(np.uint32) >> 16)] += 1


@compiled
def _take_bits(values: NDArray[np.float32], low: int, high: int, out: NDArray[np.float32]) -> None:
    taken = 0
    for k in range(np.uintp(len(values))):
        if values[k] > 0:
            upper = np.float32(values[k]).view(np.uint32) >> 16
            if low <= upper <= high:
                out[taken] = values[k]
                taken += 1
