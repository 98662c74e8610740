"""Chapter 2: a camera that is turned, and one calibration step by step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from compendium import thesis
from microlib.calibration import calibrate, linear_intrinsics, radial_alignment
from microlib.microscope import Microscope
from microlib.servoing import ibvs_control

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
