"""The map from a pattern's grid to its image: a homography and a radial distortion, fitted to
detected points; and the final test of a detection by it.

It needs no calibration and serves to find out how far a detected feature (center of an ellipse,
crossing of straight lines) lies from the image of the point that it stands for. A lens images a
plane lattice by a homography and a smooth distortion. What marks lie beside that is their error,
whatever their own fits say of it; and where it is no small part of a pitch, the marks are no
lattice.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import leastsq

from microlib._common import Array
from microlib.calibration._uncertainty import polynomial_basis
from microlib.calibration.detection._marks import TO_SIGMA
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

    def __call__(self, grid: NDArray) -> Array:
        """Image points (..., 2) of grid coordinates (..., 2), px; NaN beyond the horizon."""
        with np.errstate(over="ignore", invalid="ignore"):  # a search may pass such maps
            flat = grid @ self.homography[:, :2].T + self.homography[:, 2]
            ahead = flat[..., :2] / np.where(flat[..., 2:] > 0, flat[..., 2:], np.nan)
            seen = distort(np.where(np.isfinite(ahead), ahead, np.nan), self.distortion)
        return self.middle + self.unit * seen

    def steps(self, grid: NDArray) -> Array:
        """Derivatives of the image points by the coordinates, (..., 2, 2): one column each, px."""
        columns = [(self(grid + s) - self(grid - s)) / (2 * _STEP) for s in _STEP * np.eye(2)]
        return np.stack(columns, axis=-1)

    def scale(self, grid: NDArray) -> Array:
        """Area in the image of one cell of the grid around each of the coordinates, px²."""
        (xi, xj), (yi, yj) = np.moveaxis(self.steps(grid), (-2, -1), (0, 1))
        return np.asarray(np.abs(xi * yj - xj * yi))


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
    # The homography's numbers but the last, which is one, the distortion, and a square's sides.
    start = np.concatenate([best.ravel()[:-1], np.zeros(3)])
    squares = points.shape[1] == 4
    # The distortion has freedom left from six points on.
    free = np.repeat([True, points.size > len(start), squares], [len(start) - 3, 1, 2])

    def build(p: Array) -> tuple[GridMap, Array]:
        every = start.copy()
        every[free] = p
        *homography, distortion, width, height = every
        matrix = np.append(homography, 1.0).reshape(3, 3)
        to_image = GridMap(matrix, distortion, middle, unit, len(p))
        return to_image, cells[:, None] + offsets * [width, height]

    def residuals(p: Array) -> Array:
        to_image, positions = build(p)
        return (to_image(positions) - points).ravel()

    if squares:
        area = np.abs(np.linalg.det(points[:, 2:] - points[:, :2])) / 2
        cell = np.median(build(start[free])[0].scale(cells))
        if not cell > 0:
            raise refusal
        start[-2:] = np.sqrt(np.median(area) / cell)
    with suppress(ValueError):  # a search beyond the horizon ends in numbers that are none
        to_image, positions = build(leastsq(residuals, start[free], full_output=True)[0])
        if np.isfinite(to_image.steps(positions)).all():
            return to_image, positions
    raise refusal


def agree(
    points: Array, positions: Array, to_image: GridMap, sigma: Array, most: float, stray: float
) -> tuple[NDArray[np.bool_], Array, float]:
    """Hold the points of marks against the map of their grid.

    Parameters
    ----------
    points, positions : ndarray, shape (n, k, 2)
        Image points of each mark, px, and their coordinates in the lattice, in which what is left
        of a distortion is smooth.
    to_image : GridMap
        Fitted to them.
    sigma : ndarray, shape (n, k)
        Standard deviation of a coordinate as the outlines' own fits tell it, px.
    most : float
        Largest residual of a lattice, rms, in pitches.
    stray : float
        A mark so many standard deviations beside the others' map is none of theirs.

    Returns
    -------
    kept : ndarray of bool, shape (n,)
        False for marks that are none of the lattice's.
    sigma : ndarray, shape (n, k)
        Standard deviation of a coordinate, px: of the fits, or of the residuals where larger.
    misfit : float
        Residuals over what the fits alone state, root of the ratio of variances; NaN where too few
        marks leave no residuals.

    Raises
    ------
    ValueError
        If the points lie off every smooth image of a lattice.
    """
    residuals = points - to_image(positions)
    fields = _smooth_fields(points, positions, to_image)
    # An affine map's numbers are the first of the polynomial's, too.
    numbers = to_image.freedom + max(len(fields) - 2 * 3, 0)
    kept = np.ones(len(points), dtype=bool)
    for _ in range(3):  # strays bend the fields that they are found by
        freedom = residuals[kept].size - numbers
        if freedom <= 0:
            return kept, sigma, np.nan
        left, apart = _beside(residuals, fields, kept)
        inflation = np.sqrt(residuals[kept].size / freedom)
        spread = TO_SIGMA * np.median(np.abs(left[kept])) * inflation
        beside = apart.max(axis=-1) > stray * np.maximum(spread, sigma)
        before, kept = kept, ~beside.any(axis=1)
        if (kept == before).all() or not kept.any():
            break
    kept = before & kept
    share = kept.mean()
    rms = float(np.sqrt((left[kept] ** 2).mean()) * inflation) if kept.any() else np.inf
    own = float(np.sqrt((sigma[kept] ** 2).mean())) if kept.any() else 0.0
    pitch = float(np.sqrt(np.median(to_image.scale(positions.mean(axis=1)))))
    # What the marks' own noise explains is no reason to refuse, whatever the pitch.
    if rms > max(most * pitch, 3 * own) or share < 3 / 4:
        raise ValueError(
            f"image must show a regular lattice, got {share:.0%} of the marks on one, and them "
            f"{rms:.2g} px ({rms / pitch:.1%} of a pitch) beside it"
        )
    # The fits' own σ counts as much as eight residuals: of fewer little can be known.
    added = max(rms**2 - own**2, 0.0) * freedom / (freedom + 8)
    return kept, np.sqrt(sigma**2 + added), rms / own


def _smooth_fields(points: Array, positions: Array, to_image: GridMap) -> Array:
    """Smooth displacements that so many marks can tell, (fields, n, k, 2)."""
    terms, _ = polynomial_basis(positions, points_per_term=3)
    bent = np.einsum("nkt,ab->tankb", terms, np.eye(2)).reshape(-1, *points.shape)
    # Those of a lens beside the map's own, each with six marks.
    radial = (points - to_image.middle) / to_image.unit
    squared = (radial**2).sum(axis=-1, keepdims=True)
    lens = [radial * squared**p for p in (2, 3) if len(points) >= 2 * 3 * p]
    return np.array([*bent, *lens])


def _beside(residuals: Array, fields: Array, kept: NDArray[np.bool_]) -> tuple[Array, Array]:
    """What fields fitted to the marks kept leave of the residuals, and its size over the part of a
    mark's error that is left: little of one that they follow, alone in its row or column."""
    design = fields[:, kept].reshape(len(fields), -1).T
    inverse = np.linalg.pinv(design)
    left = residuals - np.tensordot(inverse @ residuals[kept].ravel(), fields, axes=1)
    shown = np.ones(left.shape)
    shown[kept] -= np.einsum("ij,ji->i", design, inverse).reshape(shown[kept].shape)
    return left, np.abs(left) / np.sqrt(np.maximum(shown, 1e-3))
