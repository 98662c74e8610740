"""Chapter 2: what one image of a plane tells about a microscope, and loops that act too late."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from microlib.calibration import Calibration, calibrate, cramer_rao
from microlib.microscope import Microscope
from microlib.servoing import Camera, Stage, point_jacobian, simulate

#: What one image of a plane gives when f is known, by the library's names and as a table shows it.
PARAMETERS = {
    "magnification": "M",
    "distortion": "κ (10⁻¹⁰ µm⁻²)",
    "alpha": "α (°)",
    "beta": "β (°)",
    "gamma": "γ (°)",
    "tx": "T_x (µm)",
    "ty": "T_y (µm)",
}
#: Tilts of the pattern in degrees, for the valley of residuals and for the study of uncertainty.
VALLEY_TILTS = (0.0, 1.0, 2.0, 5.0, 20.0)
STUDY_TILTS = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0)
#: Assumed over true focal length, for the valley.
RATIOS = tuple(np.geomspace(0.5, 2.0, 13))
#: Repetitions on a parallel plane: each takes long, and all say the same.
PARALLEL_RUNS = 8
#: Delays (frames) and loop gains of the simulated loops.
DELAYS = (0.1, 0.5, 0.75, 1.0, 1.4, 1.9)
GAINS = (0.3, 0.7, 0.95, 1.1, 1.5, 1.9)


def grid_in_view(scope: Microscope, pitch: float = 280.0) -> NDArray:
    """Return the points of a square grid on the pattern that the image shows.

    Parameters
    ----------
    scope : Microscope
        Looks at the pattern.
    pitch : float
        Of the grid, µm; that of the circles of Table 5.1 by default.

    Returns
    -------
    ndarray, shape (N, 2)
        Points at least 5 px from the image's border, µm.

    Examples
    --------
    >>> scope = Microscope(159000, 100000, 62893, 0, 0, 0, 0, 0, 0)
    >>> len(grid_in_view(scope, pitch=1000.0))
    15
    """
    index = np.arange(-30, 31)
    grid = pitch * np.stack(np.meshgrid(index, index), axis=-1).reshape(-1, 2)
    seen = scope.project(grid)
    inside = ((seen > 5) & (seen < np.array(scope.image_size) - 6)).all(axis=1)
    return grid[inside]


def tilted(scope: Microscope, degrees: float) -> Microscope:
    """Return the microscope with a pattern that is tilted by so much, about both its axes."""
    return replace(scope, beta=np.deg2rad(0.8 * degrees), gamma=np.deg2rad(0.6 * degrees))


def calibration_steps(truth: Microscope, start: Sequence[float], fit: Calibration) -> pd.DataFrame:
    """Return the parameters of a calibration from its linear start to its minimum.

    Parameters
    ----------
    truth : Microscope
        Made the points.
    start : sequence of seven floats
        The linear estimates of `PARAMETERS`, in their order.
    fit : Calibration
        With the focal length given.

    Returns
    -------
    DataFrame
        ``truth``, ``start``, ``refined`` and ``σ`` by parameter, in the units of the index.
    """
    table = pd.DataFrame(
        {
            "parameter": list(PARAMETERS.values()),
            "truth": [getattr(truth, name) for name in PARAMETERS],
            "start": list(start),
            "refined": [getattr(fit.microscope, name) for name in PARAMETERS],
            "σ": [fit.sigma[name] for name in PARAMETERS],
        }
    ).set_index("parameter")
    angles = ["α (°)", "β (°)", "γ (°)"]
    table.loc[angles] = np.rad2deg(table.loc[angles])
    table.loc["κ (10⁻¹⁰ µm⁻²)"] *= 1e10
    values = ["truth", "start", "refined"]
    table.loc["γ (°)", values] = table.loc["γ (°)", values] % 360
    return table


def residuals_by_focal_length(
    scope: Microscope, noise: float, rng: np.random.Generator
) -> pd.DataFrame:
    """Fix the focal length at wrong values, fit everything else, and see how well it agrees.

    Parameters
    ----------
    scope : Microscope
        In focus; its pattern is tilted by each of `VALLEY_TILTS`.
    noise : float
        Standard deviation of a detected coordinate, px.
    rng : numpy.random.Generator
        Of the noise, one draw for each tilt.

    Returns
    -------
    DataFrame
        Root mean square residual of a coordinate in px, by assumed over true focal length (rows)
        and tilt in degrees (columns).
    """
    residuals = {}
    for degrees in VALLEY_TILTS:
        posed = tilted(scope, degrees)
        world = grid_in_view(posed)
        image = posed.project(world) + rng.normal(0, noise, world.shape)
        fits = [_calibrated(posed, world, image, ratio * posed.focal_length) for ratio in RATIOS]
        # A point's residual has two coordinates.
        residuals[degrees] = [fit.reprojection.rms / 2**0.5 for fit in fits]
    return pd.DataFrame(residuals, index=list(RATIOS))


def focal_length_study(
    scope: Microscope, noise: float, runs: int, rng: np.random.Generator
) -> pd.DataFrame:
    """Calibrate many noisy images without the focal length, for each tilt of the pattern.

    Parameters
    ----------
    scope : Microscope
        In focus; its pattern is tilted by each of `STUDY_TILTS`.
    noise : float
        Standard deviation of a detected coordinate, px.
    runs : int
        Images for each tilt; `PARALLEL_RUNS` of the parallel plane.
    rng : numpy.random.Generator
        Of the noise.

    Returns
    -------
    DataFrame
        For each ``tilt`` in degrees: the share of runs that call f unobservable (``lost``); the
        Cramér–Rao ``bound`` of f, its ``stated`` standard deviation (median) and its ``scatter``
        over the runs (NaN if f was lost in any); and that of the magnification (``M``). All
        standard deviations are relative.
    """
    free = ("magnification", "focus", *list(PARAMETERS)[1:])
    rows = []
    for degrees in STUDY_TILTS:
        posed = tilted(scope, degrees)
        world = grid_in_view(posed)
        exact = posed.project(world)
        fits = [
            _calibrated(posed, world, exact + rng.normal(0, noise, exact.shape))
            for _ in range(runs if degrees else PARALLEL_RUNS)
        ]
        focal = np.array([fit.microscope.focal_length for fit in fits]) / posed.focal_length
        scale = np.array([fit.microscope.magnification for fit in fits]) / posed.magnification
        lost = np.mean(["focal_length" in fit.unobservable for fit in fits])
        stated = np.median([fit.sigma["focal_length"] for fit in fits]) / posed.focal_length
        covariance = cramer_rao(posed, world, noise, free)
        bound = np.sqrt(np.diag(covariance))[free.index("focus")] / posed.focal_length
        scatter = focal.std() if lost == 0 else np.nan
        rows.append([degrees, lost, bound, stated, scatter, scale.std()])
    return pd.DataFrame(rows, columns=["tilt", "lost", "bound", "stated", "scatter", "M"])


def jacobian_comparison(scope: Microscope, point: ArrayLike) -> pd.DataFrame:
    """Compare (2.25) with small motions of a point under the full model, (2.5) to (2.11).

    Parameters
    ----------
    scope : Microscope
        The full model.
    point : array_like, shape (3,)
        In the objective's frame, on the pattern's plane, µm.

    Returns
    -------
    DataFrame
        For each of the six motions, both columns and the length of their difference: px/µm for the
        translations, px per radian for the rotations.
    """
    place = np.asarray(point, dtype=np.float64)
    weak = point_jacobian(
        scope.magnification * place[:2] / scope.cell,
        depth=place[2],
        magnification=scope.magnification,
        pixel_size=scope.cell,
    )
    rows = []
    for column, axis in enumerate(("V_x", "V_y", "V_z", "ω_x", "ω_y", "ω_z")):
        # A nanometer to either side, along the axis or, by a turn, at the depth of the point.
        screw = np.zeros(6)
        screw[column] = 1e-3 / (1 if column < 3 else place[2])
        ends = [Rotation.from_rotvec(s * screw[3:]).apply(place) + s * screw[:3] for s in (1, -1)]
        ahead, behind = (_seen(scope, end) for end in ends)
        exact = (ahead - behind) / (2 * screw[column])
        difference = np.linalg.norm(weak[:, column] - exact)
        rows.append((axis, *weak[:, column], *exact, difference))
    columns = ["motion", "x, (2.25)", "y, (2.25)", "x, full model", "y, full model", "difference"]
    return pd.DataFrame(rows, columns=columns)


def simulated_loops(interval: float, seed: int) -> pd.DataFrame:
    """Simulate delayed loops and see whether they forget an error of one pixel.

    Parameters
    ----------
    interval : float
        Between frames, s.
    seed : int
        Of the simulation.

    Returns
    -------
    DataFrame
        ``delay`` in frames, loop ``gain``, and whether the error ``decays``, for each pair of
        `DELAYS` and `GAINS`.
    """
    tries = [(delay, gain) for delay in DELAYS for gain in GAINS]
    decays = [_decays(gain, delay, interval, seed) for delay, gain in tries]
    return pd.DataFrame(tries, columns=["delay", "gain"]).assign(decays=decays)


def _decays(gain: float, delay: float, interval: float, seed: int) -> bool:
    def control(k: int, measured: NDArray, reference: NDArray) -> NDArray:
        return -gain / interval * measured

    result = simulate(
        control,
        np.zeros((300, 2)),
        jacobian=np.eye(2),
        stage=Stage(saturation=1e12, step=0.0, travel=1e12),
        camera=Camera(interval=interval, latency=delay * interval),
        rng=np.random.default_rng(seed),
        start=(1.0, 1.0),
    )
    return bool(np.abs(result.feature[200:]).max() < 1.0)


def _calibrated(
    scope: Microscope, world: NDArray, image: NDArray, focal_length: float | None = None
) -> Calibration:
    return calibrate(
        world,
        image,
        focal_length=focal_length,
        pixel_size=scope.pixel_size,
        image_size=scope.image_size,
    )


def _seen(scope: Microscope, point: NDArray) -> NDArray:
    """Return the pixel of a point of the objective's frame, from the principal point."""
    world = (point[None] - scope.translation) @ scope.rotation
    return (scope.project(world) - scope.principal_point)[0]
