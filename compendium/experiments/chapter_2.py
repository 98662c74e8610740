"""Chapter 2: forces on small parts, one calibration step by step, and loops that act too late."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from compendium import thesis
from microlib.calibration import calibrate, linear_intrinsics, radial_alignment
from microlib.microscope import Microscope
from microlib.servoing import CameraTiming, StageModel, ibvs_control, point_jacobian, simulate

#: What one image of a plane gives when f is known: name and factor for the table, by parameter.
PARAMETERS = {
    "magnification": ("M", 1.0),
    "distortion": ("κ (10⁻¹⁰ µm⁻²)", 1e10),
    "alpha": ("α (°)", 180 / np.pi),
    "beta": ("β (°)", 180 / np.pi),
    "gamma": ("γ (°)", 180 / np.pi),
    "tx": ("T_x (µm)", 1.0),
    "ty": ("T_y (µm)", 1.0),
}
#: Delays (frames) and loop gains of the simulated loops.
DELAYS = (0.1, 0.5, 0.75, 1.0, 1.4, 1.9)
GAINS = (0.3, 0.7, 0.95, 1.1, 1.5, 1.9)


def forces_on_sphere(diameter: ArrayLike) -> pd.DataFrame:
    """Return weight and adhesion (N) of a silicon sphere on a flat surface, by diameter (mm)."""
    radius = np.asarray(diameter) / 2e3  # m
    table = {
        "weight": 4 / 3 * np.pi * radius**3 * 2330 * 9.81,
        "surface tension": 4 * np.pi * radius * 0.073,  # water that wets
        "van der Waals, gap 0.4 nm": 1e-19 * radius / (6 * 0.4e-9**2),
        "van der Waals, gap 10 nm": 1e-19 * radius / (6 * 10e-9**2),
        "electrostatic, at most": np.pi * 8.854e-12 * 3e6**2 * radius**2,  # air breaks down
    }
    return pd.DataFrame(table, index=pd.Index(np.asarray(diameter), name="diameter (mm)"))


def balance(adhesion: str) -> float:
    """Return the diameter (mm) at which a force that grows as the radius equals the weight."""
    at_one = forces_on_sphere([1.0]).iloc[0]
    return float(np.sqrt(at_one[adhesion] / at_one["weight"]))


def turned_camera(degrees: Sequence[float], rate: float, times: NDArray) -> dict[float, NDArray]:
    """Return the paths (px) of the error under (2.3) if the calibration misses a turn of the
    camera."""
    jacobian = np.eye(2) / thesis.effective_pixel("1X")  # px/µm
    paths = {}
    for angle in degrees:
        believed = jacobian @ Rotation.from_euler("z", angle, degrees=True).as_matrix()[:2, :2]
        columns = [ibvs_control(believed, error, gain=rate) for error in np.eye(2)]
        closed = jacobian @ np.column_stack(columns)  # (2.4) for a target at rest
        paths[angle] = np.array([expm(closed * t) @ (50.0, 0.0) for t in times])
    return paths


def grid_in_view(scope: Microscope, pitch: float = 280.0) -> NDArray:
    """Return the points (µm) of a square grid on the pattern that the image shows, 5 px inside."""
    index = np.arange(-30, 31)
    grid = pitch * np.stack(np.meshgrid(index, index), axis=-1).reshape(-1, 2)
    seen = scope.project(grid)
    return grid[((seen > 5) & (seen < np.array(scope.image_size) - 6)).all(axis=1)]


def calibration_steps(scope: Microscope, noise: float, rng: np.random.Generator) -> pd.DataFrame:
    """Calibrate points with noise (px), f known: true, linear and refined parameters, and σ."""
    world = grid_in_view(scope)
    image = scope.project(world) + rng.normal(0, noise, world.shape)
    sensor = (image - scope.principal_point) * scope.pitch
    alpha, beta, gamma, tx, ty = radial_alignment(world, sensor)
    side = np.sign(beta * scope.beta)  # (β, γ) and (−β, −γ) look alike
    pose = {"alpha": alpha, "beta": side * beta, "gamma": side * gamma, "tx": tx, "ty": ty}
    settings: dict[str, Any] = {"pixel_pitch": scope.pixel_pitch, "image_size": scope.image_size}
    fit = calibrate(world, image, focal_length=scope.focal_length, **settings)
    lengths = (scope.tube_length, scope.focal_length, scope.distance)
    flat = Microscope(*lengths, **(settings | pose)).to_objective(world)[:, :2]
    start = linear_intrinsics(flat, np.zeros(len(flat)), sensor)[:2]
    linear = pose | {"magnification": start[0], "distortion": start[1]}
    rows = {
        text: factor
        * np.array(
            [
                getattr(scope, name),
                linear[name],
                getattr(fit.microscope, name),
                fit.parameters[name].uncertainty,
            ]
        )
        for name, (text, factor) in PARAMETERS.items()
    }
    table = pd.DataFrame(rows, index=["truth", "start", "refined", "σ"]).T
    table.loc["γ (°)", ["truth", "start", "refined"]] %= 360
    return table


def slowest_decay(seed: int) -> float:
    """Return the largest real part of the poles of (2.4) for λ = 1 and random JĴ⁺ > 0.

    A matrix is positive if its symmetric part has positive eigenvalues.
    """
    products = np.random.default_rng(seed).normal(size=(1000, 2, 2))
    symmetric = products + products.transpose(0, 2, 1)
    positive = products[np.linalg.eigvalsh(symmetric).min(axis=1) > 0]
    return float(np.linalg.eigvals(-positive).real.max())


def largest_tilt() -> float:
    """Return the largest angle between a pattern of Table 5.1 and the image plane, degrees."""
    angles = [[thesis.table_5_1(c, name) for name in ("beta", "gamma")] for c in thesis.COLUMNS]
    return float(np.degrees(np.arccos(np.abs(np.cos(np.radians(angles))).prod(axis=1))).max())


def jacobian_comparison(scope: Microscope, point: ArrayLike) -> pd.DataFrame:
    """Compare (2.25) with small motions of a point (objective frame, µm) under the full model.

    Columns of px/µm for translations and px/rad for rotations, and the length of the difference.
    """
    place = np.asarray(point, dtype=np.float64)
    weak = point_jacobian(
        scope.magnification * place[:2] / scope.pitch,
        depth=place[2],
        magnification=scope.magnification,
        pixel_pitch=scope.pitch,
    )
    rows = []
    for column, axis in enumerate(("V_x", "V_y", "V_z", "ω_x", "ω_y", "ω_z")):
        # A nanometer to either side, along the axis or, by a turn, at the depth of the point.
        screw = np.zeros(6)
        screw[column] = 1e-3 / (1 if column < 3 else place[2])
        ends = [Rotation.from_rotvec(s * screw[3:]).apply(place) + s * screw[:3] for s in (1, -1)]
        world = (np.array(ends) - scope.translation) @ scope.rotation
        exact = np.subtract(*scope.project(world)) / (2 * screw[column])
        difference = np.linalg.norm(weak[:, column] - exact)
        rows.append((axis, *weak[:, column], *exact, difference))
    columns = ["motion", "x, (2.25)", "y, (2.25)", "x, full model", "y, full model", "difference"]
    return pd.DataFrame(rows, columns=columns)


def simulated_loops(interval: float, seed: int) -> pd.DataFrame:
    """Simulate loops of each of `DELAYS` and `GAINS`; does an error of one pixel decay?"""

    def decays(gain: float, delay: float) -> bool:
        result = simulate(
            lambda k, measured, reference: -gain / interval * measured,
            np.zeros((300, 2)),
            jacobian=np.eye(2),
            stage=StageModel(saturation=1e12, increment=0.0, travel=1e12),
            camera=CameraTiming(interval=interval, latency=delay * interval),
            rng=np.random.default_rng(seed),
            start=(1.0, 1.0),
        )
        return bool(np.abs(result.feature[200:]).max() < 1.0)

    rows = [(delay, gain, decays(gain, delay)) for delay in DELAYS for gain in GAINS]
    return pd.DataFrame(rows, columns=["delay", "gain", "decays"])
