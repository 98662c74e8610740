"""Covariance of calibrated parameters by image noise, their intervals, and the Cramér–Rao bound."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtrit

from microlib._common import Array, inverse_normal, scalar
from microlib.calibration._views import Fit, Views
from microlib.microscope import Microscope

#: A kilometer, µm: an infinite focal length is reported as this length, and no noise in px is
#: larger.
KILOMETER = 1e9


def cramer_rao(
    microscope: Microscope, world: ArrayLike, noise: float, parameters: tuple[str, ...]
) -> Array:
    """Smallest covariance any unbiased estimate of `parameters` can have.

    Parameters
    ----------
    microscope : Microscope
        The true microscope.
    world : array_like, shape (N, 2)
        Points of the pattern plane, µm.
    noise : float
        Standard deviation of each coordinate of the image points, px.
    parameters : tuple of str
        Names of the parameters that are estimated together, see
        :meth:`microlib.microscope.Microscope.jacobian`. The other parameters are known.

    Returns
    -------
    ndarray, shape (p, p)
        (JᵀJ)⁻¹ σ². Undetermined parameters have infinite variances and NaN covariances.

    Raises
    ------
    ValueError
        If `world` or `noise` has a wrong shape or value, a point lies outside the domain of
        the distortion model, or a name is unknown.

    Examples
    --------
    No set of points on a plane determines the three lengths:

    >>> import numpy as np
    >>> from microlib.calibration import cramer_rao
    >>> from microlib.microscope import Microscope
    >>> scope = Microscope(
    ...     200490, 126150, 78750, beta=0.05, pixel_pitch=9.9, image_size=(656, 491))
    >>> x, y = np.meshgrid(np.linspace(-1500, 1500, 7), np.linspace(-1000, 1000, 5))
    >>> world = np.column_stack([x.ravel(), y.ravel()])
    >>> np.diag(cramer_rao(scope, world, 0.02, ("tube_length", "focal_length", "distance")))
    array([inf, inf, inf])
    """
    noise = scalar("noise", noise, least=0, most=KILOMETER)
    jacobian = microscope.jacobian(world, parameters).reshape(-1, len(parameters))
    if not np.isfinite(jacobian).all():
        raise ValueError("world must be points that the microscope sees, got some that it cannot")
    inverse = inverse_normal(jacobian)
    with np.errstate(invalid="ignore"):  # an undetermined parameter stays so without noise
        return np.where(np.isinf(inverse), np.inf, noise**2 * inverse)


def student_quantile(dof: float, level: float = 0.95) -> float:
    """Half-width of a confidence interval in standard deviations, by Student's distribution."""
    return float(stdtrit(dof, (1 + level) / 2))


def reciprocal_interval(value: float, half_width: float) -> tuple[float, float]:
    """Interval of a positive quantity whose reciprocal has a normal error.

    `half_width` is that of the reciprocal's interval, relative to the reciprocal. The quantity has
    no upper limit if the reciprocal's interval contains zero.
    """
    return value / (1 + half_width), np.inf if half_width >= 1 else value / (1 - half_width)


def group_jackknife(jacobian: Array, inverse: Array, residuals: Array, groups: NDArray) -> Array:
    """Covariance of least-squares parameters by the delete-a-group jackknife.

    It assumes nothing about the correlation of errors within a group. The closed form holds for a
    linear problem (cluster-robust covariance CV3 of Bell and McCaffrey, 2002):
    with H_g = J_g (JᵀJ)⁻¹ J_gᵀ, the parameters change by (JᵀJ)⁻¹ J_gᵀ (1 − H_g)⁻¹ r_g without group
    g, and their covariance is (G − 1)/G times the sum of the outer products of the changes.

    Parameters
    ----------
    jacobian : ndarray, shape (2 N, p)
        Derivatives J of the residuals.
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


def noise_covariance(views: Views, fit: Fit, marks: NDArray[np.intp] | None) -> Array:
    """Covariance of `Fit.estimate` from the errors of the image points.

    `marks` has the number of the mark of each point. The errors of the points of a mark are
    correlated: in one view the corners of a square share its sides, and in all views a printed mark
    has the same error of its position. Without `marks` the points are independent.
    """
    inverse = inverse_normal(fit.jacobian)
    if marks is None:
        return inverse * views.residual_variance(fit)
    jackknife = group_jackknife(fit.jacobian, inverse, fit.residuals, marks)
    return jackknife + inverse * views.rounding_variance(fit.poses)
