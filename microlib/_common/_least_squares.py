"""Robust weights, damped Gauss–Newton fits and the covariance of least squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common._types import Array

#: Standard deviation of a normal variable over the median of its absolute value.
MAD_TO_STD = 1.4826
#: Where Tukey's biweight ends, in standard deviations: 95 % efficient for normal noise.
TUKEY_LIMIT = 4.685

#: A direction of the scaled parameters is undetermined if its singular value is below this part of
#: the largest. Rounding leaves it at 1e-16 to 1e-15. The weakest determined directions of the
#: tests, two nearly equal terms of a Gaussian sum, reach down to 1e-7.
_UNDETERMINED = 1e-9


#: Smaller eigenvalues of a symmetric matrix of unit diagonal are rounding errors (1e-15).
_SINGULAR = 1e-12


def robust_std(deviations: ArrayLike) -> float:
    """Return the standard deviation of normal deviations, of which some are outliers.

    The median of the absolute deviations, which are those from a known center, is multiplied by
    1.4826.
    """
    return MAD_TO_STD * float(np.median(np.abs(deviations)))


def tukey_weights(residuals: NDArray, limit: float) -> NDArray:
    """Return the weights of Tukey's biweight, (1 − (r/limit)²)² and 0 beyond the limit."""
    return np.square(np.maximum(1 - np.square(residuals / limit), 0))


def inverse_normal(jacobian: Array) -> Array:
    """Invert JᵀJ, the normal matrix of a least-squares problem: its covariance for unit errors.

    Parameters
    ----------
    jacobian : ndarray, shape (m, p)
        J, the derivatives of m residuals by p parameters, in any units.

    Returns
    -------
    ndarray, shape (p, p)
        (JᵀJ)⁻¹. Each parameter that takes part in an undetermined direction has an infinite
        variance and NaN covariances: it could have any value. The block of the other parameters is
        their covariance whatever the values of the undetermined ones.

    Notes
    -----
    The singular values are those of J with each column divided by its length, so that the answer
    does not depend on the parameters' units. J itself is decomposed, not JᵀJ, whose rounding would
    hide directions 10⁸ times weaker than the strongest.

    Examples
    --------
    A line through one place: neither slope nor height is known there, but the third number is.

    >>> import numpy as np
    >>> from microlib._common._least_squares import inverse_normal
    >>> inverse_normal(np.array([[2.0, 1.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 2.0]]))
    array([[ inf,  nan,  nan],
           [ nan,  inf,  nan],
           [ nan,  nan, 0.25]])
    """
    scale = np.linalg.norm(jacobian, axis=0)
    scale = np.where(scale == 0, 1.0, scale)
    # The triangle has the singular values and the directions of all rows. With fewer residuals than
    # parameters the full decomposition has the undetermined directions, too.
    _, singular, directions = np.linalg.svd(np.linalg.qr(jacobian / scale, mode="r"))
    determined = np.count_nonzero(singular > _UNDETERMINED * singular[0])
    kept = directions[:determined].T / singular[:determined]
    inverse = kept @ kept.T / np.outer(scale, scale)
    # Where a parameter takes no part, rounding leaves components of 1e-16/_UNDETERMINED at most.
    hidden = (np.abs(directions[determined:]) > 1e-6).any(axis=0)
    inverse[hidden] = inverse[:, hidden] = np.nan
    inverse[hidden, hidden] = np.inf
    return inverse


def inverse_symmetric(matrices: Array) -> Array:
    """Return the inverses of symmetric positive matrices (n, p, p); NaN where singular.

    The matrices are scaled to a unit diagonal first, so that the units of the parameters do not
    matter.
    """
    scale = np.sqrt(np.maximum(np.einsum("npp->np", matrices), np.finfo(float).tiny))
    unit = matrices / scale[:, :, None] / scale[:, None, :]
    values, vectors = np.linalg.eigh(np.where(np.isfinite(unit), unit, 0.0))
    with np.errstate(divide="ignore"):
        inverse = np.where(values > _SINGULAR, 1 / values, np.nan)
    out = (vectors * inverse[:, None, :]) @ vectors.transpose(0, 2, 1)
    return out / scale[:, :, None] / scale[:, None, :]


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations of n independent least-squares problems, linearized at their parameters.

    Attributes
    ----------
    matrix : ndarray, shape (n, p, p)
        JᵀJ, with the derivatives J of the model.
    right : ndarray, shape (n, p)
        Jᵀr, with the residuals r, which are the data minus the model.
    cost : ndarray, shape (n,)
        Sums of the squares of the residuals.
    """

    matrix: Array
    right: Array
    cost: Array


def gauss_newton(
    linearize: Callable[[Array, NDArray[np.intp]], NormalEquations],
    start: Array,
    *,
    max_iterations: int,
    cost_tolerance: float,
) -> tuple[Array, NormalEquations, NDArray[np.bool_]]:
    """Fit n independent problems by Gauss–Newton steps, each with Levenberg–Marquardt damping.

    Parameters
    ----------
    linearize : callable
        From parameters, shape (k, p), and the numbers of their problems, shape (k,), to the normal
        equations of these problems.
    start : ndarray, shape (n, p)
        Parameters to start from.
    max_iterations : int
        Number of steps after which a problem counts as not converged.
    cost_tolerance : float
        A problem has converged when a step changes its cost by less than this part.

    Returns
    -------
    parameters : ndarray, shape (n, p)
        The best parameters.
    equations : NormalEquations
        Normal equations at these parameters.
    converged : ndarray of bool, shape (n,)
        False too where the cost is NaN at the start.

    Examples
    --------
    Two exponential decays, exp(−a t):

    >>> import numpy as np
    >>> from microlib._common._least_squares import NormalEquations, gauss_newton
    >>> time = np.linspace(0, 1, 20)
    >>> data = np.exp(-np.array([[1.0], [2.0]]) * time)
    >>> def linearize(rate, numbers):
    ...     model = np.exp(-rate * time)
    ...     slope, residual = -time * model, data[numbers] - model
    ...     matrix = (slope**2).sum(axis=1)[:, None, None]
    ...     right = (slope * residual).sum(axis=1)[:, None]
    ...     return NormalEquations(matrix, right, (residual**2).sum(axis=1))
    >>> fit, _, converged = gauss_newton(
    ...     linearize, np.ones((2, 1)), max_iterations=20, cost_tolerance=1e-6)
    >>> fit.round(6).ravel().tolist(), converged.tolist()
    ([1.0, 2.0], [True, True])
    """
    best = start.copy()
    damping = np.full(len(start), 1e-3)
    now = linearize(best, np.arange(len(start)))
    moving = np.isfinite(now.cost)  # a problem at NaN has failed
    failed = ~moving
    for _ in range(max_iterations):
        if not moving.any():
            break
        some = np.flatnonzero(moving)
        damped = now.matrix[some]
        # A parameter without effect has this value on the diagonal, and does not change.
        diagonal = np.maximum(np.einsum("npp->np", damped), _SINGULAR)
        np.einsum("npp->np", damped)[...] += damping[some, None] * diagonal
        step = (inverse_symmetric(damped) @ now.right[some, :, None])[..., 0]
        trial = linearize(best[some] + step, some)
        better = trial.cost < now.cost[some]  # False for NaN; more damping may help
        change = np.abs(trial.cost - now.cost[some])
        moving[some] = ~((change < cost_tolerance * now.cost[some]) | (now.cost[some] == 0))
        damping[some] *= np.where(better, 1 / 10, 10)
        kept = some[better]
        best[kept] += step[better]
        now.matrix[kept], now.right[kept] = trial.matrix[better], trial.right[better]
        now.cost[kept] = trial.cost[better]
    return best, now, ~(moving | failed)
