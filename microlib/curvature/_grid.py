"""A height map on the working grid: holes closed, large maps averaged, noise known."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from microlib._common import Array
from microlib.curvature._descriptor import GRID

#: Root of the sum of the squares of the mask [1 −2 1]ᵀ[1 −2 1], by which it raises white noise.
_MASK_GAIN = 6.0
#: Noise that is assumed in the best of maps, in sides: a fifth of the least that was learned from,
#: and far above the rounding of heights.
_FLOOR = 1e-5
#: Standard deviation of a normal law over its median magnitude.
_NORMAL = 1.4826


@dataclass(frozen=True)
class Grid:
    """A map without NaN whose sides are at most `GRID`, its pixel size and its noise, µm."""

    height: Array
    pixel_size: float
    noise: float


def on_grid(z: Array, pixel_size: float, noise: float | None) -> Grid:
    """Close the holes of a map, average it to the working grid, and carry its noise along.

    A pixel of unknown height takes that of the nearest known one.
    """
    unknown = np.isnan(z)
    if unknown.any():
        nearest = ndimage.distance_transform_edt(
            unknown, return_distances=False, return_indices=True
        )
        z = z[tuple(nearest)]
    sigma = white_noise(z) if noise is None else noise
    sigma = max(sigma, _FLOOR * max(z.shape) * pixel_size)
    factor = max(z.shape) / GRID
    if factor <= 1:
        return Grid(z, pixel_size, sigma)
    rows, cols = (round(n / factor) for n in z.shape)
    reduced = cv2.resize(z, (cols, rows), interpolation=cv2.INTER_AREA)
    # The mean of factor² independent heights; a factor near 1 mixes neighbors and gains no less.
    return Grid(np.asarray(reduced, np.float64), pixel_size * factor, sigma / factor)


def white_noise(z: Array) -> float:
    """Standard deviation of what is white in a map, µm.

    The mask cancels planes and cylinders, and the median passes over edges (Immerkær, Computer
    Vision and Image Understanding 64, 1996, with a median for the mean).
    """
    across = z[:, :-2] - 2 * z[:, 1:-1] + z[:, 2:]
    both = across[:-2] - 2 * across[1:-1] + across[2:]
    return float(_NORMAL * np.median(np.abs(both)) / _MASK_GAIN)
