"""Where a thin dark wall lies across a profile, to a few hundredths of a pixel.

A chorion in transmitted light is a dark line between two grey levels. After a Gaussian blur of
width s the profile along its normal is a step plus a bump, both centered on the wall's middle, and
a least-squares fit of that shape finds the middle without the bias of a gradient's maximum, which
lies on the wall's outer flank.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import ndtr

from microlib._common import Array

#: Samples wanted of a profile, more than its four unknowns; nothing changes from 5 to 10.
_LEAST_SAMPLES = 6


@dataclass(frozen=True)
class Settings:
    """Settings of the stages from an image to its outline; lengths are in px.

    The changes of the modulus E are the largest of nine embryos, in standard deviations of E, for
    the other values that are given.
    """

    #: What the probe's blur reaches is left out: so many of its standard deviations, once they are
    #: known. Less biases the flank, more takes its steepest part away: 0.6 for 2 or 4.5.
    blur_reach: float = 3.0
    #: Blur of Canny's edge, which only starts the fits of the wall: 0.5 for 1 or 2.
    edge_blur: float = 1.4
    #: How far the samples along the normal reach to either side: the blur of a wall, what Canny may
    #: err, and ground and fluid beyond. 1.2 for 4 or 7.
    profile_reach: float = 5.0
    #: Points over which the direction of the outline is averaged: 0.5 for 7 or 17.
    smoothing: int = 11
    #: Points less certain than so many times the usual are left out: 0.3 for 4 or 10.
    largest_std: float = 6.0
    #: The wall is sought within this distance of the middle of a profile: Canny's edge lies on the
    #: wall's outer flank and in whole px. 1.2 for 1.8, which loses steep walls, 0.2 for 3.5.
    reach: float = 2.5
    #: Blur of the first search, about that of the workstation's images: 0.4 for 0.8 or 1.6.
    usual_width: float = 1.1
    #: Its steps, a quarter of that, from which the least squares converge: 0.3 for 0.1 or 0.5.
    search_step: float = 0.25
    #: Steps of Gauss–Newton: 0.7 for 3 or 10.
    iterations: int = 5
    #: One profile in so many tells the blur that all have: 0.6 for 1 or 8.
    every: int = 4


class WallPosition(NamedTuple):
    """Walls found in a set of profiles, in the unit of the offsets."""

    position: Array  # middle of the wall; NaN where none was found
    std: Array  # standard deviation of `position` from the residuals of all profiles
    width: float  # standard deviation of the blur common to all profiles


def locate_wall(
    profiles: Array, offsets: Array, *, weights: NDArray, settings: Settings = Settings()
) -> WallPosition:
    r"""Fit a blurred wall to each of a set of profiles.

    .. math:: I(d) = b_0 + b_1 \Phi\left(\frac{d-\delta}{s}\right)
              + b_2 \exp\left(-\frac{(d-\delta)^2}{2s^2}\right)

    Parameters
    ----------
    profiles : ndarray, shape (n, m)
        Grey levels.
    offsets : ndarray, shape (m,)
        Place of each sample along the profile, ascending, in px.
    weights : ndarray, shape (n, m)
        1 for samples to use, 0 for samples to leave out.
    settings : Settings
        Of the search.

    Returns
    -------
    WallPosition
        :math:`\delta` of each profile, its standard deviation, and the common s.

    Raises
    ------
    ValueError
        If no profile has enough samples.

    Notes
    -----
    :math:`\delta` is scanned with the linear coefficients eliminated, then polished together with
    them by Gauss–Newton. s is the value with the least total residual. A profile whose used samples
    do not reach one width to either side of its wall, or whose wall lies outside the scan, gives
    NaN.

    Examples
    --------
    >>> from microlib.embryo._wall import locate_wall
    >>> import numpy as np
    >>> from scipy.special import ndtr
    >>> d = np.arange(-5, 5.5, 0.5)
    >>> wall = 200 - 30 * ndtr((d - 0.3) / 1.1) - 40 * np.exp(-(((d - 0.3) / 1.1) ** 2) / 2)
    >>> found = locate_wall(wall[np.newaxis], d, weights=np.ones((1, d.size)))
    >>> round(float(found.position[0]), 3), round(found.width, 2)
    (0.3, 1.1)
    """
    keep = weights.astype(float)
    few = keep.sum(axis=1) < _LEAST_SAMPLES
    if few.all():
        raise ValueError(
            f"weights must leave at least {_LEAST_SAMPLES} samples of a profile, got fewer in each"
        )

    # One of the places alike for all, of which each profile takes the one that leaves it the least.
    reach, usual = settings.reach, settings.usual_width
    grid = np.arange(-reach, reach + settings.search_step / 2, settings.search_step)
    left = [_linear_fit(profiles, offsets, keep, usual, place)[2] for place in grid[:, None]]
    start = grid[np.argmin(np.sum(np.square(left), axis=2), axis=0)]
    some = slice(None, None, settings.every)
    part = profiles[some], offsets, keep[some]

    def misfit(width: float) -> float:
        return _gauss_newton(*part, width, start[some], settings)[2]

    # In px; other ranges and tolerances change E by up to 0.16 of its deviation.
    width = float(minimize_scalar(misfit, bounds=(0.5, 3), method="bounded").x)
    found, std, _ = _gauss_newton(profiles, offsets, keep, width, start, settings)
    first = np.where(keep, offsets, np.inf).min(axis=1)
    last = np.where(keep, offsets, -np.inf).max(axis=1)
    bad = few | (np.abs(found) > reach) | (first > found - width) | (last < found + width)
    found[bad] = std[bad] = np.nan
    return WallPosition(found, std, width)


def _normal(keep: Array, columns: Array) -> Array:
    """Return the weighted normal matrix of each profile, slightly damped."""
    # As products of matrices: a sum over three factors takes four times as long.
    normal = (keep[..., np.newaxis] * columns).swapaxes(1, 2) @ columns
    return np.asarray(normal + np.sqrt(np.finfo(float).eps) * np.eye(columns.shape[-1]))


def _linear_fit(
    data: Array, offsets: Array, keep: Array, width: float, position: Array
) -> tuple[Array, Array, Array]:
    """Fit level, step and bump: their columns, their coefficients, and what is left of the data."""
    scaled = (offsets - position[:, np.newaxis]) / width
    basis = np.stack([np.ones_like(scaled), ndtr(scaled), np.exp(-(scaled**2) / 2)], axis=-1)
    right = (keep * data)[:, np.newaxis] @ basis
    linear = np.linalg.solve(_normal(keep, basis), right.swapaxes(1, 2))[..., 0]
    return basis, linear, keep * (data - (basis @ linear[..., np.newaxis])[..., 0])


def _gauss_newton(
    data: Array, offsets: Array, keep: Array, width: float, position: Array, settings: Settings
) -> tuple[Array, Array, float]:
    """Gauss–Newton on position and linear coefficients: positions, their spread, the residual."""
    position = position.copy()
    for _ in range(settings.iterations):
        basis, linear, residual = _linear_fit(data, offsets, keep, width, position)
        scaled, bell = (offsets - position[:, np.newaxis]) / width, basis[..., 2]
        slope = bell * (scaled * linear[:, 2:] - linear[:, 1:2] / np.sqrt(2 * np.pi)) / width
        jacobian = np.concatenate([basis, slope[..., np.newaxis]], axis=-1)
        hessian = _normal(keep, jacobian)
        gradient = np.einsum("nmi,nm->ni", jacobian, residual)
        step = np.linalg.solve(hessian, gradient[..., np.newaxis])[:, 3, 0]
        position += np.clip(step, -0.5, 0.5)  # no longer, so that the wall stays in sight
        # Beyond the reach it is no wall.
        position = np.clip(position, -2 * settings.reach, 2 * settings.reach)
    squares = float(np.sum(residual**2))
    noise = squares / max(float(np.maximum(keep.sum(axis=1) - 4, 0).sum()), 1.0)
    # Samples closer together than a pixel are not independent.
    independent = min(1.0, float(np.diff(offsets).mean()))
    spread = np.sqrt(noise / independent * np.linalg.inv(hessian)[:, 3, 3])
    return position, spread, squares
