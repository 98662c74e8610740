"""Position of a thin dark wall across a grey-level profile, to a few hundredths of a pixel.

A chorion in transmitted light is a dark line between two grey levels. After a Gaussian blur the
profile along its normal is a step plus a bump, both centered on the middle of the wall. The
least-squares fit of this shape has no bias, unlike the maximum of the gradient, which lies on the
outer flank of the wall.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar
from scipy.special import ndtr

from microlib._common import Array, NormalEquations, gauss_newton

#: Largest distance between wall and middle of a profile, in the unit of the offsets. Canny's edge
#: lies on the outer flank of the wall, in whole px. A range of 1.8 loses steep walls.
_SEARCH_RANGE = 2.5
#: Least number of samples of a profile, more than the four unknowns.
_FEWEST = 6


class WallPosition(NamedTuple):
    """Walls found in a set of profiles, in the unit of the offsets."""

    position: Array  # middle of the wall; NaN where none was found
    uncertainty: Array  # standard deviation of `position` from the residuals of all profiles
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
        Place of each sample along the profile, ascending, in units in which the blur is 0.5 to 3 (a
        px, or two for a broad blur).
    weights : ndarray, shape (n, m)
        1 for samples to use, 0 for samples to leave out.
    pixel : float, optional
        Size of a px in that unit. Samples closer together are not independent.

    Returns
    -------
    WallPosition
        :math:`\delta` of each profile, its standard uncertainty, and the blur s of all profiles.

    Raises
    ------
    ValueError
        If no profile has enough samples.

    Notes
    -----
    The linear coefficients are eliminated, so that :math:`\delta` is the only unknown of each
    profile. It is scanned, and then refined by a damped Gauss–Newton fit. The blur s has the least
    total residual. The position is NaN where the samples used do not extend by s to either side of
    the wall, or where the wall is outside the search range.

    A step that is moved a little differs from the step by a bump. Where both coefficients are free
    and the edge has no dark wall, the position is therefore uncertain by half a pixel. The fit is
    repeated without a bump, and with a bump that is the same multiple of the step in all profiles.
    It is used if its positions are clearly more certain. Without a wall, the position is where the
    profile crosses the middle level.

    Examples
    --------
    >>> from microlib.embryo._wall import locate_wall
    >>> import numpy as np
    >>> from scipy.special import ndtr
    >>> d = np.arange(-5, 5.5, 0.5)
    >>> profile = 200 - 30 * ndtr((d - 0.3) / 1.1) - 40 * np.exp(-(((d - 0.3) / 1.1) ** 2) / 2)
    >>> wall = locate_wall(profile[np.newaxis], d, weights=np.ones((1, d.size)))
    >>> round(float(wall.position[0]), 3), round(wall.blur, 2)
    (0.3, 1.1)
    """
    used = weights.astype(float)
    if (used.sum(axis=1) < _FEWEST).all():
        raise ValueError("weights must leave at least 6 samples of a profile, got fewer in each")

    def fit(
        ratio: float | None, fit_ratio: bool = False, *, every: int = 1, blur: float | None = None
    ) -> tuple[WallPosition, float]:
        some = profiles[::every], offsets, used[::every]
        wall = _fit_walls(*some, pixel, ratio, fit_ratio, blur)
        found = wall.uncertainty[~np.isnan(wall.uncertainty)]
        return wall, float(np.median(found)) if found.size else np.inf

    free, of_free = fit(None)
    # Some profiles show whether there is a dark wall, for which a step alone is a bad fit.
    if fit(0.0, every=8, blur=free.blur)[1] > 1.5 * of_free:
        return free
    (step, of_step), (common, of_common) = fit(0.0), fit(0.0, True)
    # The positions of a free fit follow a wall that changes along the outline, so that a ratio must
    # make them clearly more certain; and so must a bump with respect to a step.
    if min(of_step, of_common) > 0.75 * of_free:
        return free
    return step if of_step < 1.05 * of_common else common


def _fit_walls(
    profiles: Array,
    offsets: Array,
    used: Array,
    pixel: float,
    ratio: float | None,
    ratio_is_fitted: bool,
    known_blur: float | None,
) -> WallPosition:
    """Fit a blurred wall to each profile, with a free bump or one that is a multiple of the step.

    The blur, if it is not known, and the ratio, if it is fitted, are common to all profiles.
    """

    def linearize(
        position: Array, numbers: NDArray[np.intp], shape: Sequence[float]
    ) -> NormalEquations:
        given = shape if ratio_is_fitted else (shape[0], ratio)
        return _eliminate_linear(profiles[numbers], offsets, used[numbers], position, *given)

    def fit(numbers: NDArray[np.intp], shape: Sequence[float]) -> tuple[Array, NormalEquations]:
        return gauss_newton(
            lambda position, some: linearize(position, numbers[some], shape),
            start[numbers],
            max_iterations=10,
            cost_tolerance=1e-5,
        )[:2]

    def scan(numbers: NDArray[np.intp], blur: float) -> tuple[Array, float]:
        places = np.repeat(grid, numbers.size)[:, np.newaxis]
        cost = linearize(places, np.tile(numbers, grid.size), (blur, 0.0)).cost
        cost = cost.reshape(grid.size, -1)
        return grid[cost.argmin(axis=0), np.newaxis], float(cost.min(axis=0).sum())

    # The fit converges from the best place of a scan that has about the right blur.
    every = np.arange(len(profiles))
    grid = np.linspace(-_SEARCH_RANGE, _SEARCH_RANGE, 11)
    blur = min((0.7, 1.1, 1.7, 2.6), key=lambda blur: scan(every[::16], blur)[1])
    start, _ = scan(every, blur)

    # Every fourth profile determines the shape well enough. An error of the blur by 1e-3 moves a
    # wall by less than 1e-4.
    def total(shape: Sequence[float]) -> float:
        return float(fit(every[::4], shape)[1].cost.sum())

    shape = [known_blur or blur]
    if ratio_is_fitted:
        corners = np.array([[blur, 0.0], [1.1 * blur, 0.0], [blur, 0.3]])
        options = {"xatol": 1e-3, "fatol": np.inf, "initial_simplex": corners}
        bounds = [(0.5, 3.0), (-1.0, 1.0)]
        how: Any = {"method": "Nelder-Mead", "bounds": bounds, "options": options}
        shape = minimize(total, corners[0], **how).x.tolist()
    elif known_blur is None:
        how = {"method": "bounded", "bounds": (0.5, 3.0), "options": {"xatol": 1e-3}}
        shape = [float(minimize_scalar(lambda blur: total([blur]), **how).x)]
    position, equations = fit(every, shape)
    position, blur = position[:, 0], shape[0]
    # Samples closer together than a pixel count as samples one pixel apart.
    independent = min(1.0, float(np.diff(offsets).mean()) / pixel) * used.sum(axis=1)
    unknowns = 4 if ratio is None else 3
    noise = equations.cost.sum() / max(float(np.maximum(independent - unknowns, 0).sum()), 1.0)
    with np.errstate(divide="ignore"):  # nothing determines the position in a flat profile
        uncertainty = np.sqrt(noise / equations.matrix[:, 0, 0])
    first = np.where(used, offsets, np.inf).min(axis=1)
    last = np.where(used, offsets, -np.inf).max(axis=1)
    cut_off = (first > position - blur) | (last < position + blur)
    missing = (used.sum(axis=1) < _FEWEST) | cut_off | (np.abs(position) > _SEARCH_RANGE)
    position[missing] = uncertainty[missing] = np.nan
    return WallPosition(position, uncertainty, blur)


def _eliminate_linear(
    profiles: Array,
    offsets: Array,
    used: Array,
    position: Array,
    blur: float,
    ratio: float | None,
) -> NormalEquations:
    """Linearize the fit at positions (n, 1), with the best level, step and bump for each.

    The bump is free, or it is this multiple of the step.
    """
    scaled = (offsets - position) / blur
    bell, rise = np.exp(-(scaled**2) / 2), ndtr(scaled)
    shapes = [rise, bell] if ratio is None else [rise + ratio * bell]
    basis = used[..., np.newaxis] * np.stack([np.ones_like(scaled), *shapes], axis=-1)
    transposed = basis.swapaxes(1, 2)
    # Slightly damped, because a profile may have too few samples for all of them.
    normal = transposed @ basis + np.sqrt(np.finfo(float).eps) * np.eye(basis.shape[-1])
    to_linear = np.linalg.inv(normal) @ transposed
    linear = to_linear @ profiles[..., np.newaxis]
    residual = used * profiles - (basis @ linear)[..., 0]
    step = linear[:, 1]
    bump = linear[:, 2] if ratio is None else ratio * step
    slope = used * bell * (scaled * bump - step / np.sqrt(2 * np.pi)) / blur
    # The part of the derivative that a change of the linear coefficients does not cancel.
    slope -= (basis @ (to_linear @ slope[..., np.newaxis]))[..., 0]
    matrix, right = (np.sum(slope * each, axis=1) for each in (slope, residual))
    cost = np.sum(residual**2, axis=1)
    return NormalEquations(matrix[:, np.newaxis, np.newaxis], right[:, np.newaxis], cost)
