"""Covariance of calibrated parameters: image noise, lack of fit, and the Cramér–Rao bound.

Image noise differs from point to point. An error of the model, such as a missing distortion term or
a bent pattern, displaces neighboring points alike (a model discrepancy in the sense of Kennedy and
O'Hagan, 2001). The part of it that the parameters can follow leaves no residual and is an error of
the parameters. Its size is estimated from the part that they cannot follow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag
from scipy.sparse import csr_array
from scipy.special import fdtrc, stdtrit

from microlib._common import Array, inverse_normal, scalar
from microlib.calibration._views import Fit, Views
from microlib.microscope import Microscope

#: A kilometer, µm: an infinite focal length is reported as this length, and no noise in px is
#: larger.
FARTHEST = 1e9


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
    >>> scope = Microscope(200490, 126150, 78750, beta=0.05)
    >>> x, y = np.meshgrid(np.linspace(-1500, 1500, 7), np.linspace(-1000, 1000, 5))
    >>> world = np.column_stack([x.ravel(), y.ravel()])
    >>> np.diag(cramer_rao(scope, world, 0.02, ("tube_length", "focal_length", "distance")))
    array([inf, inf, inf])
    """
    noise = scalar("noise", noise, least=0, most=FARTHEST)
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


def polynomial_basis(
    places: Array, points_per_term: int, max_degree: int = 4
) -> tuple[Array, Array]:
    """Monomials xⁱ yʲ of places (..., 2), (..., terms), and their degrees i + j, (terms,).

    Places are taken from their mean, in units of their extent. The highest degree d, at most
    `max_degree`, is the highest with `points_per_term` places for each of the (d + 1)(d + 2)/2
    terms.
    """
    scaled = (places - places.reshape(-1, 2).mean(axis=0)) / np.ptp(places)
    x, y = np.moveaxis(scaled, -1, 0)
    terms = [(d + 1) * (d + 2) // 2 for d in range(1, max_degree + 1)]
    degree = sum(len(places) >= points_per_term * count for count in terms)
    powers = np.array([(i, total - i) for total in range(degree + 1) for i in range(total + 1)])
    return np.stack([x**i * y**j for i, j in powers], axis=-1), powers.sum(axis=1)


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


@dataclass(frozen=True, eq=False)
class LackOfFit:
    """Test of the residuals for a smooth part, and what this part adds to the covariance.

    Parameters
    ----------
    misfit : float
        Root of the F ratio: size of the smooth part over its size by noise. About one for an
        adequate model, NaN for too few points.
    p_value : float
        Probability of a larger ratio by noise alone; one for too few points.
    covariance : ndarray, shape (p, p)
        Covariance of the parameters by the model discrepancy.
    """

    misfit: float
    p_value: float
    covariance: Array


def covariance(views: Views, fit: Fit, marks: NDArray[np.intp] | None) -> tuple[Array, LackOfFit]:
    """Covariance of `Fit.estimate` from image noise and from lack of fit, and the test of the fit.

    `marks` has the number of the mark of each point. The errors of the points of a mark are
    correlated: in one view the corners of a square share its sides, and in all views a printed mark
    has the same error of its position. Without `marks` the points are independent.
    """
    residuals, jacobian = fit.residuals, fit.jacobian
    inverse = inverse_normal(jacobian)
    floor = views.rounding_variance(fit.poses)
    # Projections, not image points: a basis at noisy points would follow their noise.
    points = np.concatenate(views.image) + residuals.reshape(-1, 2)
    view = np.repeat(np.arange(len(views.image)), [len(image) for image in views.image])
    if marks is None:
        by_noise = inverse * views.residual_variance(fit)
    else:
        by_noise = group_jackknife(jacobian, inverse, residuals, marks) + inverse * floor
        each, label, size = np.unique(
            np.column_stack([view, marks]), axis=0, return_inverse=True, return_counts=True
        )
        if len(each) < len(points):  # the test takes the means over the points of each mark
            label, view = label.ravel(), each[:, 0]
            mean = csr_array((1 / size[label], (label, np.arange(len(label)))))
            points, residuals = mean @ points, (mean @ residuals.reshape(-1, 2)).ravel()
            jacobian = (mean @ jacobian.reshape(len(label), -1)).reshape(-1, jacobian.shape[1])
            inverse = inverse_normal(jacobian)
    basis = discrepancy_basis(points, view)
    test = lack_of_fit(residuals, jacobian, inverse, basis, floor)
    return by_noise + test.covariance, test


def discrepancy_basis(points: Array, view: NDArray[np.intp]) -> Array:
    """Basis (2 N, k) of the model discrepancy: displacements of N points that vary smoothly.

    For one view, the displacements are orthogonal polynomials of both coordinates. The norm of a
    column, 3 to the power of minus its degree, is the prior standard deviation of its coefficient.
    With equal norms, the stated error of the focal length under bending would be half as large. For
    several views, the basis has one block that is common to all views and one block for each view.
    A view of fewer than 24 points has no basis.
    """

    def smooth(points: Array) -> Array:
        terms, degrees = polynomial_basis(points, points_per_term=4)
        if degrees.max() < 2:
            return np.empty((2 * len(points), 0))
        return np.kron(np.linalg.qr(terms)[0] * 3.0**-degrees, np.eye(2))

    each = [smooth(points[view == v]) for v in np.unique(view)]
    if len(each) == 1:
        return each[0]
    return np.hstack([np.sqrt(len(each)) * smooth(points), block_diag(*each)])


def lack_of_fit(
    residuals: Array, jacobian: Array, inverse: Array, basis: Array, floor: float
) -> LackOfFit:
    """F test of residuals against a basis of the model discrepancy.

    The parameters follow each displacement B of the basis by (JᵀJ)⁻¹ JᵀB and leave (1 − H) B of it
    in the residuals, with H = J (JᵀJ)⁻¹ Jᵀ. The sum of squares of the residuals in the span of
    (1 − H) B is compared with the rest of them, which is noise. If it is significant at the level
    of 10 %, its excess over noise gives the amplitude a² = excess/‖(1 − H) B‖² of the discrepancy,
    and a² (JᵀJ)⁻¹ JᵀB BᵀJ (JᵀJ)⁻¹ is added to the covariance of the parameters.

    Parameters
    ----------
    residuals : ndarray, shape (m,)
        Residuals at the best fit, px.
    jacobian : ndarray, shape (m, p)
        Derivatives J of the residuals.
    inverse : ndarray, shape (p, p)
        (JᵀJ)⁻¹ as `inverse_normal` returns it.
    basis : ndarray, shape (m, k)
        Displacements B.
    floor : float
        Variance of the residuals by rounding, px².

    Returns
    -------
    LackOfFit
    """
    # Undetermined parameters follow nothing.
    followed: Array = np.where(np.isfinite(inverse), inverse, 0.0) @ (jacobian.T @ basis)
    left = basis - jacobian @ followed
    # The squares are quicker to decompose. A displacement is absorbed if less than 1e-4 of it is
    # left, far above the root of the rounding error.
    squares, axes = np.linalg.eigh(left.T @ left)
    kept = squares > 1e-8
    smooth_dof = int(kept.sum())
    noise_dof = len(residuals) - len(followed) - smooth_dof
    if smooth_dof == 0 or noise_dof <= 0:
        return LackOfFit(misfit=np.nan, p_value=1.0, covariance=np.zeros_like(inverse))
    smooth = float(((axes.T @ (left.T @ residuals))[kept] ** 2 / squares[kept]).sum())
    noise = max((float((residuals**2).sum()) - smooth) / noise_dof, floor)
    ratio = max(smooth / smooth_dof, floor) / noise  # one for residuals by rounding alone
    p_value = float(fdtrc(smooth_dof, noise_dof, ratio))
    excess = smooth - noise * smooth_dof if p_value < 1 / 10 else 0.0
    amplitude = excess / float((left**2).sum())
    return LackOfFit(
        misfit=float(np.sqrt(ratio)),
        p_value=p_value,
        covariance=amplitude * followed @ followed.T,
    )
