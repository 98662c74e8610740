"""Calibration of the image Jacobian and of a drift from small test moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microlib._common import Array, inverse_normal

#: Smallest standard deviation of a measured feature, px, so that frames without noise can be
#: weighted: the interpolation of a tracker is wrong by thousandths of a pixel.
_LEAST_STD = 1e-3

#: Largest relative error of the Jacobian, at three standard deviations. A step that J predicts
#: removes 1 − ‖ΔJ·J⁻¹‖ of the error: with this at least half.
MOST_RELATIVE_ERROR = 0.5


@dataclass(frozen=True, eq=False)
class StageMotion:
    """Motion of the feature with the stage, f = f₀ + J·x + drift·t.

    Attributes
    ----------
    jacobian : ndarray, shape (2, 2)
        px/µm.
    covariance : ndarray, shape (4, 4)
        Covariance of the Jacobian's elements row by row, px²/µm². It is multiplied by
        `reduced_chi2` if that is above 1.
    drift : ndarray, shape (2,)
        px/s while the stage stands.
    reduced_chi2 : float
        χ² per degree of freedom under the covariances of the tracks: 1 if they explain the
        residuals.
    """

    jacobian: Array
    covariance: Array
    drift: Array
    reduced_chi2: float

    @property
    def relative_error(self) -> float:
        """Three standard deviations of J in its worst direction over its least singular value."""
        least = np.linalg.svd(self.jacobian, compute_uv=False)[-1]
        if least == 0 or not np.isfinite(self.covariance).all():
            return float("inf")
        return float(3.0 * np.sqrt(np.linalg.eigvalsh(self.covariance)[-1]) / least)


#: The motion of a run without a calibration.
NOT_CALIBRATED = StageMotion(
    np.full((2, 2), np.nan), np.full((4, 4), np.nan), np.full(2, np.nan), float("nan")
)


def calibration_moves(size: float) -> Array:
    """Return the test moves: offsets from the start, out and back both ways along both axes, µm.

    The moves back separate the drift from the Jacobian: the displacement by the stage changes its
    sign, and the displacement by the drift does not.
    """
    x, y = np.array([size, 0.0]), np.array([0.0, size])
    return np.array([x, 0 * x, -x, 0 * x, y, 0 * y, -y, 0 * y])


def fit_motion(time: Array, position: Array, feature: Array, covariance: Array) -> StageMotion:
    """Fit Jacobian and drift to observations by weighted least squares.

    Parameters
    ----------
    time : ndarray, shape (N,)
        Of the exposures, s.
    position : ndarray, shape (N, 2)
        Of the stage by its encoder, µm.
    feature : ndarray, shape (N, 2)
        As measured, px.
    covariance : ndarray, shape (N, 2, 2)
        Of the measurements, px².

    Returns
    -------
    StageMotion
        The fitted motion, with the covariance of the Jacobian.
    """
    count = len(time)
    basis = np.column_stack([np.ones(count), position - position.mean(axis=0), time - time.mean()])
    design = np.einsum("ij,nk->nijk", np.eye(2), basis).reshape(count, 2, -1)
    floor = _LEAST_STD**2 * np.eye(2)
    whitening = np.linalg.inv(np.linalg.cholesky(covariance + floor))
    matrix = (whitening @ design).reshape(2 * count, -1)
    values = np.einsum("nij,nj->ni", whitening, feature).ravel()
    parameters = np.linalg.lstsq(matrix, values, rcond=None)[0]
    chi2 = float(np.sum((values - matrix @ parameters) ** 2))
    reduced_chi2 = chi2 / (len(values) - len(parameters))
    slopes = parameters.reshape(2, 4)[:, 1:]
    elements = np.add.outer([0, 4], [1, 2]).ravel()  # the parameters that are elements of J
    return StageMotion(
        jacobian=slopes[:, :2],
        # The variance of J is infinite if the stage never moved along an axis.
        covariance=inverse_normal(matrix)[np.ix_(elements, elements)] * max(1.0, reduced_chi2),
        drift=slopes[:, 2],
        reduced_chi2=reduced_chi2,
    )
