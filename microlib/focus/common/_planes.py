"""Smoothing of a map by planes that are fitted around every pixel."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from microlib._common import tukey_weights
from microlib.focus.common._threads import Spread

#: Rows and columns that are smoothed at a time. All their neighbors stay in the processor's cache.
#: A product of matrices with more columns is shared among the threads of OpenBLAS, which takes ten
#: times as long on a busy machine.
_TILE = 6, 512


def smooth_planes(
    depth: NDArray, weight: NDArray, *, jump: float, sigma: float, spread: Spread = map
) -> NDArray:
    """Smooth a map as `smooth_depth` describes it; the type is that of `depth`.

    Parameters
    ----------
    depth : ndarray, shape (rows, cols)
        Depths; NaN where unknown.
    weight : ndarray, shape (rows, cols)
        Weight of each depth.
    jump : float
        Difference in depth at and above which a neighbor has no weight.
    sigma : float
        Standard deviation of the Gaussian that weights neighbors by distance, px.
    spread : callable
        `map`, or that of a pool of threads, which then share the work.
    """
    unknown = np.isnan(depth)
    if unknown.all():
        return depth.copy()
    # The Gaussian is cut off at two standard deviations, where a neighbor counts e⁻²: twice as far
    # the sums would take four times as long. The spacing leaves 37 neighbors in the circle.
    stride = max(1, round(sigma / 1.75))
    cutoff = 2 * sigma * (1 + 1e-9)  # rounding of sigma takes no neighbor away
    reach = stride * int(cutoff / stride)
    span = range(-reach, reach + 1, stride)
    offsets = [(y, x) for y, x in product(span, span) if y * y + x * x <= cutoff**2]
    low, high = np.nanmin(depth), np.nanmax(depth)
    # A jump far beyond all differences is none: every neighbor counts in full. One below what
    # single precision tells apart lets none count but equal ones.
    unit = depth.dtype.type(np.clip(jump, 1e-9 * (high - low), 1e6 * (high - low)) or jump)
    # In units of the jump and from the middle, where float32 has digits to spare.
    rest = np.where(unknown, 0, (depth - (low + high) / 2) / unit).astype(np.float32)
    mass = np.pad(np.where(unknown, 0, weight).astype(np.float32), reach)
    # What planes leave over is their shift with its sign turned; the smooth parts are the rest.
    for _ in range(2):
        rest = -_plane_shift(np.pad(rest, reach), mass, np.array(offsets), sigma, spread)
    return depth - unit * rest


def _plane_shift(
    value: NDArray[np.float32],
    mass: NDArray[np.float32],
    offsets: NDArray[np.intp],
    sigma: float,
    spread: Spread,
) -> NDArray[np.float32]:
    """Return by how much the plane through its neighborhood passes above each value, in jumps."""
    reach = int(offsets.max())
    rows, cols = (n - 2 * reach for n in value.shape)
    y, x = offsets.T
    share = np.exp(-(y**2 + x**2) / (2 * sigma**2))
    basis = (np.stack([np.ones(len(x)), x, y, x * x, y * y, x * y]) * share).astype(np.float32)
    out = np.empty((rows, cols), np.float32)

    def fit(corners: list[tuple[int, int]]) -> None:
        for top, left in corners:
            tile = out[top : top + _TILE[0], left : left + _TILE[1]]
            gaps, weights = (
                sliding_window_view(image, tile.shape)[top + reach + y, left + reach + x]
                for image in (value, mass)
            )
            gaps -= value[top + reach :, left + reach :][: len(tile), : len(tile[0])]
            weights *= tukey_weights(gaps, 1.0)  # of the differences in jumps
            gaps *= weights
            # One product for each row.
            moments = np.moveaxis(basis @ np.moveaxis(weights, 1, 0), 1, 0)
            raised = np.moveaxis(basis[:3] @ np.moveaxis(gaps, 1, 0), 1, 0)
            tile[:] = _plane_height(moments, raised, sigma)

    corners = list(product(range(0, rows, _TILE[0]), range(0, cols, _TILE[1])))
    list(spread(fit, [corners[k::16] for k in range(16)]))
    return out


def _plane_height(moments: NDArray, raised: NDArray, sigma: float) -> NDArray:
    """Return how far planes lie above their pixels, by Cramer's rule; 0 where there is none.

    Parameters
    ----------
    moments : ndarray, shape (6, rows, cols)
        Sums of the weights with 1, x, y, x², y², xy.
    raised : ndarray, shape (3, rows, cols)
        Sums of the weighted gaps with 1, x, y.
    sigma : float
        Standard deviation of the Gaussian, px.
    """
    s, sx, sy, sxx, syy, sxy = moments.astype(np.float64)
    t, tx, ty = raised
    # Added to the variance of the neighbors' places, this makes the planes stiff where neighbors
    # lie on one line; beside that of a full circle, 0.7 of the square of sigma, it is nothing.
    stiffness = 0.001 * sigma**2 * s
    sxx, syy = sxx + stiffness, syy + stiffness
    c0, c1, c2 = sxx * syy - sxy * sxy, sx * syy - sxy * sy, sx * sxy - sxx * sy
    determinant = s * c0 - sx * c1 + sy * c2
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(determinant > 0, (t * c0 - tx * c1 + ty * c2) / determinant, 0)
