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
        """Image points (..., 2) of grid coordinates (..., 2), px; NaN beyond the horizon."""
        with np.errstate(over="ignore", invalid="ignore"):  # a search may pass such maps
            flat = grid @ self.homography[:, :2].T + self.homography[:, 2]
            ahead = flat[..., :2] / np.where(flat[..., 2:] > 0, flat[..., 2:], np.nan)
            seen = distort(np.where(np.isfinite(ahead), ahead, np.nan), self.distortion)
        return self.middle + self.unit * seen

    def steps(self, grid: Array) -> Array:
        """Derivatives of the image points by the coordinates, (..., 2, 2): one column each, px."""
        columns = [(self(grid + s) - self(grid - s)) / (2 * _STEP) for s in _STEP * np.eye(2)]
        return np.stack(columns, axis=-1)

    def scale(self, grid: Array) -> Array:
        """Area in the image of one cell of the grid around each of the coordinates, px²."""
        (a, b), (c, d) = np.moveaxis(self.steps(grid), (-2, -1), (0, 1))
        return np.abs(a * d - b * c)


def fit_grid_map(
    points: Array, cells: Array, offsets: Array, image_shape: tuple[int, ...]
) -> tuple[GridMap, Array]:
    """Least-squares map from the grid to the points of its marks.

    Parameters
    ----------
    points : ndarray, shape (n, k, 2)
        Image points of each mark, px: a center, or the four corners of a square.
    cells : ndarray, shape (n, 2)
        Coordinates of the marks, pitches.
    offsets : ndarray, shape (k, 2)
        Where the points lie from there, in sides of the square, which are fitted, too.
    image_shape : tuple of int
        Height and width of the image, px.

    Returns
    -------
    to_image : GridMap
        From coordinates in pitches to the image; without distortion below six points.
    positions : ndarray, shape (n, k, 2)
        Coordinates of the points.

    Raises
    ------
    ValueError
        If no map of finite numbers leads from the coordinates to the points.
    """
    middle = (np.array(image_shape[1::-1], dtype=np.float64) - 1) / 2
    unit = float(middle.max())
    flat = (points.mean(axis=1) - middle) / unit
    best = cv2.findHomography(cells.astype(np.float64), flat)[0]
    refusal = ValueError(f"image must show a plane grid, got {len(points)} points that fit none")
    if best is None or not np.isfinite(best).all():
        raise refusal
    homography: Array = np.asarray(best, dtype=np.float64)
    # Nine numbers have freedom left from six points on.
    count = 9 if points[..., 0].size > 5 else 8
    start = np.append(homography.ravel()[:8], np.zeros(count - 8))
    squares = points.shape[1] == 4
    if squares:
        area = np.abs(np.linalg.det(points[:, 2:] - points[:, :2])) / 2
        cell = np.median(GridMap(homography, 0.0, middle, unit, 8).scale(cells))
        if not cell > 0:
            raise ValueError("image must show squares on a plane grid, got them in one row")
        start = np.append(start, np.full(2, np.sqrt(np.median(area) / cell)))

    def build(p: Array) -> tuple[GridMap, Array]:
        distortion = float(p[8]) if count > 8 else 0.0
        homography = np.append(p[:8], 1.0).reshape(3, 3)
        to_image = GridMap(homography, distortion, middle, unit, len(p))
        return to_image, cells[:, None] + (offsets * p[count:] if squares else offsets)

    def residuals(p: Array) -> Array:
        to_image, positions = build(p)
        return (to_image(positions) - points).ravel()

    if not np.isfinite(residuals(start)).all():  # marks on both sides of a horizon
        raise refusal
    try:
        to_image, positions = build(least_squares(residuals, start, x_scale="jac").x)
    except ValueError:  # SciPy's, of a derivative beyond the horizon
        raise refusal from None
    if not np.isfinite(to_image.steps(cells)).all():
        raise refusal
    return to_image, positions
