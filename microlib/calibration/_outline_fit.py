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

#: From parameters (n, p) to grey levels (n, k) and their derivatives (n, k, p).
Model = Callable[[Array], tuple[Array, Array]]

#: Where a fit starts: blur, px, and contrast as a part of the ground. Less blur and more contrast
#: do no harm (0.7, 0.9); an outline that starts with 2.5 px, or with a contrast of 0.3, may end in
#: a wrong minimum.
START_BLUR, START_CONTRAST = 1.2, 0.6
#: Least blur of a model, px: a sharper edge is a step between two pixels and has no derivative.
LEAST_BLUR = 0.05
#: First damping, of the normal matrix' diagonal; tenfold after a refused step, a tenth after a good
#: one. 1e-5 to 0.1, and factors from 3 to 30, find the same minima.
_FIRST_DAMPING, _FACTOR = 1e-3, 10.0
#: A parameter without any effect has at least this on the diagonal, so that it stays where it is.
_NO_EFFECT = 1e-12
#: An eigenvalue of a matrix of unit diagonal below this is none; rounding makes 1e-15 of it.
_SINGULAR = 1e-12
#: A parameter is not shared if its misfit, 1 ± √(2/freedom) by chance, is so many of these
#: deviations above 1. Without any sharing the error of rendered patterns is 1.6 times as large;
#: from 3 on there is no difference in renders, whose parameters are smooth: the limit is for lenses
#: whose blur is not.
_ROUGH = 6.0


@dataclass(frozen=True)
class Patches:
    """The pixels around each of n outlines, padded to the same number k.

    Parameters
    ----------
    x, y : ndarray, shape (n, k)
        Pixel coordinates relative to `centers`, px.
    grey : ndarray, shape (n, k)
        Grey levels.
    weight : ndarray, shape (n, k)
        One for a pixel, zero for padding.
    centers : ndarray, shape (n, 2)
        Integer origins of `x` and `y` in the image, px.
    """

    x: Array
    y: Array
    grey: Array
    weight: Array
    centers: Array


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
    centers: Array,
    half: int,
    choose: Callable[[Array, Array], NDArray[np.bool_]],
) -> Patches:
    """Cut a square of half-width `half` around each center and keep the pixels that `choose` wants.

    `choose` gets the (n, m) coordinates relative to the *rounded* centers. Pixels outside of the
    image are dropped.
    """
    origin = np.round(centers)
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
        centers=origin,
    )


def ground(patches: Patches, linear: Array) -> tuple[Array, Array]:
    """Local ground b₀ + b₁x + b₂y of each patch, and its derivatives by the three numbers."""
    basis = np.stack([np.ones_like(patches.x), patches.x, patches.y], axis=-1)
    return np.einsum("nkj,nj->nk", basis, linear), basis


def fit_outlines(
    model: Model, start: Array, patches: Patches, *, iterations: int = 15, tolerance: float = 1e-5
) -> OutlineFit:
    """Levenberg–Marquardt on every patch at once, each with its own damping.

    Parameters
    ----------
    model : callable
        From parameters (n, p) to grey levels (n, k) and their derivatives (n, k, p).
    start : ndarray, shape (n, p)
        Where to begin.
    patches : Patches
        What the model should look like.
    iterations : int
        Most steps that are tried. In renders of Table 5.1's views nine outlines of ten are at
        their minimum after 5 steps; the 3 % that still move after 15 are cut off by the border.
    tolerance : float
        The search ends as soon as a step changes no patch's sum of squares by more than this part
        of it, be it down or up. The last step then moved the outline by about √(tolerance·k) of its
        standard deviation for k pixels, a twentieth for 250; and the one not made is smaller still.

    Returns
    -------
    OutlineFit
        A patch that cannot be fitted, or still moves after all `iterations`, leaves the others
        alone; its covariance is NaN.
    """
    best = start.copy()
    damping = np.full(len(start), _FIRST_DAMPING)
    grey, jacobian = model(best)
    residual = (patches.grey - grey) * patches.weight
    cost = (residual**2).sum(axis=1)
    for _ in range(iterations):
        weighted = jacobian * patches.weight[..., None]
        normal = weighted.transpose(0, 2, 1) @ weighted
        gradient = (weighted.transpose(0, 2, 1) @ residual[..., None])[..., 0]
        damped = normal.copy()
        diagonal = np.maximum(np.einsum("npp->np", normal), _NO_EFFECT)
        np.einsum("npp->np", damped)[...] += damping[:, None] * diagonal
        trial = best + (_invert(damped) @ gradient[..., None])[..., 0]
        trial_grey, trial_jacobian = model(trial)
        trial_residual = (patches.grey - trial_grey) * patches.weight
        trial_cost = (trial_residual**2).sum(axis=1)
        change = np.abs(trial_cost - cost)
        # A step to NaN may become a good one with more damping; a patch at NaN is lost.
        moving = ~(change < tolerance * cost) & np.isfinite(cost)
        better = trial_cost < cost  # False for NaN
        pick = better[:, None]
        best = np.where(pick, trial, best)
        residual = np.where(pick, trial_residual, residual)
        jacobian = np.where(pick[..., None], trial_jacobian, jacobian)
        cost = np.where(better, trial_cost, cost)
        damping = np.where(better, damping / _FACTOR, damping * _FACTOR)
        if not moving.any():
            break
    weighted = jacobian * patches.weight[..., None]
    normal = weighted.transpose(0, 2, 1) @ weighted
    freedom = patches.weight.sum(axis=1) - start.shape[1]
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = np.where(freedom > 0, cost / freedom, np.nan)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite has failed
        covariance = _invert(normal) * variance[:, None, None]
    failed = moving | ~np.isfinite(covariance).all(axis=(1, 2))
    covariance[failed] = np.nan
    return OutlineFit(best, covariance, np.where(failed, np.nan, np.sqrt(variance)))


def smooth_parameters(fit: OutlineFit, centers: Array, columns: list[int]) -> OutlineFit:
    """Let the outlines of one image share what varies smoothly across it.

    The parameters in `columns` are replaced by a polynomial of the place in the image, fitted to
    all of them (quadratic from 12 outlines on, linear from 6 on, nothing below), and the others
    follow as their covariance says: this is the fit that would have been found, had the shared ones
    been known. A column whose values lie further from the polynomial than their errors explain is
    not shared.
    """
    # At least twice as many outlines as the polynomial has coefficients.
    degree = 2 if len(centers) >= 12 else 1 if len(centers) >= 6 else 0
    if degree == 0:
        return fit
    x, y = ((centers - centers.mean(axis=0)) / np.ptp(centers)).T
    basis = np.column_stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)])
    inverse = np.linalg.pinv(basis)
    freedom = len(basis) - basis.shape[1]
    smooth = basis @ (inverse @ fit.parameters)
    variance = np.einsum("npp->np", fit.covariance)
    misfit = ((fit.parameters - smooth) ** 2 / variance).sum(axis=0) / freedom
    columns = [k for k in columns if misfit[k] < 1 + _ROUGH * np.sqrt(2 / freedom)]
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


def _invert(matrices: Array) -> Array:
    """Inverse of each symmetric positive matrix after scaling to unit diagonal; NaN where
    singular."""
    scale = np.sqrt(np.maximum(np.einsum("npp->np", matrices), 1e-300))
    unit = matrices / scale[:, :, None] / scale[:, None, :]
    values, vectors = np.linalg.eigh(np.where(np.isfinite(unit), unit, 0.0))
    with np.errstate(divide="ignore"):
        inverse = np.where(values > _SINGULAR, 1 / values, np.nan)
    out = (vectors * inverse[:, None, :]) @ vectors.transpose(0, 2, 1)
    return out / scale[:, :, None] / scale[:, None, :]
