"""Lack-of-fit test of a calibration, and the covariance by the model discrepancy.

Image noise differs from point to point. An error of the model, such as a missing distortion term or
a bent pattern, displaces neighboring points alike (a model discrepancy in the sense of Kennedy and
O'Hagan, 2001). The part of it that the parameters absorb leaves no residual and is an error of the
parameters. Its size is estimated from the part that they do not absorb.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.sparse import csr_array
from scipy.special import fdtrc

from microlib._common import Array, inverse_normal
from microlib.calibration._fit import Fit, Photographs
from microlib.calibration._polynomials import polynomial_basis


@dataclass(frozen=True, eq=False)
class LackOfFit:
    """Test of the residuals for a smooth part, and what this part adds to the covariance.

    Parameters
    ----------
    lack_of_fit : float
        Root of the F ratio: size of the smooth part over its size by noise. About one for an
        adequate model, NaN for too few points.
    p_value : float
        Probability of a larger ratio by noise alone; one for too few points.
    covariance : ndarray, shape (p, p)
        Covariance of the parameters by the model discrepancy.
    """

    lack_of_fit: float
    p_value: float
    covariance: Array


def check_fit(
    photographs: Photographs, fit: Fit, mark_numbers: NDArray[np.intp] | None
) -> LackOfFit:
    """Test of the residuals of a fit for lack of fit, with the means over the points of a mark.

    `mark_numbers` has the number of the mark of each point, see `noise_covariance`.
    """
    residuals, jacobian = fit.residuals, fit.jacobian
    # Projections, not image points: a basis at noisy points would follow their noise.
    points = np.concatenate(photographs.image) - residuals.reshape(-1, 2)
    view = np.repeat(np.arange(len(photographs.image)), [len(image) for image in photographs.image])
    if mark_numbers is not None:
        each, label, size = np.unique(
            np.column_stack([view, mark_numbers]), axis=0, return_inverse=True, return_counts=True
        )
        if len(each) < len(points):
            label, view = label.ravel(), each[:, 0]
            mean = csr_array((1 / size[label], (label, np.arange(len(label)))))
            points, residuals = mean @ points, (mean @ residuals.reshape(-1, 2)).ravel()
            jacobian = (mean @ jacobian.reshape(len(label), -1)).reshape(-1, jacobian.shape[1])
    basis = discrepancy_basis(points, view)
    floor = photographs.rounding_variance(fit.poses)
    return f_test(residuals, jacobian, inverse_normal(jacobian), basis, floor)


def discrepancy_basis(points: Array, view: NDArray[np.intp]) -> Array:
    """Basis (2 N, k) of the model discrepancy: displacements of N points that vary smoothly.

    For one view, the displacements are orthogonal polynomials of both coordinates. The norm of a
    column, 3 to the power of minus its degree, is the prior standard deviation of its coefficient.
    With equal norms, the stated error of the focal length under bending would be half as large. For
    several views, the basis has one block that is common to all views and one block for each view.
    A view of fewer than 24 points has no block of its own.
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


def f_test(
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
        Image points minus their projection at the best fit, px.
    jacobian : ndarray, shape (m, p)
        Derivatives J of the projection.
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
    # Shifts of the parameters by each displacement; undetermined parameters do not shift.
    shifts: Array = np.where(np.isfinite(inverse), inverse, 0.0) @ (jacobian.T @ basis)
    remainder = basis - jacobian @ shifts
    # The squares are quicker to decompose. A displacement is absorbed if less than 1e-4 of it is
    # left, far above the root of the rounding error.
    squares, axes = np.linalg.eigh(remainder.T @ remainder)
    kept = squares > 1e-8
    smooth_dof = int(kept.sum())
    noise_dof = len(residuals) - len(shifts) - smooth_dof
    if smooth_dof == 0 or noise_dof <= 0:
        return LackOfFit(lack_of_fit=np.nan, p_value=1.0, covariance=np.zeros_like(inverse))
    smooth = float(((axes.T @ (remainder.T @ residuals))[kept] ** 2 / squares[kept]).sum())
    noise = max((float((residuals**2).sum()) - smooth) / noise_dof, floor)
    ratio = max(smooth / smooth_dof, floor) / noise  # one for residuals by rounding alone
    p_value = float(fdtrc(smooth_dof, noise_dof, ratio))
    excess = smooth - noise * smooth_dof if p_value < 1 / 10 else 0.0
    amplitude = excess / float((remainder**2).sum())
    return LackOfFit(
        lack_of_fit=float(np.sqrt(ratio)),
        p_value=p_value,
        covariance=amplitude * shifts @ shifts.T,
    )
