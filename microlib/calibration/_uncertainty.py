"""Covariance of calibrated parameters from image noise, and estimates with their intervals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from microlib._common import Array, inverse_normal
from microlib.calibration._fit import Fit, Photographs
from microlib.estimate import Estimate

#: A kilometer, µm: the microscope of a calibration has this focal length at most, where the points
#: do not determine it.
KILOMETER = 1e9


def student_quantile(dof: float) -> float:
    """Half-width of a 95 % interval in standard deviations, by Student's distribution."""
    return float(stdtrit(dof, 0.975))


def reciprocal_estimate(value: float, relative: float, dof: float, unit: str) -> Estimate:
    """Estimate of a positive quantity whose reciprocal has a normal error.

    `relative` is the standard deviation of the error over the value. The quantity has no upper
    limit if the interval of the reciprocal contains zero.
    """
    half_width = student_quantile(dof) * relative
    high = np.inf if half_width >= 1 else value / (1 - half_width)
    return Estimate(value, value * relative, value / (1 + half_width), high, unit)


def group_jackknife(jacobian: Array, inverse: Array, residuals: Array, groups: NDArray) -> Array:
    """Covariance of least-squares parameters by the delete-a-group jackknife.

    It assumes nothing about the correlation of errors within a group. The closed form holds for a
    linear problem (cluster-robust covariance CV3 of Bell and McCaffrey, 2002):
    with H_g = J_g (JᵀJ)⁻¹ J_gᵀ, the parameters change by −(JᵀJ)⁻¹ J_gᵀ (1 − H_g)⁻¹ r_g without
    group g, and their covariance is (G − 1)/G times the sum of the outer products of the changes.

    Parameters
    ----------
    jacobian : ndarray, shape (2 N, p)
        Derivatives J of the projection.
    inverse : ndarray, shape (p, p)
        (JᵀJ)⁻¹ as `inverse_normal` returns it.
    residuals : ndarray, shape (2 N,)
        Residuals r, px.
    groups : ndarray, shape (N,)
        Number of the group of each point.

    Returns
    -------
    ndarray, shape (p, p)
        Undetermined parameters have infinite variances and NaN covariances.
    """
    determined = np.isfinite(inverse)
    finite = np.where(determined, inverse, 0.0)
    order = np.argsort(np.repeat(groups, 2), kind="stable")
    ends = np.cumsum(2 * np.unique(groups, return_counts=True)[1])[:-1]
    scores = []
    for rows in np.split(order, ends):
        leverage = jacobian[rows] @ finite @ jacobian[rows].T
        left_out = np.linalg.solve(np.eye(len(rows)) - leverage, residuals[rows])
        scores.append(jacobian[rows].T @ left_out)
    changes = finite @ np.transpose(scores)
    count = len(scores)
    return np.where(determined, (count - 1) / count * changes @ changes.T, inverse)


def noise_covariance(
    photographs: Photographs, fit: Fit, mark_numbers: NDArray[np.intp] | None
) -> Array:
    """Covariance of `Fit.estimate` from the errors of the image points.

    `mark_numbers` has the number of the mark of each point. The errors of the points of a mark are
    correlated: in one view the corners of a square share its sides, and in all views a printed mark
    has the same error of its position. Without `mark_numbers` the points are independent.
    """
    inverse = inverse_normal(fit.jacobian)
    if mark_numbers is None:
        return inverse * photographs.residual_variance(fit)
    jackknife = group_jackknife(fit.jacobian, inverse, fit.residuals, mark_numbers)
    return jackknife + inverse * photographs.rounding_variance(fit.poses)
