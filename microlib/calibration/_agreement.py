"""The final test of a detection: do the marks lie where a lens would put a lattice?

A lens images a plane lattice by a homography and a smooth distortion. What marks lie beside that is
their error, whatever their own fits say of it; and where it is no small part of a pitch, the marks
are no lattice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.calibration._grid_map import GridMap

#: Most residual of a lattice, in pitches. Printed boards, photographed, lie within 0.01; false
#: lattices, which are grown within a quarter of a step, mostly beyond 0.03.
_MOST_RESIDUAL = 0.012
#: A residual that the marks' own noise explains is no reason to refuse, whatever the pitch.
_EXPLAINED = 3.0
#: A mark so many standard deviations beside the others' map is none of theirs: by chance one of
#: 10⁸.
_STRAY = 6.0
#: A mark of which less than this part of its freedom is left beside the smooth fields is told by
#: itself alone: what the fields lack of the lens would count 30 times there.
_LEAST_FREE = 1e-3
#: Least part of the marks that must agree.
_LEAST_AGREEING = 0.75
#: Degrees of freedom that the fits' own σ counts for when it is held against the residuals; of
#: fewer residuals than that little can be known.
_OWN_FREEDOM = 8.0
#: Median of the absolute values to standard deviation, for normal errors.
_TO_SIGMA = 1.4826
#: Coefficients of a polynomial of degree 4, 3, 2 in two coordinates; it is used with three times
#: as many marks. The map has absorbed a constant and a slope already.
_COEFFICIENTS = {4: 15, 3: 10, 2: 6}
_MARKS_PER_COEFFICIENT = 3
#: Powers of the squared radius that a lens' distortion has beside the map's own; each is used with
#: so many marks a power.
_RADIAL_POWERS, _MARKS_PER_POWER = (2, 3), 6


@dataclass(frozen=True)
class Agreement:
    """What the residuals of a detection say.

    Parameters
    ----------
    kept : ndarray of bool, shape (N,)
        False for the points of marks that are none of the lattice's.
    sigma : ndarray, shape (N,)
        Standard deviation of a coordinate, px: of the fits, or of the residuals where larger.
    misfit : float
        Residuals over what the fits alone state, root of the ratio of variances; NaN where too few
        marks leave no residuals.
    """

    kept: NDArray[np.bool_]
    sigma: Array
    misfit: float


def agree_with_map(
    points: Array,
    positions: Array,
    to_image: GridMap,
    sigma: Array,
    groups: NDArray,
    *,
    middles: Array,
) -> Agreement:
    """Hold points of a pattern against the map of its grid; the pitch is that at `middles`."""
    return agree(
        points - to_image(positions),
        positions,
        (points - to_image.middle) / to_image.unit,
        sigma,
        groups,
        pitch=float(np.sqrt(np.median(to_image.scale(middles)))),
        spent=to_image.freedom,
    )


def agree(
    residuals: Array,
    places: Array,
    radial: Array,
    sigma: Array,
    groups: NDArray,
    *,
    pitch: float,
    spent: int,
) -> Agreement:
    """Hold the residuals of a grid map against the σ of the points.

    Parameters
    ----------
    residuals : ndarray, shape (N, 2)
        Points minus the map that was fitted to them, px.
    places : ndarray, shape (N, 2)
        Coordinates in the lattice, in which what is left of a distortion is smooth.
    radial : ndarray, shape (N, 2)
        Image points from the image's middle, in halves of its longer side: in them a lens'
        distortion is radial.
    sigma : ndarray, shape (N,)
        Standard deviation of a coordinate as the outlines' own fits tell it, px.
    groups : ndarray of int, shape (N,)
        Mark that each point belongs to.
    pitch : float
        Step of the lattice in the image, px.
    spent : int
        Parameters of the map.

    Returns
    -------
    Agreement

    Raises
    ------
    ValueError
        If the points lie off every smooth image of a lattice.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> places = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0)), -1).reshape(-1, 2)
    >>> found = agree(rng.normal(0, 0.1, (64, 2)), places, places / 4 - 1, np.full(64, 0.05),
    ...               np.arange(64), pitch=30, spent=9)
    >>> bool(abs(found.misfit - 2) < 0.2)
    True
    """
    kept = np.ones(len(sigma), dtype=bool)
    fields, numbers = _smooth_fields(places, radial, groups, spent)
    for _ in range(2):  # strays bend the polynomial that they are found by
        left, freedom = _smooth_away(residuals, fields, kept), 2 * int(kept.sum()) - numbers
        if freedom <= 0:
            return Agreement(kept, sigma, np.nan)
        spread = _TO_SIGMA * np.median(np.abs(left[kept])) * np.sqrt(2 * kept.sum() / freedom)
        stray = np.abs(left).max(axis=1) > _STRAY * np.maximum(spread, sigma)
        kept = ~np.isin(groups, groups[stray])
        if not kept.any():
            break
    kept = _without_strays(residuals, fields, sigma, groups, kept, numbers)
    left, freedom = _smooth_away(residuals, fields, kept), 2 * int(kept.sum()) - numbers
    share = kept.mean()
    rms = float(np.sqrt((left[kept] ** 2).sum() / freedom)) if freedom > 0 else np.inf
    own = float(np.sqrt((sigma[kept] ** 2).mean())) if kept.any() else 0.0
    if rms > max(_MOST_RESIDUAL * pitch, _EXPLAINED * own) or share < _LEAST_AGREEING:
        raise ValueError(
            f"image must show a regular lattice, got marks {rms:.2g} px "
            f"({100 * rms / pitch:.2g} % of a pitch) beside one, and {100 * share:.0f} % of them"
        )
    added = max(rms**2 - own**2, 0.0) * freedom / (freedom + _OWN_FREEDOM)
    return Agreement(kept, np.sqrt(sigma**2 + added), rms / own)


def _without_strays(
    residuals: Array,
    fields: Array,
    sigma: Array,
    groups: NDArray,
    kept: NDArray[np.bool_],
    numbers: int,
) -> NDArray[np.bool_]:
    """Drop, one at a time, marks that the map of the others does not lead to.

    A mark at the edge of the lattice pulls the smooth fields towards itself, and its residual says
    little. So each is judged by what the sum of squares falls by when it is left out: eᵀ(I − H)⁻¹e
    over its own residuals e and their part H of the projection onto the fields, as the externally
    studentized residual has it.
    """
    kept = kept.copy()
    while kept.mean() >= _LEAST_AGREEING:
        freedom = 2 * int(kept.sum()) - numbers
        own = groups[kept]
        left = _smooth_away(residuals, fields, kept)[kept]
        basis = np.linalg.qr(fields[:, kept].reshape(len(fields), 2 * len(own)).T)[0]
        basis = basis.reshape(len(own), 2, len(fields))
        squares, worst, excess = (left**2).sum(), None, _STRAY**2
        for mark in np.unique(own):
            of_mark = own == mark
            count = 2 * int(of_mark.sum())
            if freedom <= count:
                return kept
            e, q = left[of_mark].ravel(), basis[of_mark].reshape(count, -1)
            outside = np.eye(count) - q @ q.T
            if np.linalg.eigvalsh(outside)[0] < _LEAST_FREE:
                continue  # nothing but the mark itself tells where it belongs
            fall = float(e @ np.linalg.solve(outside, e))
            spread = max((squares - fall) / (freedom - count), (sigma[kept][of_mark] ** 2).mean())
            if fall > excess * count * spread:
                worst, excess = mark, fall / (count * spread)
        if worst is None:
            return kept
        kept &= groups != worst
    return kept


def _smooth_fields(places: Array, radial: Array, groups: NDArray, spent: int) -> tuple[Array, int]:
    """Smooth displacements that so many marks can tell, (fields, N, 2), and the numbers that they
    and the map have together."""
    marks = len(np.unique(groups))
    squared = (radial**2).sum(axis=1, keepdims=True)
    powers = [p for p in _RADIAL_POWERS if marks >= _MARKS_PER_POWER * p]
    fields = [radial * squared**p for p in powers]
    degree = max(
        (d for d, count in _COEFFICIENTS.items() if marks >= _MARKS_PER_COEFFICIENT * count),
        default=0,
    )
    x, y = ((places - places.mean(axis=0)) / np.ptp(places)).T
    for i in range(max(degree, 1) + 1):
        for j in range(max(degree, 1) + 1 - i):
            term = (x**i * y**j)[:, None]
            fields += [term * [1.0, 0.0], term * [0.0, 1.0]]
    if degree == 0:  # what the map itself has: a change of perspective moves points in proportion
        fields += [radial * x[:, None], radial * y[:, None]]
        return np.array(fields), spent + len(powers)
    # Of the map's numbers the six of an affine map are the polynomial's too.
    return np.array(fields), len(fields) + max(spent - 6, 0)


def _smooth_away(residuals: Array, fields: Array, kept: NDArray[np.bool_]) -> Array:
    """Residuals less the smooth displacements that fit the kept ones best."""
    if len(fields) == 0:
        return residuals
    design = fields[:, kept].reshape(len(fields), -1).T
    best = np.linalg.lstsq(design, residuals[kept].ravel(), rcond=None)[0]
    return residuals - np.tensordot(best, fields, axes=1)
