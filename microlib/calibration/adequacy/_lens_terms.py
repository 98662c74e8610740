"""Lens terms beyond the thesis' model: second distortion coefficient and principal point."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from microlib.calibration._fit import Fit, Photographs, least_squares_fit

#: Parameters of the lens that are added together if several views determine them.
_OPTIONAL = (("distortion_k2",), ("principal_x", "principal_y"))


def add_lens_terms(photographs: Photographs, fit: Fit) -> Fit:
    """The fit of several views with the terms of the lens that lower the BIC.

    The sum of squares must fall by log(2 N) variances for each parameter of `_OPTIONAL`. A term
    that was added may reveal another one, which is then tested again.
    """
    best, untested = fit, list(_OPTIONAL) if len(photographs.world) > 1 else []
    while untested:
        added = untested.pop(0)
        with suppress(ValueError):  # a fit that does not converge is no improvement
            trial = least_squares_fit(photographs, best.lens, best.poses, [*best.lens_free, *added])
            penalty = len(added) * np.log(len(trial.residuals))
            if best.rss - trial.rss > penalty * photographs.residual_variance(trial):
                best = trial
                untested = [terms for terms in _OPTIONAL if terms[0] not in best.lens_free]
    return best
