"""The map from a pattern's grid to its image: a homography and a radial distortion, fitted to
detected points.

It needs no calibration and serves to find out how far a detected feature (center of an ellipse,
crossing of straight lines) lies from the image of the point that it stands for.
"""

from __future__ import annotations

from collections.abc import Callable
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
    freedom : int
        Numbers that were fitted.
    """

    homography: Array
    distortion: float
    middle: Array
    unit: float
    freedom: int

    def __call__(self, grid: Array) -> Array:
        """Image points (..., 2) of grid coordinates (..., 2), px."""
        flat = grid @ self.homography[:, :2].T + self.homography[:, 2]
        seen = distort(flat[..., :2] / flat[..., 2:], self.distortion)
        return self.middle + self.unit * seen

    def steps(self, grid: Array) -> Array:
        """Derivatives of the image points by the coordinates, (..., 2, 2): one column each, px."""
        columns = [(self(grid + s) - self(grid - s)) / (2 * _STEP) for s in _STEP * np.eye(2)]
        return np.stack(columns, axis=-1)

    def scale(self, grid: Array) -> Array:
        """Area in the image of one cell of the grid around each of the coordinates, px²."""
        return np.abs(np.linalg.det(self.steps(grid)))


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

    Raises
    ------
    ValueError
        If no map of finite numbers leads from the coordinates to the points.
    """
    return _fit(points, lambda _: grid, np.empty(0), image_shape)[0]


def fit_square_map(
    corners: Array, cells: Array, halves: Array, image_shape: tuple[int, ...]
) -> tuple[GridMap, Array]:
    """Least-squares map through the corners of squares, whose width and height are fitted too.

    Parameters
    ----------
    corners : ndarray, shape (N, 2)
        Image points, px.
    cells : ndarray, shape (N, 2)
        Grid coordinates of the middle of the square that each corner belongs to, in pitches.
    halves : ndarray, shape (N, 2)
        Where the corner lies from there: ±½ of a side along each axis.
    image_shape : tuple of int
        Height and width of the image, px.

    Returns
    -------
    to_image : GridMap
        From coordinates in pitches to the image.
    sides : ndarray, shape (2,)
        Width and height of the squares, pitches.

    Raises
    ------
    ValueError
        If no map of finite numbers leads from the coordinates to the points.
    """
    to_image = homography_map(*_middles(corners, cells), image_shape)
    quads = corners.reshape(-1, 4, 2)
    diagonals = quads[:, 2:] - quads[:, :2]
    area = np.abs(np.linalg.det(diagonals)) / 2
    cell = np.median(to_image.scale(cells[::4]))
    if not cell > 0:
        raise ValueError("image must show squares on a plane grid, got them in one row")
    side = np.sqrt(np.median(area) / cell)
    to_image, sides = _fit(
        corners, lambda sides: cells + halves * sides, np.full(2, side), image_shape
    )
    return to_image, sides


def _middles(corners: Array, cells: Array) -> tuple[Array, Array]:
    """Mean corner of each square, and its coordinates."""
    return corners.reshape(-1, 4, 2).mean(axis=1), cells[::4]


def homography_map(points: Array, grid: Array, image_shape: tuple[int, ...]) -> GridMap:
    """Map without distortion through at least four points, linear least squares; quick.

    Parameters and errors are those of :func:`fit_grid_map`.
    """
    middle = (np.array(image_shape[1::-1], dtype=np.float64) - 1) / 2
    unit = float(middle.max())
    homography, _ = cv2.findHomography(grid, (points - middle) / unit)
    if homography is None or not np.isfinite(homography).all():
        raise ValueError(f"image must show a plane grid, got {len(points)} points that fit none")
    return GridMap(np.asarray(homography, dtype=np.float64), 0.0, middle, unit, 8)


def _fit(
    points: Array,
    place: Callable[[Array], Array],
    extra: Array,
    image_shape: tuple[int, ...],
) -> tuple[GridMap, Array]:
    """Map from `place(extra)` to the points, and the best `extra`."""
    flat = homography_map(points, place(extra), image_shape)
    count = 9 if len(points) >= _FEWEST_FOR_DISTORTION else 8
    start = np.append(flat.homography.ravel()[:8], np.zeros(count - 8))

    def build(p: Array) -> GridMap:
        distortion = float(p[8]) if count > 8 else 0.0
        homography = np.append(p[:8], 1.0).reshape(3, 3)
        return GridMap(homography, distortion, flat.middle, flat.unit, count + len(extra))

    best = least_squares(
        lambda p: (build(p)(place(p[count:])) - points).ravel(),
        np.append(start, extra),
        x_scale="jac",
    )
    return build(best.x), best.x[count:]
