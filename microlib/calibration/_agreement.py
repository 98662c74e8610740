"""The final test of a detection: do the marks lie where a lens would put a lattice?

A lens images a plane lattice by a homography and a smooth distortion. What marks lie beside that is
their error, whatever their own fits say of it; and where it is no small part of a pitch, the marks
are no lattice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.calibration._grid_map import GridMap
from microlib.calibration._marks import TO_SIGMA
from microlib.calibration._settings import Settings


def agree(
    points: Array,
    positions: Array,
    to_image: GridMap,
    sigma: Array,
    pitch: float,
    settings: Settings,
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
    pitch : float
        Step of the lattice in the image, px.
    settings : Settings
        Those of the detection.

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
    fields, numbers = _smooth_fields(
        positions, (points - to_image.middle) / to_image.unit, to_image
    )
    kept = np.ones(len(points), dtype=bool)
    for _ in range(3):  # strays bend the fields that they are found by
        freedom = residuals[kept].size - numbers
        if freedom <= 0:
            return kept, sigma, np.nan
        design = fields[:, kept].reshape(len(fields), -1).T
        inverse = np.linalg.pinv(design)
        best = inverse @ residuals[kept].ravel()
        left = residuals - np.tensordot(best, fields, axes=1)
        # A mark that the fields follow, alone in its row or column, leaves little of its error.
        shown = np.ones(left.shape)
        shown[kept] -= np.einsum("ij,ji->i", design, inverse).reshape(shown[kept].shape)
        inflation = np.sqrt(residuals[kept].size / freedom)
        spread = TO_SIGMA * np.median(np.abs(left[kept])) * inflation
        apart = np.abs(left) / np.sqrt(np.maximum(shown, 1e-3))
        stray = apart.max(axis=-1) > settings.stray * np.maximum(spread, sigma)
        before, kept = kept, ~stray.any(axis=1)
        if (kept == before).all() or not kept.any():
            break
    kept = before & kept
    share = kept.mean()
    rms = float(np.sqrt((left[kept] ** 2).mean()) * inflation) if kept.any() else np.inf
    own = float(np.sqrt((sigma[kept] ** 2).mean())) if kept.any() else 0.0
    # What the marks' own noise explains is no reason to refuse, whatever the pitch.
    if rms > max(settings.most_residual * pitch, 3 * own) or share < 3 / 4:
        raise ValueError(
            f"image must show a regular lattice, got marks {rms:.2g} px "
            f"({100 * rms / pitch:.2g} % of a pitch) beside one, and {100 * share:.0f} % of them"
        )
    # The fits' own σ counts as much as eight residuals: of fewer little can be known.
    added = max(rms**2 - own**2, 0.0) * freedom / (freedom + 8)
    return kept, np.sqrt(sigma**2 + added), rms / own


def _smooth_fields(positions: Array, radial: Array, to_image: GridMap) -> tuple[Array, int]:
    """Smooth displacements that so many marks can tell, (fields, n, k, 2), and the numbers that
    they and the map have together."""
    marks = len(positions)
    squared = (radial**2).sum(axis=-1, keepdims=True)
    # Those of a lens beside the map's own.
    powers = [p for p in (2, 3) if marks >= 6 * p]
    fields = [radial * squared**p for p in powers]
    # Polynomials of (d + 1)(d + 2)/2 coefficients, with three times as many marks; the map has
    # absorbed a constant and a slope already.
    degree = max((d for d in (2, 3, 4) if 2 * marks >= 3 * (d + 1) * (d + 2)), default=0)
    x, y = np.moveaxis((positions - positions.mean(axis=(0, 1))) / np.ptp(positions), -1, 0)
    for i in range(max(degree, 1) + 1):
        for j in range(max(degree, 1) + 1 - i):
            term = (x**i * y**j)[..., None]
            fields += [term * [1.0, 0.0], term * [0.0, 1.0]]
    # Of the map's numbers the six of an affine map are the polynomial's too.
    return np.array(fields), len(fields) + max(to_image.freedom - 6, 0)
