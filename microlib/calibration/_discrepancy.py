"""What a model's error does to its parameters: the part of the residuals that is smooth.

Noise differs from point to point. A distortion that the model lacks, a bent target or a shifted
optical axis displaces neighbors alike. Such a displacement is seen where the model cannot follow
it, and is as large, presumably, where the model can: there it is an error of the parameters that no
residual shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import f as fisher

from microlib._common import OPEN, Array

#: Degree of the smooth displacements, their number in two coordinates, and the points that they are
#: used from: four residuals for each.
_DEGREES = ((4, 15, 60), (3, 10, 40), (2, 6, 24))
#: Smooth residuals that noise makes in more than this part of all images are taken for noise.
BY_CHANCE = 0.1
#: A direction that the parameters follow up to this part of it shows nothing.
_FOLLOWED = 1e-4
#: A smooth displacement's terms fall with their degree: those of a lens and of a bent plate, as far
#: as they are known, by a third and more a degree. Without it (1), a bend hidden in the focal
#: length is stated half as large as with 2 to 4.
_FALL = 3.0
#: Residuals below this, px, are those of rounding in exact data.
_EXACT = 1e-9


@dataclass(frozen=True)
class Discrepancy:
    """Smooth part of the residuals.

    Parameters
    ----------
    misfit : float
        Its size over what noise makes of it: about one for a model that fits; NaN where there are
        too few points to tell.
    chance : float
        Probability of so much by noise alone; one where there are too few points.
    covariance : ndarray, shape (p, p)
        What it adds to that of the parameters.
    """

    misfit: float
    chance: float
    covariance: Array


def smooth_fields(points: Array) -> Array:
    """Displacements that vary smoothly over the points, (2N, k), each as long as it is likely.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        In any unit.

    Returns
    -------
    ndarray, shape (2N, k)
        Orthogonal polynomials of both coordinates, of length 1, 1/3, 1/9 … by their degree; none
        for fewer than 24 points.

    Examples
    --------
    >>> smooth_fields(np.random.default_rng(0).normal(size=(30, 2))).shape
    (60, 12)
    """
    degree = next((d for d, _, least in _DEGREES if len(points) >= least), None)
    if degree is None:
        return np.empty((2 * len(points), 0))
    middle = points.mean(axis=0)
    x, y = ((points - middle) / np.abs(points - middle).max()).T
    powers = [(i, total - i) for total in range(degree + 1) for i in range(total + 1)]
    each, _ = np.linalg.qr(np.column_stack([x**i * y**j for i, j in powers]))
    each = each * [_FALL ** -(i + j) for i, j in powers]
    fields = np.zeros((len(points), 2, each.shape[1], 2))
    fields[:, 0, :, 0] = fields[:, 1, :, 1] = each
    return fields.reshape(2 * len(points), -1)


def discrepancy(residuals: Array, jacobian: Array, fields: Array) -> Discrepancy:
    """Test residuals for a smooth part, and carry it to the parameters.

    Parameters
    ----------
    residuals : ndarray, shape (m,)
        At the best fit.
    jacobian : ndarray, shape (m, p)
        Their derivatives by the parameters.
    fields : ndarray, shape (m, k)
        Smooth displacements.

    Returns
    -------
    Discrepancy

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x = np.linspace(-1, 1, 60)
    >>> fields = np.linalg.qr(x[:, None] ** np.arange(5))[0]
    >>> line = np.column_stack([np.ones(60), x])
    >>> bent = x**2 - (x**2).mean() + rng.normal(0, 0.05, 60)
    >>> discrepancy(bent, line, fields).misfit > 5
    True
    """
    count = jacobian.shape[1]
    scale = np.linalg.norm(jacobian, axis=0)
    scale = np.where(scale == 0, 1.0, scale)
    basis, singular, directions = np.linalg.svd(jacobian / scale, full_matrices=False)
    seen = fields - basis @ (basis.T @ fields)
    # Of squares, which are quicker than the fields themselves: what is followed lies far above the
    # root of rounding.
    size, axes = np.linalg.eigh(seen.T @ seen)
    shown = size > _FOLLOWED**2
    free = int(shown.sum())
    freedom = len(residuals) - count - free
    if free == 0 or freedom <= 0:
        return Discrepancy(np.nan, 1.0, np.zeros((count, count)))
    smooth = float(((axes.T @ (seen.T @ residuals))[shown] ** 2 / size[shown]).sum())
    rest = float((residuals**2).sum()) - smooth
    noise = max(rest, 0.0) / freedom
    if not noise > _EXACT**2:
        return Discrepancy(1.0, 1.0, np.zeros((count, count)))
    ratio = smooth / free / noise
    chance = float(fisher.sf(ratio, free, freedom))
    if chance > BY_CHANCE:
        return Discrepancy(float(np.sqrt(ratio)), chance, np.zeros((count, count)))
    amplitude = (smooth - noise * free) / float((seen**2).sum())
    followed = _response(basis, singular, directions, scale, fields)
    return Discrepancy(float(np.sqrt(ratio)), chance, amplitude * followed @ followed.T)


def response(jacobian: Array, fields: Array) -> Array:
    """Errors of least-squares parameters that displacements of the points make, (p, k).

    Parameters
    ----------
    jacobian : ndarray, shape (m, p)
        Derivatives of the residuals by the parameters.
    fields : ndarray, shape (m, k)
        Displacements.

    Returns
    -------
    ndarray, shape (p, k)
        Zero in directions that the points leave open.
    """
    scale = np.linalg.norm(jacobian, axis=0)
    scale = np.where(scale == 0, 1.0, scale)
    basis, singular, directions = np.linalg.svd(jacobian / scale, full_matrices=False)
    return _response(basis, singular, directions, scale, fields)


def _response(
    basis: Array, singular: Array, directions: Array, scale: Array, fields: Array
) -> Array:
    held = singular > OPEN * singular[0]
    inverse = np.divide(1.0, singular, out=np.zeros_like(singular), where=held)
    moved: Array = (directions.T * inverse) @ (basis.T @ fields) / scale[:, None]
    return moved
