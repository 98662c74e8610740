"""What a detector returns, and what both detectors ask of a fitted outline before they trust it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

__all__ = ["Detection", "keep_sound", "margin_for"]

#: Pixels further from an outline than this say little about it, px.
MARGIN = 7.0


@dataclass(frozen=True)
class Detection:
    """Points of a calibration pattern found in an image.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        (x, y), px.
    grid : ndarray of int, shape (N, 2)
        Coordinates in the pattern, from zero on; times the pitch they are world points up to a
        shift.
    sigma : ndarray, shape (N,)
        Standard deviation of a coordinate of each point as the fit's residual tells it, px.
    group : ndarray of int, shape (N,)
        Number of the shape that each point belongs to: errors within one shape are correlated.
    """

    points: NDArray[np.float64]
    grid: NDArray[np.intp]
    sigma: NDArray[np.float64]
    group: NDArray[np.intp]


def margin_for(centres: NDArray[np.float64], radius: float) -> float:
    """Half-width of the band around an outline that belongs to no neighbour, px."""
    distance, _ = cKDTree(centres).query(centres, k=2)
    return float(np.clip(np.median(distance[:, 1]) / 2 - radius, 2.0, MARGIN))


def keep_sound(
    shape: tuple[int, ...],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    rms: NDArray[np.float64],
    contrast: NDArray[np.float64],
    sigma: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Outlines inside the image (their box is `low` to `high`) that are fitted as well as the
    others.

    One is dropped if its residual exceeds three times the median (dirt, a reflection, another
    shape), its contrast half of the median or less, or its uncertainty five times the median (a
    side that the image cuts off).
    """
    inside = ((low >= 0) & (high <= [shape[1] - 1, shape[0] - 1])).all(axis=1)
    good = inside & np.isfinite(rms) & np.isfinite(sigma)
    if not good.any():
        return good
    return (
        good
        & (rms <= 3 * np.median(rms[good]))
        & (contrast > np.median(contrast[good]) / 2)
        & (sigma <= 5 * np.median(sigma[good]))
    )
