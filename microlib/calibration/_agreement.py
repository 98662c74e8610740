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

#: Most residual of a lattice, in pitches. Printed boards, photographed, lie within 0.01; false
#: lattices, which are grown within a quarter of a step, mostly beyond 0.03.
_MOST_RESIDUAL = 0.012
#: A residual that the marks' own noise explains is no reason to refuse, whatever the pitch.
_EXPLAINED = 3.0
#: A mark so many standard deviations beside the others' map is none of theirs: by chance one of
#: 10⁸.
_STRAY = 6.0
#: Of a point that the fields follow but for this part nothing is known.
_LEAST_SHOWN = 1e-3
#: Least part of the marks that must agree.
_LEAST_AGREEING = 0.75
#: Degrees of freedom that the fits' own σ counts for when it is held against the residuals; of
#: fewer residuals than that little can be known.
_OWN_FREEDOM = 8.0
#: Median of the absolute values to standard deviation, for normal errors.
_TO_SIGMA = 1.4826
#: Coefficients of a polynomial of degree 4, 3, 2 in two coordinates; it is used with three times
#: as many marks. The map has absorbed a constant and a slope already.
_COEFFICIENTS = {4: 15, 3: 10, 2: 6}
_MARKS_PER_COEFFICIENT = 3
#: Powers of the squared radius that a lens' distortion has beside the map's own; each is used with
#: so many marks a power.
_RADIAL_POWERS, _MARKS_PER_POWER = (2, 3), 6


def agree(
    points: Array, positions: Array, to_image: GridMap, sigma: Array, pitch: float
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
        spread = _TO_SIGMA * np.median(np.abs(left[kept])) * inflation
        apart = np.abs(left) / np.sqrt(np.maximum(shown, _LEAST_SHOWN))
        stray = apart.max(axis=-1) > _STRAY * np.maximum(spread, sigma)
        before, kept = kept, ~stray.any(axis=1)
        if (kept == before).all() or not kept.any():
            break
    kept = before & kept
    share = kept.mean()
    rms = float(np.sqrt((left[kept] ** 2).mean()) * inflation) if kept.any() else np.inf
    own = float(np.sqrt((sigma[kept] ** 2).mean())) if kept.any() else 0.0
    if rms > max(_MOST_RESIDUAL * pitch, _EXPLAINED * own) or share < _LEAST_AGREEING:
        raise ValueError(
            f"image must show a regular lattice, got marks {rms:.2g} px "
            f"({100 * rms / pitch:.2g} % of a pitch) beside one, and {100 * share:.0f} % of them"
        )
    added = max(rms**2 - own**2, 0.0) * freedom / (freedom + _OWN_FREEDOM)
    return kept, np.sqrt(sigma**2 + added), rms / own


def _smooth_fields(positions: Array, radial: Array, to_image: GridMap) -> tuple[Array, int]:
    """Smooth displacements that so many marks can tell, (fields, n, k, 2), and the numbers that
    they and the map have together."""
    marks = len(positions)
    squared = (radial**2).sum(axis=-1, keepdims=True)
    powers = [p for p in _RADIAL_POWERS if marks >= _MARKS_PER_POWER * p]
    fields = [radial * squared**p for p in powers]
    degree = max(
        (d for d, count in _COEFFICIENTS.items() if marks >= _MARKS_PER_COEFFICIENT * count),
        default=0,
    )
    x, y = np.moveaxis((positions - positions.mean(axis=(0, 1))) / np.ptp(positions), -1, 0)
    for i in range(max(degree, 1) + 1):
        for j in range(max(degree, 1) + 1 - i):
            term = (x**i * y**j)[..., None]
            fields += [term * [1.0, 0.0], term * [0.0, 1.0]]
    # Of the map's numbers the six of an affine map are the polynomial's too.
    return np.array(fields), len(fields) + max(to_image.freedom - 6, 0)
