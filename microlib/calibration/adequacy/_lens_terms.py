"""Terms beyond the thesis' model: lens terms, and the aspect ratios of pixels and of the print."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from microlib._common import inverse_normal
from microlib.calibration._fit import LENS, Fit, Photographs, least_squares_fit

#: Parameters of the lens that are added together if several views determine them.
_OPTIONAL = (("distortion_k2",), ("principal_x", "principal_y"), ("pixel_aspect",))
#: Least deviation of an aspect ratio from one. Three sets of photographs with square pixels and
#: prints give 0.0008 to 0.0016 by other errors of the model, and a set with an aspect ratio 0.0143.
_LEAST_ASPECT = 0.003


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
            lowers = best.rss - trial.rss > penalty * photographs.residual_variance(trial)
            aspect = float(trial.lens[LENS.index("pixel_aspect")])
            if lowers and (added != ("pixel_aspect",) or abs(aspect - 1) > _LEAST_ASPECT):
                best = trial
                untested = [terms for terms in _OPTIONAL if terms[0] not in best.lens_free]
    return best


def print_aspect(photographs: Photographs, fit: Fit) -> float:
    """Length of the print along y of the pattern over the stated one, relative to that along x.

    It is one if no other aspect ratio halves the sum of squares of several views.
    """

    def stretched(aspect: float) -> Photographs:
        return replace(photographs, world=[world * [1, aspect] for world in photographs.world])

    aspect, best, step = 1.0, fit, 1e-4
    for _ in range(3 if len(photographs.world) > 1 else 0):  # steps of Gauss and Newton
        longer, shorter = (
            stretched(aspect + change).predict(best.lens, best.poses)[0] for change in (step, -step)
        )
        design = np.column_stack([best.jacobian, (longer - shorter).ravel() / (2 * step)])
        aspect += float(inverse_normal(design)[-1] @ (design.T @ best.residuals))
        try:
            best = least_squares_fit(stretched(aspect), best.lens, best.poses, best.lens_free)
        except ValueError:  # undetermined, or no microscope fits
            return 1.0
    return aspect if 2 * best.rss < fit.rss and abs(aspect - 1) > _LEAST_ASPECT else 1.0
