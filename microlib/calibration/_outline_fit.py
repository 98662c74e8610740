"""Least-squares fit of blurred outlines to grey levels, many small patches at once.

A dark shape on a bright ground, seen through a Gaussian point-spread function, has the grey levels
B·(1 − c·F): B is the local ground (a plane), c the contrast, and F the part of the light that the
shape takes, a function of the distance to its outline. Fitting all of this to the grey levels
themselves uses every edge pixel with the weight that it deserves, so the error of the outline comes
close to the Cramér–Rao bound of the image noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array

__all__ = ["OutlineFit", "Patches", "cut_patches", "fit_outlines", "ground", "share"]

#: From parameters (n, p) to grey levels (n, k) and their derivatives (n, k, p).
Model = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True)
class Patches:
    """The pixels around each of n outlines, padded to the same number k.

    Parameters
    ----------
    x, y : ndarray, shape (n, k)
        Pixel coordinates relative to `centres`, px.
    grey : ndarray, shape (n, k)
        Grey levels.
    weight : ndarray, shape (n, k)
        One for a pixel, zero for padding.
    centres : ndarray, shape (n, 2)
        Integer origins of `x` and `y` in the image, px.
    """

    x: Array
    y: Array
    grey: Array
    weight: Array
    centres: Array


@dataclass(frozen=True)
class OutlineFit:
    """Fitted parameters with what their accuracy is.

    Parameters
    ----------
    parameters : ndarray, shape (n, p)
        As the model defines them.
    covariance : ndarray, shape (n, p, p)
        From the residual's variance; NaN where the fit failed.
    rms : ndarray, shape (n,)
        Standard deviation of the residual, grey levels; NaN where the fit failed.
    """

    parameters: Array
    covariance: Array
    rms: Array

    def __getitem__(self, index: NDArray[np.bool_]) -> OutlineFit:
        """The fits that `index` picks."""
        return OutlineFit(self.parameters[index], self.covariance[index], self.rms[index])


def cut_patches(
    image: NDArray[np.float32],
    centres: Array,
    half: int,
    choose: Callable[[Array, Array], NDArray[np.bool_]],
) -> Patches:
    """Cut a square of half-width `half` around each centre and keep the pixels that `choose` wants.

    `choose` gets the (n, m) coordinates relative to the *rounded* centres. Pixels outside of the
    image are dropped.
    """
    origin = np.round(centres)
    step = np.arange(-half, half + 1, dtype=np.float64)
    dx, dy = (axis.ravel()[None] for axis in np.meshgrid(step, step))
    column, row = origin[:, :1] + dx, origin[:, 1:] + dy
    height, width = image.shape
    keep = choose(np.broadcast_to(dx, column.shape), np.broadcast_to(dy, row.shape))
    keep = keep & (column >= 0) & (row >= 0) & (column < width) & (row < height)
    most = max(int(keep.sum(axis=1).max()), 1)
    order = np.argsort(~keep, axis=1, kind="stable")[:, :most]
    weight = np.take_along_axis(keep, order, axis=1)
    inside = np.where(weight, np.take_along_axis(row * width + column, order, axis=1), 0)
    return Patches(
        x=dx[0, order],
        y=dy[0, order],
        grey=image.ravel()[inside.astype(int)].astype(np.float64),
        weight=weight.astype(np.float64),
        centres=origin,
    )


def ground(patches: Patches, linear: Array) -> tuple[Array, Array]:
    """Local ground b₀ + b₁x + b₂y of each patch, and its derivatives by the three numbers."""
    basis = np.stack([np.ones_like(patches.x), patches.x, patches.y], axis=-1)
    return np.einsum("nkj,nj->nk", basis, linear), basis


def fit_outlines(
    model: Model, start: Array, patches: Patches, *, iterations: int = 15, tolerance: float = 1e-5
) -> OutlineFit:
    """Levenberg–Marquardt on every patch at once, until no parameter moves by `tolerance` of its σ
    scale.

    The damping is per patch: one that fails leaves the others alone and ends with NaN covariance.
    """
    best = start.copy()
    damping = np.full(len(start), 1e-3)
    grey, jacobian = model(best)
    residual = (patches.grey - grey) * patches.weight
    cost = (residual**2).sum(axis=1)
    for _ in range(iterations):
        weighted = jacobian * patches.weight[..., None]
        normal = weighted.transpose(0, 2, 1) @ weighted
        gradient = (weighted.transpose(0, 2, 1) @ residual[..., None])[..., 0]
        scale = np.maximum(np.einsum("npp->np", normal), 1e-12)
        step = _solve(
            normal + damping[:, None, None] * np.einsum("np,pq->npq", scale, _eye(scale)), gradient
        )
        trial = best + step
        trial_grey, trial_jacobian = model(trial)
        trial_residual = (patches.grey - trial_grey) * patches.weight
        trial_cost = (trial_residual**2).sum(axis=1)
        better = trial_cost < cost  # False for NaN
        pick = better[:, None]
        best = np.where(pick, trial, best)
        residual = np.where(pick, trial_residual, residual)
        jacobian = np.where(pick[..., None], trial_jacobian, jacobian)
        gained = cost - trial_cost
        cost = np.where(better, trial_cost, cost)
        damping = np.where(better, damping / 10, damping * 10)
        if (gained[better] < tolerance * cost[better]).all():
            break
    weighted = jacobian * patches.weight[..., None]
    normal = weighted.transpose(0, 2, 1) @ weighted
    freedom = patches.weight.sum(axis=1) - start.shape[1]
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = np.where(freedom > 0, cost / freedom, np.nan)
    covariance = _invert(normal) * variance[:, None, None]
    failed = ~np.isfinite(covariance).all(axis=(1, 2))
    return OutlineFit(best, covariance, np.where(failed, np.nan, np.sqrt(variance)))


def share(fit: OutlineFit, centres: Array, columns: list[int]) -> OutlineFit:
    """Let the outlines of one image share what varies smoothly across it.

    The parameters in `columns` are replaced by a polynomial of the place in the image, fitted to
    all of them (quadratic from 12 outlines on, linear from 6 on, nothing below), and the others
    follow as their covariance says: this is the fit that would have been found, had the shared ones
    been known. A column whose values lie further from the polynomial than their errors explain is
    not shared.
    """
    degree = 2 if len(centres) >= 12 else 1 if len(centres) >= 6 else 0
    if degree == 0:
        return fit
    x, y = ((centres - centres.mean(axis=0)) / np.ptp(centres)).T
    basis = np.column_stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)])
    inverse = np.linalg.pinv(basis)
    freedom = len(basis) - basis.shape[1]
    smooth = basis @ (inverse @ fit.parameters)
    variance = np.einsum("npp->np", fit.covariance)
    misfit = ((fit.parameters - smooth) ** 2 / variance).sum(axis=0) / freedom
    # Chance alone spreads the misfit by √(2/freedom) around 1; six times that is no chance.
    columns = [k for k in columns if misfit[k] < 1 + 6 * np.sqrt(2 / freedom)]
    if not columns:
        return fit
    across = fit.covariance[:, :, columns]
    gain = across @ _invert(across[:, columns])
    # What an outline adds to the shared values itself is its leverage; that much of its own error
    # stays.
    leverage = np.einsum("ij,ji->i", basis, inverse)[:, None, None]
    change = (smooth - fit.parameters)[:, columns]
    return OutlineFit(
        fit.parameters + (gain @ change[..., None])[..., 0],
        fit.covariance - (1 - leverage) * (gain @ across.transpose(0, 2, 1)),
        fit.rms,
    )


def _eye(like: Array) -> Array:
    return np.eye(like.shape[1])


def _solve(matrices: Array, vectors: Array) -> Array:
    return (_invert(matrices) @ vectors[..., None])[..., 0]


def _invert(matrices: Array) -> Array:
    """Inverse of each symmetric positive matrix after scaling to unit diagonal; NaN where
    singular."""
    scale = np.sqrt(np.maximum(np.einsum("npp->np", matrices), 1e-300))
    unit = matrices / scale[:, :, None] / scale[:, None, :]
    values, vectors = np.linalg.eigh(np.where(np.isfinite(unit), unit, 0.0))
    with np.errstate(divide="ignore"):
        inverse = np.where(values > 1e-12, 1 / values, np.nan)
    out = (vectors * inverse[:, None, :]) @ vectors.transpose(0, 2, 1)
    return out / scale[:, :, None] / scale[:, None, :]
