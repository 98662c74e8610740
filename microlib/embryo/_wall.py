"""Position of a thin dark wall across a grey-level profile, to a few hundredths of a pixel.

A chorion in transmitted light is a dark line between two grey levels. After a Gaussian blur the
profile along its normal is a step plus a bump, both centered on the middle of the wall. The
least-squares fit of this shape has no bias, unlike the maximum of the gradient, which lies on the
outer flank of the wall.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import ndtr

from microlib._common import Array

#: Largest distance between wall and middle of a profile, px. Canny's edge lies on the outer flank
#: of the wall, in whole px. A range of 1.8 px loses steep walls.
_SEARCH_RANGE = 2.5


class WallPosition(NamedTuple):
    """Walls found in a set of profiles, in the unit of the offsets."""

    position: Array  # middle of the wall; NaN where none was found
    std: Array  # standard deviation of `position` from the residuals of all profiles
    blur: float  # standard deviation of the blur that all profiles have


def locate_wall(
    profiles: Array, offsets: Array, *, weights: NDArray, pixel: float = 1.0
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
    pixel : float, optional
        Size of a pixel in the unit of the offsets. Samples closer together are not independent.

    Returns
    -------
    WallPosition
        :math:`\delta` of each profile, its standard deviation, and the blur s of all profiles.

    Raises
    ------
    ValueError
        If no profile has enough samples.

    Notes
    -----
    :math:`\delta` is scanned with the linear coefficients eliminated, and then refined together
    with them by Gauss–Newton iterations. The blur s has the least total residual. The position is
    NaN where the samples used do not extend by s to either side of the wall, or where the wall is
    outside the search range.

    Examples
    --------
    >>> from microlib.embryo._wall import locate_wall
    >>> import numpy as np
    >>> from scipy.special import ndtr
    >>> d = np.arange(-5, 5.5, 0.5)
    >>> wall = 200 - 30 * ndtr((d - 0.3) / 1.1) - 40 * np.exp(-(((d - 0.3) / 1.1) ** 2) / 2)
    >>> found = locate_wall(wall[np.newaxis], d, weights=np.ones((1, d.size)))
    >>> round(float(found.position[0]), 3), round(found.blur, 2)
    (0.3, 1.1)
    """
    used = weights.astype(float)
    too_few = used.sum(axis=1) < 6  # more than the four unknowns
    if too_few.all():
        raise ValueError("weights must leave at least 6 samples of a profile, got fewer in each")

    # The scan has a usual blur, and steps from which Gauss–Newton converges.
    grid = np.arange(-_SEARCH_RANGE, _SEARCH_RANGE + 0.125, 0.25)
    residuals = [_fit_linear(profiles, offsets, used, 1.1, place)[2] for place in grid[:, None]]
    start = grid[np.argmin(np.sum(np.square(residuals), axis=2), axis=0)]
    # Every fourth profile determines the blur well enough.
    part = profiles[::4], offsets, used[::4]

    def cost(blur: float) -> float:
        return _gauss_newton(*part, blur, start[::4])[2]

    blur = float(minimize_scalar(cost, bounds=(0.5, 3), method="bounded").x)
    position, hessian, squares = _gauss_newton(profiles, offsets, used, blur, start)
    # Samples closer together than a pixel count as samples one pixel apart.
    independent = min(1.0, float(np.diff(offsets).mean()) / pixel) * used.sum(axis=1)
    noise = squares / max(float(np.maximum(independent - 4, 0).sum()), 1.0)
    std = np.sqrt(noise * np.linalg.inv(hessian)[:, 3, 3])
    first = np.where(used, offsets, np.inf).min(axis=1)
    last = np.where(used, offsets, -np.inf).max(axis=1)
    cut_off = (first > position - blur) | (last < position + blur)
    missing = too_few | cut_off | (np.abs(position) > _SEARCH_RANGE)
    position[missing] = std[missing] = np.nan
    return WallPosition(position, std, blur)


def _normal_matrix(used: Array, columns: Array) -> Array:
    """Return the weighted normal matrix of each profile, slightly damped."""
    # As products of matrices: a sum over three factors takes four times as long.
    normal = (used[..., np.newaxis] * columns).swapaxes(1, 2) @ columns
    return np.asarray(normal + np.sqrt(np.finfo(float).eps) * np.eye(columns.shape[-1]))


def _fit_linear(
    profiles: Array, offsets: Array, used: Array, blur: float, position: Array
) -> tuple[Array, Array, Array]:
    """Fit level, step and bump: return their columns, their coefficients and the residuals."""
    scaled = (offsets - position[:, np.newaxis]) / blur
    basis = np.stack([np.ones_like(scaled), ndtr(scaled), np.exp(-(scaled**2) / 2)], axis=-1)
    right = (used * profiles)[:, np.newaxis] @ basis
    linear = np.linalg.solve(_normal_matrix(used, basis), right.swapaxes(1, 2))[..., 0]
    return basis, linear, used * (profiles - (basis @ linear[..., np.newaxis])[..., 0])


def _gauss_newton(
    profiles: Array, offsets: Array, used: Array, blur: float, position: Array
) -> tuple[Array, Array, float]:
    """Refine the positions; return them, their normal matrices and the sum of squares."""
    position = position.copy()
    for _ in range(5):
        basis, linear, residual = _fit_linear(profiles, offsets, used, blur, position)
        scaled, bell = (offsets - position[:, np.newaxis]) / blur, basis[..., 2]
        slope = bell * (scaled * linear[:, 2:] - linear[:, 1:2] / np.sqrt(2 * np.pi)) / blur
        jacobian = np.concatenate([basis, slope[..., np.newaxis]], axis=-1)
        hessian = _normal_matrix(used, jacobian)
        gradient = np.einsum("nmi,nm->ni", jacobian, residual)
        step = np.linalg.solve(hessian, gradient[..., np.newaxis])[:, 3, 0]
        # Limited, so that the wall stays within the samples.
        position += np.clip(step, -0.5, 0.5)
        position = np.clip(position, -2 * _SEARCH_RANGE, 2 * _SEARCH_RANGE)
    return position, hessian, float(np.sum(residual**2))
