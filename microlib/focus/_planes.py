"""The planes of `smooth_depth`: compiled, a stretch of a row at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from microlib.focus._compiled import compiled

__all__ = ["BLOCK", "plane_rows"]

#: Pixels of a row that are smoothed at a time: their sums stay in the processor's first cache. A
#: fixed number, so that one pixel is computed as any other is.
BLOCK = 256
# Whole numbers without a sign, which need no test for counting from an array's end.
_BLOCK = np.uintp(BLOCK)
_1, _2, _3, _4 = (np.uintp(k * BLOCK) for k in range(1, 5))
_5, _6, _7, _8 = (np.uintp(k * BLOCK) for k in range(5, 9))


@compiled
def plane_rows(
    values: NDArray[np.float32],
    weights: NDArray[np.float32],
    top: int,
    reach: int,
    stride: int,
    sigma: float,
    radius: float,
    stiffness: float,
    out: NDArray[np.float32],
) -> None:
    """Write by how much the plane through its neighborhood passes above each depth.

    Parameters
    ----------
    values, weights : ndarray of float32, shape (height, blocks · BLOCK + 2 reach)
        Depths in units of the jump, finite, and their weights, with `reach` columns of zeros on
        the left and at least as many on the right.
    top : int
        First row that is wanted.
    reach, stride : int
        Largest distance of a neighbor along a row or column, and the distance between neighbors.
    sigma, radius : float
        Standard deviation of the Gaussian that weights neighbors, and the largest distance.
    stiffness : float
        Variance of position that is added to the neighbors' own, px².
    out : ndarray of float32, shape (rows, cols)
        Rows `top` and following of the result.
    """
    height, padded = values.shape
    flat, masses = values.reshape(values.size), weights.reshape(weights.size)
    rows, cols = out.shape
    # Sums of w, w·dx, w·dx², wv and wv·dx over the neighbors in a row; of w, wx, wy, wx², wy²,
    # wxy and of wv, wvx, wvy over all.
    along = np.empty(5 * BLOCK, np.float32)
    moments = np.empty(9 * BLOCK, np.float32)
    for row in range(rows):
        for left in range(0, cols, BLOCK):
            here = (top + row) * padded + left + reach
            moments[:] = 0
            for dy in range(-reach, reach + 1, stride):
                if not 0 <= top + row + dy < height:
                    continue
                along[:] = 0
                for dx in range(0, reach + 1, stride):
                    if dx * dx + dy * dy <= radius * radius:
                        share = np.exp(-dx * dx / (2 * sigma * sigma))
                        # The middle is its own mirror image, and counts once.
                        share = share if dx else share / 2
                        _add_both_sides(flat, masses, here, here + dy * padded, dx, share, along)
                _add_row(along, dy, np.exp(-dy * dy / (2 * sigma * sigma)), moments)
            _solve_planes(moments, stiffness, out[row, left : left + BLOCK])


@compiled
def _add_both_sides(
    values: NDArray[np.float32],
    weights: NDArray[np.float32],
    middle: int,
    center: int,
    dx: int,
    share: float,
    sums: NDArray[np.float32],
) -> None:
    """Add the neighbors at `dx` to the right and to the left of `center`."""
    one = np.float32(1)
    f0, f1, f2 = np.float32(share), np.float32(share * dx), np.float32(share * dx * dx)
    here, right, left = np.uintp(middle), np.uintp(center + dx), np.uintp(center - dx)
    for x in range(_BLOCK):
        v = values[here + x]
        a, b = values[right + x] - v, values[left + x] - v
        p, q = one - a * a, one - b * b
        p = p if p > 0 else np.float32(0)
        q = q if q > 0 else np.float32(0)
        p, q = p * p * weights[right + x], q * q * weights[left + x]
        even, odd = p + q, p - q
        a, b = a * p, b * q
        sums[x] += f0 * even
        sums[_1 + x] += f1 * odd
        sums[_2 + x] += f2 * even
        sums[_3 + x] += f0 * (a + b)
        sums[_4 + x] += f1 * (a - b)


@compiled
def _add_row(
    along: NDArray[np.float32], dy: int, share: float, moments: NDArray[np.float32]
) -> None:
    """Add the sums over a row of neighbors to those over all."""
    f0, f1, f2 = np.float32(share), np.float32(share * dy), np.float32(share * dy * dy)
    for x in range(_BLOCK):
        s, sx, sxx = along[x], along[_1 + x], along[_2 + x]
        t, tx = along[_3 + x], along[_4 + x]
        moments[x] += f0 * s
        moments[_1 + x] += f0 * sx
        moments[_2 + x] += f1 * s
        moments[_3 + x] += f0 * sxx
        moments[_4 + x] += f2 * s
        moments[_5 + x] += f1 * sx
        moments[_6 + x] += f0 * t
        moments[_7 + x] += f0 * tx
        moments[_8 + x] += f1 * t


@compiled
def _solve_planes(moments: NDArray[np.float32], stiffness: float, out: NDArray[np.float32]) -> None:
    """Solve the normal equations of every pixel for the plane's height."""
    for x in range(len(out)):
        s, sx, sy = np.float64(moments[x]), np.float64(moments[_1 + x]), np.float64(moments[_2 + x])
        sxx, syy = moments[_3 + x] + stiffness * s, moments[_4 + x] + stiffness * s
        sxy = np.float64(moments[_5 + x])
        a, b, c = sxx * syy - sxy * sxy, sx * syy - sxy * sy, sx * sxy - sxx * sy
        det = s * a - sx * b + sy * c
        height = (moments[_6 + x] * a - moments[_7 + x] * b + moments[_8 + x] * c) / det
        out[x] = np.float32(height if det > 0 else 0.0)
