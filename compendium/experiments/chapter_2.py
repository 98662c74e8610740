"""Chapter 2: a camera that is turned, and the grid of points that a microscope sees."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from compendium import thesis
from microlib.microscope import Microscope
from microlib.servoing import ibvs_control


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
