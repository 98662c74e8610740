"""Beyond the thesis: which lengths of a microscope one image of a plane determines."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from compendium.experiments.chapter_2 import PARAMETERS, grid_in_view
from microlib.calibration import calibrate, cramer_rao
from microlib.microscope import Microscope

#: Tilts of the pattern, degrees.
TILTS = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0)
#: Repetitions on a parallel plane: each takes long, and all say the same.
PARALLEL_RUNS = 6


def tilted(scope: Microscope, degrees: float) -> Microscope:
    """Return the microscope with a pattern that is tilted by so much, about both its axes."""
    return replace(scope, beta=np.deg2rad(0.8 * degrees), gamma=np.deg2rad(0.6 * degrees))


def directions(scope: Microscope) -> tuple[pd.DataFrame, dict[str, float]]:
    """Return the singular values of the points' Jacobian, and the weakest change of the lengths.

    Its columns have unit length. Each singular value is one combined change of the parameters;
    the three that it moves most are named. The weakest change is scaled to 1 µm.
    """
    names = scope.PARAMETERS
    jacobian = scope.jacobian(grid_in_view(scope)).reshape(-1, len(names))
    norms = np.linalg.norm(jacobian, axis=0)
    values, rows = np.linalg.svd(jacobian / norms)[1:]
    largest = [", ".join(names[k] for k in np.argsort(-np.abs(row))[:3]) for row in rows]
    weakest = rows[-1] / norms
    weakest /= weakest[names.index("focal_length")]
    table = pd.DataFrame({"singular value": values, "parameters that it moves most": largest})
    return table, dict(zip(names, weakest.tolist(), strict=True))


def focal_length_study(
    scope: Microscope, noise: float, runs: int, rng: np.random.Generator
) -> pd.DataFrame:
    """Calibrate many noisy images without the focal length, for each of `TILTS`.

    Parameters
    ----------
    scope : Microscope
        In focus.
    noise : float
        Standard deviation of a detected coordinate, px.
    runs : int
        Images for each tilt; `PARALLEL_RUNS` of the parallel plane.
    rng : numpy.random.Generator
        Of the noise.

    Returns
    -------
    DataFrame
        For each ``tilt`` in degrees: the share of runs that name f as undetermined (``lost``); the
        Cramér–Rao ``bound`` of f, its ``stated`` standard deviation (median) and its ``scatter``
        over the runs (NaN if f was lost in any); and that of the magnification (``M``). All
        standard deviations are relative.
    """
    free = ("magnification", "focus", *list(PARAMETERS)[1:])
    known: dict[str, Any] = {"pixel_pitch": scope.pixel_pitch, "image_size": scope.image_size}
    rows = []
    for degrees in TILTS:
        posed = tilted(scope, degrees)
        world = grid_in_view(posed)
        images = posed.project(world) + rng.normal(
            0, noise, (runs if degrees else PARALLEL_RUNS, len(world), 2)
        )
        fits = [calibrate(world, image, **known) for image in images]
        focal = np.array([fit.microscope.focal_length for fit in fits]) / posed.focal_length
        scale = np.array([fit.microscope.magnification for fit in fits]) / posed.magnification
        lost = np.mean(["focal_length" in fit.undetermined for fit in fits])
        stated = np.median([fit.sigma["focal_length"] for fit in fits]) / posed.focal_length
        covariance = cramer_rao(posed, world, noise, free)
        bound = np.sqrt(np.diag(covariance))[free.index("focus")] / posed.focal_length
        scatter = focal.std() if lost == 0 else np.nan
        rows.append([degrees, lost, bound, stated, scatter, scale.std()])
    return pd.DataFrame(rows, columns=["tilt", "lost", "bound", "stated", "scatter", "M"])
