"""Beyond the thesis: which lengths of a microscope one image of a plane determines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from compendium.experiments.chapter_2 import grid_in_view
from microlib.calibration import calibrate
from microlib.microscope import Microscope

#: Tilts of the pattern, degrees.
TILTS = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0)
#: Repetitions on a parallel plane: each takes long, and all say the same.
PARALLEL_RUNS = 6
#: Parameters of the microscope, the three lengths first.
LENGTHS = ("tube_length", "focal_length", "distance")
OTHERS = ("distortion", "alpha", "beta", "gamma", "tx", "ty")
ALL = (*LENGTHS, *OTHERS)


def changed(scope: Microscope, name: str, change: float) -> Microscope:
    """Return the microscope with a change of one parameter.

    The magnification changes by the tube length alone. The parameter "focus" is f with the plane
    kept in focus at the same magnification, T_op = M f and d = f/M.
    """
    m, f = scope.magnification, scope.focal_length
    if name == "magnification":
        return replace(scope, tube_length=(m + change) * (f + scope.distance) - f)
    if name == "focus":
        f += change
        return replace(scope, focal_length=f, tube_length=m * f, distance=f / m)
    return replace(scope, **{name: getattr(scope, name) + change})


def projection_jacobian(scope: Microscope, world: NDArray, names: Sequence[str]) -> NDArray:
    """Return the derivatives of the image points by the parameters, (2N, p), in px per unit.

    They are central differences of the fourth order, with steps that move no point by more than a
    few pixels.
    """
    steps = {
        **dict.fromkeys((*LENGTHS, "focus"), 100.0),
        "distortion": 1e-11,
        "magnification": 1e-3,
    }
    columns = []
    for name in names:
        h = steps.get(name, 1.0 if name in ("tx", "ty") else 1e-3)  # µm, rad
        near, far = (
            changed(scope, name, s).project(world) - changed(scope, name, -s).project(world)
            for s in (h, 2 * h)
        )
        columns.append((8 * near - far).ravel() / (12 * h))
    return np.column_stack(columns)


def cramer_rao_bound(
    scope: Microscope, world: NDArray, noise: float, names: Sequence[str]
) -> NDArray:
    """Return the smallest standard deviation of each parameter if all are estimated together.

    It is the root of the diagonal of σ² (JᵀJ)⁻¹ for the noise σ of a coordinate in px, and infinite
    for a parameter that the points do not determine.
    """
    jacobian = projection_jacobian(scope, world, names)
    norms = np.linalg.norm(jacobian, axis=0)
    _, singular, rows = np.linalg.svd(jacobian / norms, full_matrices=False)
    lost = singular < 1e-9 * singular[0]  # rounding leaves 1e-12
    bound = noise * np.linalg.norm(rows[~lost] / singular[~lost, None], axis=0) / norms
    return np.where((abs(rows[lost]) > 1e-6).any(axis=0), np.inf, bound)


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
    free = ("magnification", "focus", *OTHERS)
    known: dict[str, Any] = {"pixel_pitch": scope.pixel_pitch, "image_size": scope.image_size}
    rows = []
    for degrees in TILTS:
        # About both axes of the pattern.
        tilt = {"beta": np.deg2rad(0.8 * degrees), "gamma": np.deg2rad(0.6 * degrees)}
        posed = replace(scope, **tilt)
        world = grid_in_view(posed)
        images = posed.project(world) + rng.normal(
            0, noise, (runs if degrees else PARALLEL_RUNS, len(world), 2)
        )
        fits = [calibrate(world, image, **known) for image in images]
        focal = np.array([fit.microscope.focal_length for fit in fits]) / posed.focal_length
        scale = np.array([fit.microscope.magnification for fit in fits]) / posed.magnification
        lost = np.mean(["focal_length" in fit.undetermined for fit in fits])
        stated = np.median([fit.parameters["focal_length"].uncertainty for fit in fits])
        stated /= posed.focal_length
        bound = cramer_rao_bound(posed, world, noise, free)[free.index("focus")]
        bound /= posed.focal_length
        scatter = focal.std() if lost == 0 else np.nan
        rows.append([degrees, lost, bound, stated, scatter, scale.std()])
    return pd.DataFrame(rows, columns=["tilt", "lost", "bound", "stated", "scatter", "M"])
