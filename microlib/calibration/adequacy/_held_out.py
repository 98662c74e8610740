"""Reprojection error of views that are left out of the fit of the lens (cross-validation)."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from microlib._common import Array
from microlib.calibration._fit import Fit, Photographs, least_squares_fit


def held_out_errors(photographs: Photographs, fit: Fit, alone: list[list[Fit]]) -> Array:
    """Reprojection error of each view, rms in px, with the lens fitted to other views.

    In each of five folds a fifth of the views is left out, and the pose of each of them is fitted.
    A view that the median lens of all views fits ten times worse than most views is left out of
    every fit of the lens. The error is NaN where a fit fails, and for fewer than three views.
    """
    every = np.arange(len(photographs.world))
    lenses = np.array([pair[0].lens for pair in alone])
    poses = np.concatenate([pair[0].poses for pair in alone])

    def squared_error(view: np.intp, lens: Array) -> float:
        one = least_squares_fit(photographs.subset([view]), lens, poses[[view]], [])
        return one.rss / len(photographs.world[view])

    squares = np.full(len(every), np.inf)
    for v in every:
        with suppress(ValueError):
            squares[v] = squared_error(v, np.median(lenses, axis=0))
    rounding = photographs.rounding_variance(fit.poses)
    consistent = squares <= 10**2 * max(np.median(squares), rounding)
    errors = np.full(len(every), np.nan)
    if len(every) < 3 or consistent.sum() < 2:
        return errors
    for fold in range(min(len(every), 5)):
        rest = every[(every % 5 != fold) & consistent]
        with suppress(ValueError):
            start = np.median(lenses[rest], axis=0)
            others = photographs.subset(rest)
            lens = least_squares_fit(others, start, poses[rest], fit.lens_free).lens
            for v in every[every % 5 == fold]:
                errors[v] = np.sqrt(squared_error(v, lens))
    return errors
