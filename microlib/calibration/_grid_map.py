"""The map from a pattern's grid to its image: a homography and a radial distortion, fitted to
detected points.

It needs no calibration and serves to find out how far a detected feature (center of an ellipse,
crossing of straight lines) lies from the image of the point that it stands for.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

from microlib._common import Array
from microlib.microscope import distort

#: Step of the central differences, in cells: their error is its square, 1e-6 of what the scale
#: changes by from cell to cell, and rounding makes 1e-12 of it.
_STEP = 1e-3
#: The nine numbers of a homography with distortion have freedom left from six points on.
_FEWEST_FOR_DISTORTION = 6


@dataclass(frozen=True)
class GridMap:
    """Smooth map from grid coordinates to the image.

    Parameters
    ----------
    homography : ndarray, shape (3, 3)
        From the grid to undistorted image points, in units of `unit` from `middle`.
    distortion : float
        κ of (2.10) in the same units.
    middle : ndarray, shape (2,)
        Center of the image, px.
    unit : float
        Half of the image's longer side, px.
    """

    homography: Array
    distortion: float
    middle: Array
    unit: float

    def __call__(self, grid: Array) -> Array:
        """Image points (..., 2) of grid coordinates (..., 2), px."""
        flat = grid @ self.homography[:, :2].T + self.homography[:, 2]
        seen = distort(flat[..., :2] / flat[..., 2:], self.distortion)
        return self.middle + self.unit * seen

    def scale(self, grid: Array) -> Array:
        """Area in the image of one cell of the grid around each of the coordinates, px²."""
        steps = [(self(grid + s) - self(grid - s)) / (2 * _STEP) for s in _STEP * np.eye(2)]
        return np.abs(np.linalg.det(np.stack(steps, axis=-1)))


def fit_grid_map(points: Array, grid: Array, image_shape: tuple[int, ...]) -> GridMap:
    """Least-squares map through at least four points; the distortion is zero below six.

    Parameters
    ----------
    points, grid : ndarray, shape (N, 2)
        Image points, px, and their grid coordinates.
    image_shape : tuple of int
        Height and width of the image, px.

    Returns
    -------
    GridMap
    """
    middle = (np.array(image_shape[1::-1], dtype=np.float64) - 1) / 2
    unit = float(middle.max())
    start = cv2.findHomography(grid, (points - middle) / unit)[0].ravel()[:8]

    def build(p: Array) -> GridMap:
        distortion = float(p[8]) if len(p) > 8 else 0.0
        return GridMap(np.append(p[:8], 1.0).reshape(3, 3), distortion, middle, unit)

    start = np.append(start, 0.0) if len(points) >= _FEWEST_FOR_DISTORTION else start
    best = least_squares(lambda p: (build(p)(grid) - points).ravel(), start, x_scale="jac")
    return build(best.x)
