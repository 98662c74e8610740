"""Calibration of the image Jacobian and of a drift from small test moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microlib._common import Array

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
        Of the Jacobian's elements row by row, px²/µm²; enlarged by `misfit` if that is above 1.
    drift : ndarray, shape (2,)
        px/s while the stage stands.
    misfit : float
        χ² per degree of freedom under the covariances of the tracks: 1 if they explain the
        residuals.
    """

    jacobian: Array
    covariance: Array
    drift: Array
    misfit: float

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
        With the covariance of the Jacobian.
    """
    count = len(time)
    moved, later = position - position.mean(axis=0), time - time.mean()
    size = np.array([np.abs(moved).max() or 1.0] * 2 + [np.abs(later).max() or 1.0])
    columns = np.column_stack([moved, later]) / size
    basis = np.column_stack([np.ones(count), columns])  # 1, x, y, t in units of their range
    design = np.einsum("ij,nk->nijk", np.eye(2), basis).reshape(count, 2, -1)
    floor = _LEAST_STD**2 * np.eye(2)
    whitening = np.linalg.inv(np.linalg.cholesky(covariance + floor))
    matrix = (whitening @ design).reshape(2 * count, -1)
    values = np.einsum("nij,nj->ni", whitening, feature).ravel()
    found, _, rank, _ = np.linalg.lstsq(matrix, values, rcond=None)
    if rank < matrix.shape[1]:  # the stage never moved along an axis
        unknown = np.full(2, np.nan)
        return StageMotion(np.zeros((2, 2)), np.diag(np.full(4, np.inf)), unknown, float("nan"))
    misfit = float(np.sum((values - matrix @ found) ** 2)) / (len(values) - rank)
    spread = np.linalg.inv(matrix.T @ matrix) * max(1.0, misfit)
    slopes = found.reshape(2, 4)[:, 1:] / size
    elements = np.add.outer([0, 4], [1, 2]).ravel()  # those of J
    scale = np.tile(size[:2], 2)
    return StageMotion(
        jacobian=slopes[:, :2],
        covariance=spread[np.ix_(elements, elements)] / np.outer(scale, scale),
        drift=slopes[:, 2],
        misfit=misfit,
    )
