"""Whether all views have one lens: agreement of the views, and their errors in cross-validation."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.calibration._fit import Fit, Photographs, least_squares_fit


def agreeing_views(photographs: Photographs, alone: list[list[Fit]]) -> NDArray[np.bool_]:
    """Which views one lens fits, in the largest set of views with a common lens.

    A lens fits a view if the rms error is at most ten times that of most views fitted alone. The
    lenses tried are the median of those of the single views, and those of at most ten views. Each
    is fitted anew to the views that it fits, and the first that fits most views is taken.
    """
    if len(alone) == 1:
        return np.ones(1, dtype=bool)
    lenses = [pair[0].lens for pair in alone]
    poses = np.concatenate([pair[0].poses for pair in alone])
    squares = [pair[0].rss / len(pair[0].residuals) for pair in alone]
    noise = np.sort(squares)[(len(squares) - 1) // 2] + photographs.rounding_variance(poses)

    def fitted_by(lens: Array) -> NDArray[np.bool_]:
        errors = [_rms(photographs, view, lens, poses[[view]]) for view in range(len(poses))]
        return np.array(errors) ** 2 <= 2 * 10**2 * noise

    largest = np.zeros(len(poses), dtype=bool)
    every = -(-len(lenses) // 10)
    for lens in (np.median(lenses, axis=0), *lenses[::every]):
        agree = fitted_by(lens)
        with suppress(ValueError):  # no lens fits them
            some, free = np.flatnonzero(agree), alone[0][0].lens_free
            joint = least_squares_fit(photographs.subset(some), lens, poses[some], free)
            agree = fitted_by(joint.lens)
        if agree.sum() > largest.sum():
            largest = agree
        if 2 * largest.sum() > len(largest):
            break
    return largest


def held_out_errors(
    photographs: Photographs, fit: Fit, alone: list[list[Fit]], agree: NDArray[np.bool_]
) -> Array:
    """Reprojection error of each view, rms in px, with the lens fitted to other views.

    In each of five folds a fifth of the views is left out, and the pose of each of them is fitted.
    Only views that `agree` enter the fit of the lens. The error is NaN where a fit fails, and for
    fewer than three views.
    """
    every = np.arange(len(photographs.world))
    lenses = np.array([pair[0].lens for pair in alone])
    poses = np.concatenate([pair[0].poses for pair in alone])
    errors = np.full(len(every), np.nan)
    if len(every) < 3 or agree.sum() < 2:
        return errors
    for fold in range(min(len(every), 5)):
        rest = every[(every % 5 != fold) & agree]
        with suppress(ValueError):
            start = np.median(lenses[rest], axis=0)
            others = photographs.subset(rest)
            lens = least_squares_fit(others, start, poses[rest], fit.lens_free).lens
            for v in every[every % 5 == fold]:
                errors[v] = _rms(photographs, v, lens, poses[[v]])
    return errors


def _rms(photographs: Photographs, view: int, lens: Array, pose: Array) -> float:
    """Reprojection error of a view, rms in px, with its pose fitted; infinite if the fit fails."""
    try:
        one = least_squares_fit(photographs.subset([view]), lens, pose, [])
    except ValueError:
        return np.inf
    return float(np.sqrt(one.rss / len(photographs.world[view])))
