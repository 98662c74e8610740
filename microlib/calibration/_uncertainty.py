"""How well parameters are known: their covariance, what a model's lack adds, and the bound.

Noise differs from point to point. A distortion that the model lacks, a bent target or a shifted
optical axis displaces neighbors alike. Such a displacement is seen where the model cannot follow
it, and is as large, presumably, where the model can: there it is an error of the parameters that no
residual shows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag
from scipy.sparse import csr_array
from scipy.special import fdtrc, stdtrit

from microlib._common import Array, inverse_normal, of_kind, scalar
from microlib.calibration._views import Fit, Views
from microlib.microscope import Microscope

#: A kilometer, µm: nothing is calibrated beyond, and the fits lose their way there. No noise in px
#: is larger.
FARTHEST = 1e9


def cramer_rao(
    microscope: Microscope, world: ArrayLike, noise: float, parameters: tuple[str, ...]
) -> Array:
    """Smallest covariance any unbiased estimate of `parameters` can have.

    Parameters
    ----------
    microscope : Microscope
        The truth.
    world : array_like, shape (N, 2)
        Points of the pattern plane, µm.
    noise : float
        Standard deviation of each coordinate of the image points, px.
    parameters : tuple of str
        What is estimated together, see :meth:`microlib.microscope.Microscope.jacobian`; the others
        are known.

    Returns
    -------
    ndarray, shape (p, p)
        (JᵀJ)⁻¹ σ²; infinite variances, and NaN beside them, for the parameters that take part in a
        direction the points do not determine.

    Raises
    ------
    ValueError
        If `world` or `noise` is not what it should be, a point is beyond the reach of the
        distortion model, or a name is unknown.

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
    of_kind("microscope", microscope, Microscope)
    noise = scalar("noise", noise, least=0, most=FARTHEST)
    jacobian = microscope.jacobian(world, parameters).reshape(-1, len(parameters))
    if not np.isfinite(jacobian).all():
        raise ValueError("world must be points that the microscope sees, got some that it cannot")
    inverse = inverse_normal(jacobian)
    with np.errstate(invalid="ignore"):  # what is open stays so without noise, too
        return np.where(np.isinf(inverse), np.inf, noise**2 * inverse)


def student(freedom: float, level: float = 0.95) -> float:
    """Half the width of an interval, in standard deviations that so many residuals tell."""
    return float(stdtrit(freedom, (1 + level) / 2))


def inverse_interval(value: float, reach: float) -> tuple[float, float]:
    """Ends of the interval of a positive quantity whose inverse has the normal error.

    `reach` is how far the inverse may be off, as a part of it; where that may be zero, the quantity
    has no upper end.
    """
    return value / (1 + reach), np.inf if reach >= 1 else value / (1 - reach)


def jackknife(jacobian: Array, inverse: Array, residuals: Array, groups: NDArray) -> Array:
    """Covariance of least-squares parameters by leaving out one group of points after the other.

    In its closed form for a linear problem; it assumes nothing of the errors inside a group.

    Parameters
    ----------
    jacobian : ndarray, shape (2 N, p)
        Derivatives of the residuals.
    inverse : ndarray, shape (p, p)
        What `inverse_normal` makes of them.
    residuals : ndarray, shape (2 N,)
        px.
    groups : ndarray, shape (N,)
        Group of each point.

    Returns
    -------
    ndarray, shape (p, p)
        Infinite and NaN where the points leave a parameter open.
    """
    finite = np.where(np.isfinite(inverse), inverse, 0.0)
    order = np.argsort(np.repeat(groups, 2), kind="stable")
    ends = np.cumsum(2 * np.unique(groups, return_counts=True)[1])[:-1]
    totals = []
    for m in np.split(order, ends):
        leverage = jacobian[m] @ finite @ jacobian[m].T
        totals.append(jacobian[m].T @ np.linalg.solve(np.eye(len(m)) - leverage, residuals[m]))
    spread = finite @ np.transpose(totals)
    shrink = len(ends) / (len(ends) + 1)
    return np.where(np.isfinite(inverse), shrink * spread @ spread.T, inverse)


def monomials(places: Array, share: int, most: int = 4) -> tuple[Array, Array]:
    """Products xⁱ yʲ, (..., terms), the lower ones first, of places (..., 2) about their middle in
    units of their extent; and the degrees i + j.

    These go up to the highest, `most` at most, of which the places are `share` times as many as the
    (d + 1)(d + 2)/2 terms.
    """
    about = (places - places.reshape(-1, 2).mean(axis=0)) / np.ptp(places)
    x, y = np.moveaxis(about, -1, 0)
    last = sum(2 * len(places) >= share * (d + 1) * (d + 2) for d in range(1, most + 1))
    powers = np.array([(i, total - i) for total in range(last + 1) for i in range(total + 1)])
    return np.stack([x**i * y**j for i, j in powers], axis=-1), powers.sum(axis=1)


def smooth_fields(points: Array) -> Array:
    """Displacements that vary smoothly over the points, (2N, k), each as long as it is likely.

    Orthogonal polynomials of both coordinates, of length 1, 1/3, 1/9 … by their degree; none for
    fewer than 24 points. The terms of a lens and of a bent plate fall so, as far as they are known;
    with terms that do not fall, a bend hidden in the focal length is stated half as large.
    """
    terms, degrees = monomials(points, 4)  # as many residuals for each
    if degrees.max() < 2:
        return np.empty((2 * len(points), 0))
    return np.kron(np.linalg.qr(terms)[0] * 3.0**-degrees, np.eye(2))


def covariance(
    views: Views, fit: Fit, marks: NDArray[np.intp] | None
) -> tuple[Array, float, float]:
    """How well the points tell what was fitted, of the focal length its inverse: by noise, and by
    what the model lacks; the misfit, and the chance of so much by noise alone.

    Of a mark the errors are correlated. The misfit is that of the means over its points in a view.
    """
    residuals, jacobian = fit.residuals, fit.jacobian
    rounding, inverse = views.rounding(fit.poses), inverse_normal(jacobian)
    # Where the model has the points: fields of the noisy ones would hold their noise.
    points = np.concatenate(views.seen) + residuals.reshape(-1, 2)
    view = np.repeat(np.arange(len(views.seen)), [len(seen) for seen in views.seen])
    by_noise = inverse * views.variance(fit)
    if marks is not None:
        by_noise = jackknife(jacobian, inverse, residuals, marks) + inverse * rounding
        both = np.column_stack([view, marks])
        each, label, size = np.unique(both, axis=0, return_inverse=True, return_counts=True)
        label, view = label.ravel(), each[:, 0]
        mean = csr_array((1 / size[label], (label, np.arange(len(label)))))
        points, residuals = mean @ points, (mean @ residuals.reshape(-1, 2)).ravel()
        jacobian = (mean @ jacobian.reshape(len(label), -1)).reshape(-1, jacobian.shape[1])
        inverse = inverse_normal(jacobian)
    fields = [smooth_fields(points[view == v]) for v in range(len(views.seen))]
    if len(fields) > 1:  # those in common: each view has the length that it has in one of its own
        common = np.sqrt(len(fields)) * smooth_fields(points)
        fields = [np.hstack([common, block_diag(*fields)])]
    misfit, chance, by_lack = discrepancy(residuals, jacobian, inverse, fields[0], rounding)
    return by_noise + by_lack, misfit, chance


def discrepancy(
    residuals: Array, jacobian: Array, inverse: Array, fields: Array, rounding: float
) -> tuple[float, float, Array]:
    """Test residuals for a smooth part, and carry it to the parameters.

    Parameters
    ----------
    residuals : ndarray, shape (m,)
        At the best fit, px.
    jacobian : ndarray, shape (m, p)
        Their derivatives by the parameters.
    inverse : ndarray, shape (p, p)
        What `inverse_normal` makes of them.
    fields : ndarray, shape (m, k)
        Smooth displacements.
    rounding : float
        Variance of residuals that is no more than rounding, px².

    Returns
    -------
    misfit : float
        Size of the smooth part over what noise makes of it: about one for a model that fits; NaN
        where there are too few points to tell.
    chance : float
        Probability of so much by noise alone; one where there are too few points.
    covariance : ndarray, shape (p, p)
        What it adds to that of the parameters.
    """
    # Parameters that the points leave open follow nothing.
    followed: Array = np.where(np.isfinite(inverse), inverse, 0.0) @ (jacobian.T @ fields)
    seen = fields - jacobian @ followed
    # Of squares, which are quicker than the fields themselves: what is followed lies far above the
    # root of rounding. One that is followed but for 1e-4 shows nothing.
    size, axes = np.linalg.eigh(seen.T @ seen)
    shown = size > 1e-8
    free = int(shown.sum())
    freedom = len(residuals) - len(followed) - free
    if free == 0 or freedom <= 0:
        return np.nan, 1.0, np.zeros((len(followed), len(followed)))
    smooth = float(((axes.T @ (seen.T @ residuals))[shown] ** 2 / size[shown]).sum())
    noise = max((float((residuals**2).sum()) - smooth) / freedom, rounding)
    ratio = max(smooth / free, rounding) / noise  # one where there is nothing but rounding
    chance = float(fdtrc(free, freedom, ratio))
    # What noise makes often enough is taken for noise.
    excess = smooth - noise * free if chance < 1 / 10 else 0.0
    amplitude = excess / float((seen**2).sum())
    return float(np.sqrt(ratio)), chance, amplitude * followed @ followed.T
