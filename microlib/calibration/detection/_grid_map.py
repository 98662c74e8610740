"""Map from the grid of a pattern to its image, fitted to detected points, and a test of them.

A lens images a plane lattice by a homography and a smooth distortion. The map needs no calibration.
It gives the bias of detected features, such as the centers of ellipses. The deviations of the
points from the map are their errors, also where their own fits state smaller ones. If they are not
small compared with the pitch, the marks do not form a lattice.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import leastsq

from microlib._common import Array, robust_std
from microlib.calibration._polynomials import polynomial_basis
from microlib.calibration.detection._settings import DetectionSettings
from microlib.microscope import distort

#: Integer coordinates of marks in a lattice, (n, 2).
GridIndex = NDArray[np.intp]
#: Point of a round mark relative to the coordinates of the mark.
MIDDLE = np.zeros((1, 2))
#: Step of the central differences, in cells. Their relative error is its square, and rounding makes
#: 1e-12 of it.
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
    parameters : int
        Number of fitted parameters.
    """

    homography: Array
    distortion: float
    middle: Array
    unit: float
    parameters: int

    def __call__(self, grid: NDArray) -> Array:
        """Image points (..., 2) of grid coordinates (..., 2), px; NaN beyond the horizon."""
        with np.errstate(over="ignore", invalid="ignore"):  # a fit may pass such maps
            homogeneous = grid @ self.homography[:, :2].T + self.homography[:, 2]
            depth = np.where(homogeneous[..., 2:] > 0, homogeneous[..., 2:], np.nan)
            projected = homogeneous[..., :2] / depth
            distorted = distort(
                np.where(np.isfinite(projected), projected, np.nan), self.distortion
            )
        return self.middle + self.unit * distorted

    def steps(self, grid: NDArray) -> Array:
        """Derivatives of the image points by the coordinates, (..., 2, 2): one column each, px."""
        columns = [(self(grid + s) - self(grid - s)) / (2 * _STEP) for s in _STEP * np.eye(2)]
        return np.stack(columns, axis=-1)

    def scale(self, grid: NDArray) -> Array:
        """Area in the image of one cell of the grid around each of the coordinates, px²."""
        (xi, xj), (yi, yj) = np.moveaxis(self.steps(grid), (-2, -1), (0, 1))
        return np.asarray(np.abs(xi * yj - xj * yi))


def plane_map(points: Array, grid: GridIndex, image_shape: tuple[int, ...]) -> GridMap:
    """Least-squares homography from the grid to points (n, 2), as a map without distortion."""
    middle = (np.array(image_shape[1::-1], dtype=np.float64) - 1) / 2
    unit = float(middle.max())
    homography = cv2.findHomography(grid.astype(np.float64), (points - middle) / unit)[0]
    if homography is None or not np.isfinite(homography).all():
        raise ValueError(f"image must show a plane grid, got {len(points)} points that fit none")
    return GridMap(np.asarray(homography, float), 0.0, middle, unit, parameters=8)


def map_centers(centers: Array, grid: GridIndex, image_shape: tuple[int, ...]) -> GridMap:
    """Least-squares map from the grid to the centers of marks (n, 2), px."""
    return fit_grid_map(centers[:, None], grid, MIDDLE, image_shape)[0]


def fit_grid_map(
    points: Array, grid: GridIndex, offsets: Array, image_shape: tuple[int, ...]
) -> tuple[GridMap, Array]:
    """Least-squares map from the grid to the points of its marks.

    Parameters
    ----------
    points : ndarray, shape (n, k, 2)
        Image points of each mark, px: a center, or the four corners of a square.
    grid : ndarray of int, shape (n, 2)
        Coordinates of the marks in the lattice.
    offsets : ndarray, shape (k, 2)
        Points of a mark relative to its coordinates, in sides of the square; both sides are fitted.
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
        If the fit is not finite.
    """
    plane = plane_map(points.mean(axis=1), grid, image_shape)
    refusal = ValueError(f"image must show a plane grid, got {len(points)} points that fit none")
    # Homography without its last element, which is one, distortion, and the sides of a square.
    start = np.concatenate([plane.homography.ravel()[:-1], np.zeros(3)])
    squares = points.shape[1] == 4
    # The distortion is determined by six points or more.
    free = np.repeat([True, points.size > len(start), squares], [len(start) - 3, 1, 2])

    def build(p: Array) -> tuple[GridMap, Array]:
        every = start.copy()
        every[free] = p
        *homography, distortion, width, height = every
        matrix = np.append(homography, 1.0).reshape(3, 3)
        to_image = replace(plane, homography=matrix, distortion=distortion, parameters=len(p))
        return to_image, grid[:, None] + offsets * [width, height]

    def residuals(p: Array) -> Array:
        to_image, positions = build(p)
        return (to_image(positions) - points).ravel()

    if squares:
        area = np.abs(np.linalg.det(points[:, 2:] - points[:, :2])) / 2
        cell = np.median(build(start[free])[0].scale(grid))
        if not cell > 0:
            raise refusal
        start[-2:] = np.sqrt(np.median(area) / cell)
    with suppress(ValueError):  # a fit beyond the horizon is not finite
        to_image, positions = build(leastsq(residuals, start[free], full_output=True)[0])
        if np.isfinite(to_image.steps(positions)).all():
            return to_image, positions
    raise refusal


@dataclass(frozen=True, eq=False)
class ResidualTest:
    """Result of `check_residuals` for n marks with k points.

    Parameters
    ----------
    kept : ndarray of bool, shape (n,)
        False for outliers.
    uncertainty : ndarray, shape (n, k)
        Standard deviation of a coordinate, px, from the fits of the outlines or from the residuals,
        whichever is larger.
    normalized_rms : float
        Root of the residuals' variance over that stated by the fits; NaN for too few marks.
    """

    kept: NDArray[np.bool_]
    uncertainty: Array
    normalized_rms: float


def check_residuals(
    points: Array,
    positions: Array,
    to_image: GridMap,
    uncertainty: Array,
    max_residual: float,
    settings: DetectionSettings,
) -> ResidualTest:
    """Compare the points of marks with the smooth image of their lattice.

    Parameters
    ----------
    points, positions : ndarray, shape (n, k, 2)
        Image points of each mark, px, and their coordinates in the lattice.
    to_image : GridMap
        Map fitted to them.
    uncertainty : ndarray, shape (n, k)
        Standard deviation of a coordinate by the fits of the outlines, px.
    max_residual : float
        Largest rms deviation of points from a smooth image of the lattice, in pitches.
    settings : DetectionSettings
        Settings of the detection.

    Returns
    -------
    ResidualTest

    Raises
    ------
    ValueError
        If the points lie off every smooth image of a lattice.
    """
    residuals = points - to_image(positions)
    basis = _distortion_basis(points, positions, to_image)
    # The basis contains the affine map of the six lowest terms, as the map does.
    parameters = to_image.parameters + max(len(basis) - 6, 0)
    kept = np.ones(len(points), dtype=bool)
    for _ in range(3):  # an outlier distorts the fit by which outliers are found
        dof = residuals[kept].size - parameters
        if dof <= 0:
            return ResidualTest(kept=kept, uncertainty=uncertainty, normalized_rms=np.nan)
        remaining, deviation = _studentized(residuals, basis, kept)
        inflation = np.sqrt(residuals[kept].size / dof)
        scatter = robust_std(remaining[kept]) * inflation
        limit = settings.outlier_limit * np.maximum(scatter, uncertainty)
        before, kept = kept, (deviation.max(axis=-1) <= limit).all(axis=1)
        if (kept == before).all() or not kept.any():
            break
    kept = before & kept
    fraction = kept.mean()
    rms = float(np.sqrt((remaining[kept] ** 2).mean()) * inflation) if kept.any() else np.inf
    stated = float(np.sqrt((uncertainty[kept] ** 2).mean())) if kept.any() else 0.0
    pitch = float(np.sqrt(np.median(to_image.scale(positions.mean(axis=1)))))
    # Residuals that the noise of the marks explains are accepted up to a part of the pitch.
    noise = min(settings.max_noise_ratio * stated, settings.max_noise_residual * pitch)
    limit = max(max_residual * pitch, noise)
    if rms > limit or fraction < settings.min_kept:
        raise ValueError(
            f"image must show a regular lattice, got {fraction:.0%} of the marks on one with "
            f"deviations of {rms:.2g} px, {rms / pitch:.1%} of a pitch"
        )
    # Few residuals determine little.
    added = max(rms**2 - stated**2, 0.0) * dof / (dof + settings.prior_residuals)
    return ResidualTest(
        kept=kept, uncertainty=np.sqrt(uncertainty**2 + added), normalized_rms=rms / stated
    )


def _distortion_basis(points: Array, positions: Array, to_image: GridMap) -> Array:
    """Smooth displacements of the points, (fields, n, k, 2), as many as the marks determine.

    They are polynomials of the coordinates and higher terms of a radial distortion.
    """
    terms, _ = polynomial_basis(positions, points_per_term=3)
    polynomials = np.einsum("nkt,ab->tankb", terms, np.eye(2)).reshape(-1, *points.shape)
    radial = (points - to_image.middle) / to_image.unit
    squared = (radial**2).sum(axis=-1, keepdims=True)
    # Six marks for each.
    lens = [radial * squared**p for p in (2, 3) if len(points) >= 2 * 3 * p]
    return np.array([*polynomials, *lens])


def _studentized(residuals: Array, basis: Array, kept: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Residuals of a fit of the basis to the kept marks, and their absolute studentized values.

    These are divided by √(1 − h) with the leverage h, so that all have one standard deviation.
    """
    design = basis[:, kept].reshape(len(basis), -1).T
    inverse = np.linalg.pinv(design)
    remaining = residuals - np.tensordot(inverse @ residuals[kept].ravel(), basis, axes=1)
    not_followed = np.ones(remaining.shape)
    not_followed[kept] -= np.einsum("ij,ji->i", design, inverse).reshape(not_followed[kept].shape)
    return remaining, np.abs(remaining) / np.sqrt(np.maximum(not_followed, 1e-3))
