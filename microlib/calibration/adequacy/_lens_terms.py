"""Lens terms beyond the thesis' model: second distortion coefficient and principal point."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from microlib.calibration._views import LENS, Fit, Views, least_squares_fit

#: Indices in `LENS` of the parameters that are added together if several views determine them.
_OPTIONAL = ([3, 4], [2])


def add_lens_terms(views: Views, fit: Fit) -> Fit:
    """The fit of several views with the terms of the lens that lower the BIC.

    The sum of squares must fall by log(2 N) variances for each parameter of `_OPTIONAL`.
    """
    best = fit
    for added in _OPTIONAL if len(views.world) > 1 else ():
        lens_free = [k for k in best.free if k < len(LENS)]
        with suppress(ValueError):  # a fit that does not converge is no improvement
            trial = least_squares_fit(views, best.lens, best.poses, lens_free + added)
            penalty = len(added) * np.log(len(trial.residuals))
            if best.rss - trial.rss > penalty * views.residual_variance(trial):
                best = trial
    return best
