"""What a detector returns, and what both detectors ask of an outline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from microlib._common import Array, Tidy

#: A homography from the grid to the image needs as many shapes.
FEWEST = 4
#: Narrowest and widest band around an outline, px. Pixels far from it tell the ground that the
#: outline stands on: a widest of 4, 5, 7 and 10 leaves errors of 1.06, 1.02, 1 and 0.99, more and
#: more of it for dirt to lie in; the narrowest makes no difference from 1 to 3.
_NARROWEST, _WIDEST = 2.0, 7.0
#: Most residual, least contrast and most uncertainty of an outline, in medians of all.
#: Residuals of up to 5 medians let 2 wrong points of 1961 pass that 3 keeps out, and 2 costs 12
#: right ones; contrasts from 0.25 to 0.75 and uncertainties from 3 to 20 make no difference
#: beside it.
_MOST_RMS, _LEAST_CONTRAST, _MOST_SIGMA = 3.0, 0.5, 5.0


@dataclass(frozen=True)
class Detection(Tidy):
    """Points of a calibration pattern found in an image.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        (x, y), px.
    grid : ndarray of int, shape (N, 2)
        Coordinates in the pattern, from zero on, or from its origin mark; times the pitch they are
        world points up to a shift.
    sigma : ndarray, shape (N,)
        Standard deviation of a coordinate of each point, px: as the fit of its outline tells it, or
        as the points' residuals from a smooth image of a lattice do, where these are larger.
    group : ndarray of int, shape (N,)
        Number of the shape that each point belongs to: errors within one shape are correlated.
    positions : ndarray, shape (N, 2)
        Where the points lie in the pattern, in pitches from mark to mark; times the pitch in µm
        they are world points up to a shift. Of squares they hold the side that was measured, which
        need not be half of the pitch; of an asymmetric grid the unit is the distance of its rows.
    side : float
        Side of the squares in pitches; NaN for circles.
    misfit : float
        What the points' residuals are, over what their outlines' fits state; about one for a
        pattern without faults. NaN where there are too few marks to tell.
    """

    _samples = ("grid", "points", "sigma", "group")

    points: Array
    grid: NDArray[np.intp]
    sigma: Array
    group: NDArray[np.intp]
    positions: Array
    side: float
    misfit: float


def band_half_width(centers: Array, radius: float) -> float:
    """Half-width of the band around an outline that belongs to no neighbor.

    Parameters
    ----------
    centers : ndarray, shape (N, 2)
        Centers of the shapes, px.
    radius : float
        Half of a shape's width, px.

    Returns
    -------
    float
        px, between 2 and 7.

    Examples
    --------
    >>> band_half_width(np.array([[0.0, 0.0], [20.0, 0.0], [40.0, 0.0]]), 6.0)
    4.0
    """
    distance, _ = cKDTree(centers).query(centers, k=2)
    return float(np.clip(np.median(distance[:, 1]) / 2 - radius, _NARROWEST, _WIDEST))


def find_inliers(
    shape: tuple[int, ...],
    low: Array,
    high: Array,
    rms: Array,
    contrast: Array,
    sigma: Array,
) -> NDArray[np.bool_]:
    """Tell the outlines that lie inside the image and are fitted as well as the others.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the image, px.
    low, high : ndarray, shape (N, 2)
        Corners of the box around each outline, (x, y) px.
    rms : ndarray, shape (N,)
        Residual of each fit, grey levels; NaN where it failed.
    contrast : ndarray, shape (N,)
        Fitted contrast.
    sigma : ndarray, shape (N,)
        Standard deviation of the worst point of each outline, px.

    Returns
    -------
    ndarray of bool, shape (N,)
        False for an outline that leaves the image, and for one whose residual exceeds three times
        the median (dirt, a reflection, another shape), whose contrast is half of the median or
        less, or whose uncertainty is over five times the median (a side that the image cuts off).

    Examples
    --------
    >>> low = np.array([[1.0, 1.0], [5.0, -0.2]])
    >>> one = np.ones(2)
    >>> find_inliers((20, 30), low, low + 4, one, one, one)
    array([ True, False])
    """
    for name, values in (("rms", rms), ("contrast", contrast), ("sigma", sigma)):
        if np.shape(values) != np.shape(low)[:1]:
            raise ValueError(
                f"{name} must hold one value for each of the {len(low)} outlines, got shape "
                f"{np.shape(values)}"
            )
    inside = ((low >= 0) & (high <= [shape[1] - 1, shape[0] - 1])).all(axis=1)
    good = inside & np.isfinite(rms) & np.isfinite(sigma)
    if not good.any():
        return good
    return (
        good
        & (rms <= _MOST_RMS * np.median(rms[good]))
        & (contrast > _LEAST_CONTRAST * np.median(contrast[good]))
        & (sigma <= _MOST_SIGMA * np.median(sigma[good]))
    )
