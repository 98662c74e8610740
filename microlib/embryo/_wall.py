"""Where a thin dark wall lies across a profile, to a few hundredths of a pixel.

A chorion in transmitted light is a dark line between two grey levels. After a Gaussian blur of
width s the profile along its normal is a step plus a bump, both centered on the wall's middle, and
a least-squares fit of that shape finds the middle without the bias of a gradient's maximum, which
lies on the wall's outer flank.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import ndtr

from microlib._common import Array

# Lengths are in px. What other values do to the modulus stands in the benchmark "Other values of
# the constants" (benchmarks/embryo.py).

#: The wall is sought within this distance of the middle of a profile: Canny's edge lies on the
#: wall's outer flank and in whole px. 1.8 loses steep walls and changes E by more than its
#: deviation; 3.5 by 0.2 of it.
_REACH = 2.5
#: Range of the blur, and how well it is found; 0.4 to 5, and 0.001 to 0.1, change E by up to
#: 0.24 of its deviation.
_WIDTHS, _WIDTH_TOLERANCE = (0.6, 3.0), 0.01
#: Blur of the first search, about that of the workstation's images, and its steps, a quarter of it,
#: from which the least squares converge. 0.8 to 1.6, and 0.1 to 0.5, change E by up to 0.35 of its
#: deviation.
_USUAL_WIDTH, _SEARCH_STEP = 1.1, 0.25
#: Steps of Gauss–Newton, none longer than this: half a px leaves the wall in sight. 3 to 10, and
#: 0.25 to 1, change E by up to 0.69 of its deviation.
_ITERATIONS = 5
_LONGEST_STEP = 0.5
#: One profile in so many tells the blur that all have; 1 to 8 change E by up to 0.58 of its
#: deviation.
_EVERY = 4
#: Samples wanted of a profile, more than its four unknowns; nothing changes from 5 to 10.
_LEAST_SAMPLES = 6
#: Damping that keeps profiles solvable whose samples lie on one side only. The normal equations are
#: of the order of 1; nothing changes from 1e-11 to 1e-6.
_DAMPING = 1e-9


class WallPosition(NamedTuple):
    """Walls found in a set of profiles, in the unit of the offsets."""

    position: Array  # middle of the wall; NaN where none was found
    std: Array  # standard deviation of `position` from the residuals of all profiles
    width: float  # standard deviation of the blur common to all profiles


def locate_wall(profiles: Array, offsets: Array, *, weights: NDArray) -> WallPosition:
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
    grid = np.arange(-_REACH, _REACH + _SEARCH_STEP / 2, _SEARCH_STEP)
    left = [_linear_fit(profiles, offsets, keep, _USUAL_WIDTH, place)[2] for place in grid[:, None]]
    start = grid[np.argmin(np.sum(np.square(left), axis=2), axis=0)]
    some = slice(None, None, _EVERY)
    search = minimize_scalar(
        lambda width: _gauss_newton(profiles[some], offsets, keep[some], width, start[some])[2],
        bounds=_WIDTHS,
        method="bounded",
        options={"xatol": _WIDTH_TOLERANCE},
    )
    width = float(search.x)
    found, std, _ = _gauss_newton(profiles, offsets, keep, width, start)
    reached = keep > 0
    first = np.where(reached, offsets, np.inf).min(axis=1)
    last = np.where(reached, offsets, -np.inf).max(axis=1)
    bad = few | (np.abs(found) > _REACH) | (first > found - width) | (last < found + width)
    found[bad] = std[bad] = np.nan
    return WallPosition(found, std, width)


def _normal(keep: Array, columns: Array) -> Array:
    """Return the weighted normal matrix of each profile, slightly damped."""
    # As products of matrices: a sum over three factors takes four times as long.
    normal = (keep[..., np.newaxis] * columns).swapaxes(1, 2) @ columns
    return np.asarray(normal + _DAMPING * np.eye(columns.shape[-1]))


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
    data: Array, offsets: Array, keep: Array, width: float, position: Array
) -> tuple[Array, Array, float]:
    """Gauss–Newton on position and linear coefficients: positions, their spread, the residual."""
    position = position.copy()
    for _ in range(_ITERATIONS):
        basis, linear, residual = _linear_fit(data, offsets, keep, width, position)
        scaled, bell = (offsets - position[:, np.newaxis]) / width, basis[..., 2]
        slope = bell * (scaled * linear[:, 2:] - linear[:, 1:2] / np.sqrt(2 * np.pi)) / width
        jacobian = np.concatenate([basis, slope[..., np.newaxis]], axis=-1)
        hessian = _normal(keep, jacobian)
        gradient = np.einsum("nmi,nm->ni", jacobian, residual)
        step = np.linalg.solve(hessian, gradient[..., np.newaxis])[:, 3, 0]
        position += np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
        position = np.clip(position, -2 * _REACH, 2 * _REACH)  # beyond _REACH it is no wall
    squares = float(np.sum(residual**2))
    noise = squares / max(float(np.maximum(keep.sum(axis=1) - 4, 0).sum()), 1.0)
    # Samples closer together than a pixel are not independent.
    independent = min(1.0, float(np.diff(offsets).mean()))
    spread = np.sqrt(noise / independent * np.linalg.inv(hessian)[:, 3, 3])
    return position, spread, squares
