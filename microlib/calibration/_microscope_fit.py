"""Least squares behind :func:`microlib.calibration.calibrate`: starts, minimum, covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from microlib._common import Array, inverse_normal
from microlib.calibration._discrepancy import (
    Discrepancy,
    discrepancy,
    response,
    smooth_fields,
)
from microlib.calibration._radial_alignment import linear_intrinsics, radial_alignment
from microlib.microscope import Microscope, euler_rotation

#: What can be estimated; inside this module the focal length stands as its inverse, the power 1/f.
NAMES = ("magnification", "focal_length", "distortion", "alpha", "beta", "gamma", "tx", "ty")


#: Median of the absolute values to standard deviation, for normal errors.
_TO_SIGMA = 1.4826
#: Huber's bound in standard deviations, at which normal errors cost 5 % of efficiency.
_HUBER = 1.345
#: Exact data have no scale; then Huber's bound is held here, px.
_LEAST_SCALE = 1e-9
#: How often the scale is taken anew from the residuals. With errors of 2 px in one point of
#: 15, once leaves M up to 6 σ off its limit, twice 0.1 σ.
_RESCALED = 2
#: Relative changes at which the search ends: as far as rounding lets it come.
_TOLERANCE = 1e-15
#: Of more than twice so many marks the search begins with these alone: eight parameters of 2000
#: numbers leave it a fifteenth of the noise from the end, and two or three steps of ten.
_FEW = 1000
#: Error of a point that is given exactly, as a part of the largest coordinate: rounding makes
#: 1e-16 of it, another order of the same sums up to 1e-15. Nothing smaller decides anything.
_ROUNDING = 1e-13


@dataclass(frozen=True)
class Minimum:
    """One minimum: parameters (M, 1/f, κ, α, β, γ, T_x, T_y), cost, and the loss' scale in px (inf:
    linear)."""

    theta: Array
    cost: float
    scale: float


@dataclass(frozen=True)
class Problem:
    """World points (µm), image points from the principal point (px), cell (µm), free parameters."""

    world: Array
    seen: Array
    cell: Array
    free: NDArray[np.intp]

    def rounding(self, theta: Array) -> float:
        """Least variance of a coordinate, px²: points are not known better than they are
        written down."""
        largest = np.abs(theta[0] * self.world / self.cell).max()
        return float((_ROUNDING * max(largest, np.abs(self.seen).max())) ** 2)

    def residuals(self, theta: Array) -> Array:
        return self.at(theta)[0]

    def at(self, theta: Array) -> tuple[Array, Array]:
        """Residuals and their derivatives; h = M/(f (1 + M)) depends on two of the numbers."""
        seen, by = Microscope.project_plane(_visible(theta), self.world, self.cell)
        by = by.reshape(-1, 8)
        magnification, power = theta[:2]
        by_convergence = by[:, 1].copy()
        by[:, 0] += by_convergence * power / (1 + magnification) ** 2
        by[:, 1] = by_convergence * magnification / (1 + magnification)
        return (seen - self.seen).ravel(), by

    def fit(self, start: Array, loss: str) -> Minimum:
        """Least squares; for Huber's loss once more for each new scale from the residuals."""
        if len(self.world) > 2 * _FEW:
            start = self._of_few()._minimize(start, np.inf).theta
        fit = self._minimize(start, np.inf)
        if loss == "huber":
            for _ in range(_RESCALED):
                spread = _TO_SIGMA * np.median(np.abs(self.residuals(fit.theta)))
                fit = self._minimize(fit.theta, max(_HUBER * spread, _LEAST_SCALE))
        return fit

    def _of_few(self) -> Problem:
        """The problem of a random part of the marks: of every n-th, all might be on one line."""
        few = np.random.default_rng(0).choice(len(self.world), _FEW, replace=False)
        return replace(self, world=self.world[few], seen=self.seen[few])

    def _minimize(self, start: Array, scale: float) -> Minimum:
        def full(free: Array) -> Array:
            theta = start.copy()
            theta[self.free] = free
            return theta

        # The derivatives are asked for where the residuals were.
        @lru_cache(maxsize=1)
        def at(free: bytes) -> tuple[Array, Array]:
            return self.at(full(np.frombuffer(free)))

        robust = np.isfinite(scale)
        if not np.isfinite(self.residuals(start)).all():
            raise ValueError(
                "world and image must fit a microscope, got points that the nearest one images "
                "beyond the reach of its distortion"
            )
        solution = least_squares(
            lambda free: at(free.tobytes())[0],
            start[self.free],
            lambda free: at(free.tobytes())[1][:, self.free],
            method="trf" if robust else "lm",
            x_scale="jac",
            loss="huber" if robust else "linear",
            f_scale=scale if robust else 1.0,
            ftol=_TOLERANCE,
            xtol=_TOLERANCE,
            gtol=_TOLERANCE,
        )
        theta = full(solution.x)
        if theta[1] < 0:  # the same image, seen with the tilt turned over
            theta[[1, 4, 5]] *= -1
        return Minimum(theta, 2 * float(solution.cost), scale)

    def covariance(self, fit: Minimum, groups: Array | None) -> tuple[Array, int]:
        """Covariance of the free parameters (1/f, not f) and the degrees of freedom behind it.

        Independent, alike errors: the residual's variance times (JᵀJ)⁻¹, for Huber's loss by its
        asymptotic variance. Groups: the delete-one-group jackknife, in its closed form for a linear
        problem, which assumes nothing of the errors inside a group.
        """
        residuals, every = self.at(fit.theta)
        jacobian = every[:, self.free]
        score = np.clip(residuals, -fit.scale, fit.scale)
        # Mean second derivative of Huber's loss.
        kept = float(np.mean(np.abs(residuals) < fit.scale))
        inverse = inverse_normal(jacobian) / kept
        freedom = len(residuals) - len(self.free)
        rounding = inverse * self.rounding(fit.theta)
        if groups is None:
            return inverse * float(score @ score) / freedom / kept + rounding, freedom
        spread = jackknife(jacobian, score, inverse, groups, kept)
        return spread + rounding, len(np.unique(groups)) - 1

    def discrepancy(self, fit: Minimum, groups: Array | None) -> Discrepancy:
        """The smooth part of the residuals, of the groups' means where errors are correlated."""
        residuals, every = self.at(fit.theta)
        jacobian = every[:, self.free]
        score = np.clip(residuals, -fit.scale, fit.scale)
        # Where the model has the points: fields of the noisy ones would hold their noise.
        seen = self.seen + residuals.reshape(-1, 2)
        if groups is not None:
            _, label, count = np.unique(groups, return_inverse=True, return_counts=True)
            mean = np.zeros((len(count), len(label)))
            mean[label, np.arange(len(label))] = 1 / count[label]
            seen = mean @ seen
            score = (mean @ score.reshape(-1, 2)).ravel()
            jacobian = np.einsum("gn,ncp->gcp", mean, jacobian.reshape(-1, 2, len(self.free)))
            jacobian = jacobian.reshape(-1, len(self.free))
        return discrepancy(score, jacobian, smooth_fields(seen))


def axis_errors(
    jacobian: Array, residuals: Array, shifted: list[int], aside: float, rounding: float
) -> Array:
    """Covariance that an optical axis beside the sensor's middle makes.

    Parameters
    ----------
    jacobian : ndarray, shape (2 N, p)
        Derivatives of the residuals by the parameters.
    residuals : ndarray, shape (2 N,)
        px.
    shifted : list of int
        Parameters that count from the middle as ever, and have no error by it.
    aside : float
        Standard deviation of the axis, px. What of it the points would show against their residuals
        is no more in question.
    rounding : float
        Least variance of a residual, px².

    Returns
    -------
    ndarray, shape (p, p)
    """
    variance = float((residuals**2).mean()) + rounding
    shift = np.tile(np.eye(2), (len(residuals) // 2, 1))
    followed = response(jacobian, shift)
    shown = shift - jacobian @ followed
    left = aside**2 * np.linalg.inv(np.eye(2) + aside**2 * (shown.T @ shown) / variance)
    followed[shifted] = 0
    errors: Array = followed @ left @ followed.T
    return errors


def jackknife(
    jacobian: Array, score: Array, inverse: Array, groups: Array, kept: float = 1.0
) -> Array:
    """Covariance of least-squares parameters by leaving out one group of points after the other.

    Parameters
    ----------
    jacobian : ndarray, shape (2 N, p)
        Derivatives of the residuals.
    score : ndarray, shape (2 N,)
        Residuals, clipped as the loss does.
    inverse : ndarray, shape (p, p)
        Of the normal matrix; infinite and NaN where the points leave a parameter open, and then
        returned as it is.
    groups : ndarray, shape (N,)
        Group of each point.
    kept : float
        Mean second derivative of the loss.

    Returns
    -------
    ndarray, shape (p, p)
    """
    finite = np.where(np.isfinite(inverse), inverse, 0.0)
    members = [np.flatnonzero(groups.repeat(2) == g) for g in np.unique(groups)]
    totals = []
    for m in members:
        leverage = kept * jacobian[m] @ finite @ jacobian[m].T
        totals.append(jacobian[m].T @ np.linalg.solve(np.eye(len(m)) - leverage, score[m]))
    spread = finite @ np.transpose(totals)
    shrink = (len(members) - 1) / len(members)
    return np.where(np.isfinite(inverse), shrink * spread @ spread.T, inverse)


def _visible(theta: Array) -> Array:
    """(M, h, κ, α, β, γ, T_x, T_y) of a plane in focus."""
    return np.concatenate([[theta[0], theta[1] * theta[0] / (1 + theta[0])], theta[2:]])


def start_values(problem: Problem, focal_length: float | None) -> list[Array]:
    """Two starts, one for each sign of the tilt."""
    sensor = problem.seen * problem.cell
    alpha, beta, gamma, tx, ty = radial_alignment(problem.world, sensor)
    starts = []
    for sign in (1, -1):
        rotation = euler_rotation(alpha, sign * beta, sign * gamma)
        turned = problem.world @ rotation[:, :2].T
        flat, depth = turned[:, :2] + [tx, ty], turned[:, 2]
        if focal_length is not None:
            power = 1 / focal_length
            magnification, distortion, _ = linear_intrinsics(flat, np.zeros(len(flat)), sensor)
        else:
            magnification, distortion, convergence = linear_intrinsics(flat, depth, sensor)
            power = abs(convergence) * (1 + magnification) / magnification
        pose = [alpha, sign * beta, sign * gamma, tx, ty]
        starts.append(np.array([magnification, power, distortion, *pose]))
    return starts
