"""Least-squares fit of blurred outlines to grey levels, in many small patches at once.

The image of a dark shape on a bright background under a Gaussian point-spread function has the grey
levels B·(1 − c·F). B is the local background (a plane), c the contrast, and F the coverage of a
pixel by the shape, a function of the distance to its outline. A fit of the grey levels uses every
pixel of the edge with its weight, and the error of the outline comes close to the Cramér–Rao bound
of the image noise.

The blurred images of close neighbors overlap, which biases an outline that is fitted alone towards
its neighbor. The light that the neighbors take, by their fits, is therefore added to the grey
levels, and all outlines are fitted again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from microlib._common import Array, NormalEquations, gauss_newton, inverse_symmetric
from microlib.calibration._polynomials import polynomial_basis
from microlib.calibration.detection._marks import Rows
from microlib.calibration.detection._settings import DetectionSettings

#: From parameters (n, p) and pixels x, y (n, k) to the coverage F of the pixels and its derivatives
#: by all parameters except contrast and background, (n, k, p − 4).
Outline = Callable[[Array, Array, Array], tuple[Array, Array]]

#: Indices of the parameters that every outline has at its end: blur, px; contrast, relative to the
#: background; background b₀ + b₁x + b₂y, and its slopes b₁ and b₂.
BLUR, CONTRAST, GROUND, SLOPES = -5, -4, slice(-3, None), (-2, -1)


@dataclass(frozen=True)
class Patches(Rows):
    """Pixels around each of n outlines, padded to the same number k.

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
class OutlineFit(Rows):
    """Fitted parameters of n outlines with their covariance.

    Parameters
    ----------
    parameters : ndarray, shape (n, p)
        Parameters of the model.
    covariance : ndarray, shape (n, p, p)
        Covariance from the variance of the residuals; NaN where the fit failed.
    rms : ndarray, shape (n,)
        Standard deviation of the residuals, grey levels.
    centers : ndarray, shape (n, 2)
        Origins of the coordinates of the outlines in the image, px.
    """

    parameters: Array
    covariance: Array
    rms: Array
    centers: Array


def cut_patches(
    grey: NDArray[np.float32],
    centers: Array,
    half: float,
    distance: Callable[[Array, Array], Array],
    band: tuple[float, float],
) -> Patches:
    """Pixels of the image in a band along the outline of each mark.

    Squares of half-width `half` around the rounded centers are searched, px. `distance` is a
    function of coordinates from there, (n, m), and `band` has its limits.
    """
    origin = np.round(centers)
    step = np.arange(-np.ceil(half), np.ceil(half) + 1)
    dx, dy = (axis.ravel()[None] for axis in np.meshgrid(step, step))
    column, row = origin[:, :1] + dx, origin[:, 1:] + dy
    height, width = grey.shape
    inside = distance(np.broadcast_to(dx, column.shape), np.broadcast_to(dy, row.shape))
    keep = (inside >= band[0]) & (inside <= band[1])
    keep &= (column >= 0) & (row >= 0) & (column < width) & (row < height)
    most = max(int(keep.sum(axis=1).max()), 1)
    order = np.argsort(~keep, axis=1, kind="stable")[:, :most]
    weight = np.take_along_axis(keep, order, axis=1)
    place = np.where(weight, np.take_along_axis(row * width + column, order, axis=1), 0)
    return Patches(
        x=dx[0, order],
        y=dy[0, order],
        grey=grey.ravel()[place.astype(int)].astype(np.float64),
        weight=weight.astype(np.float64),
        centers=origin,
    )


def fit_shapes(
    outline: Outline, start: Array, patches: Patches, gap: float, settings: DetectionSettings
) -> OutlineFit:
    """Fit outlines with gaps of `gap`, px, between them, and allow for overlapping blur."""
    start[:, BLUR], start[:, CONTRAST] = settings.initial_blur, 2 / 3
    start[:, GROUND.start] = patches.grey.max(axis=1)
    fit = _fit_alone(outline, start, patches, settings)
    # At two blurs from its outline, a neighbor takes less than a fortieth of the light.
    if gap < 4 * np.median(np.abs(fit.parameters[:, BLUR])):
        for _ in range(settings.neighbor_iterations):
            grey = patches.grey + _neighbor_light(outline, fit, patches)
            fit = _fit_alone(outline, fit.parameters, replace(patches, grey=grey), settings)
    return fit


def _parts(
    outline: Outline, parameters: Array, patches: Patches
) -> tuple[Array, Array, Array, Array]:
    """Background and coverage of each pixel, the derivatives of the coverage, and those of the
    background by its three parameters."""
    basis = np.stack([np.ones_like(patches.x), patches.x, patches.y], axis=-1)
    light = np.einsum("nkj,nj->nk", basis, parameters[:, GROUND])
    return light, *outline(parameters, patches.x, patches.y), basis


def _neighbor_light(outline: Outline, fit: OutlineFit, patches: Patches) -> Array:
    """Light that the neighbors of each mark take from its pixels, grey levels.

    Without it, corners of drawn squares with gaps of 3 px err by 0.061 instead of 0.010 px, which
    is 2.5 of their stated standard deviations. Centers of drawn circles with gaps of 1.5 to 4 blurs
    err by 1.4 to 3 of them, and residuals below one standard deviation do not show it. No point of
    48 photographs changes.
    """
    centers = patches.centers
    distance, index = cKDTree(centers).query(centers, k=9)  # eight on a square lattice
    # Diagonal neighbors are √2 steps away, and the next ones 2.
    near = distance < np.sqrt(3) * np.median(distance[:, 1])  # infinite where there are no more
    taken = np.zeros_like(patches.x)
    for other, adjoining in zip(np.where(near, index, 0).T[1:], near.T[1:], strict=True):
        x, y = (centers - centers[other]).T[..., None]
        parameters = fit.parameters[other]
        shifted = replace(patches, x=patches.x + x, y=patches.y + y)
        light, inside, *_ = _parts(outline, parameters, shifted)
        fitted = adjoining & np.isfinite(fit.covariance[other, 0, 0])
        taken += np.where(fitted[:, None], light * inside * parameters[:, CONTRAST, None], 0.0)
    return taken * patches.weight


def _fit_alone(
    outline: Outline, start: Array, patches: Patches, settings: DetectionSettings
) -> OutlineFit:
    """Fit every outline without its neighbors. The covariance is NaN where a fit fails."""

    def linearize(parameters: Array, numbers: NDArray[np.intp]) -> NormalEquations:
        return _normal_equations(outline, parameters, patches[numbers])

    parameters, equations, converged = gauss_newton(
        linearize,
        start,
        max_iterations=settings.max_iterations,
        cost_tolerance=settings.cost_tolerance,
    )
    dof = patches.weight.sum(axis=1) - start.shape[1]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        variance = np.where(dof > 0, equations.cost / dof, np.nan)
        covariance = inverse_symmetric(equations.matrix) * variance[:, None, None]
    covariance[~(converged & np.isfinite(covariance).all(axis=(1, 2)))] = np.nan
    return OutlineFit(parameters, covariance, np.sqrt(variance), patches.centers)


def _normal_equations(outline: Outline, parameters: Array, patches: Patches) -> NormalEquations:
    """Normal equations of the grey levels of each patch."""
    light, inside, by, basis = _parts(outline, parameters, patches)
    contrast = parameters[:, CONTRAST, None]
    residual = (patches.grey - light * (1 - contrast * inside)) * patches.weight
    jacobian = np.empty((*light.shape, parameters.shape[1]))
    jacobian[..., :CONTRAST] = -(light * contrast)[..., None] * by
    jacobian[..., CONTRAST] = -light * inside
    jacobian[..., GROUND] = basis * (1 - contrast * inside)[..., None]
    jacobian *= patches.weight[..., None]
    turned = jacobian.transpose(0, 2, 1)
    right = (turned @ residual[..., None])[..., 0]
    return NormalEquations(turned @ jacobian, right, (residual**2).sum(axis=1))


def smooth_parameters(
    fit: OutlineFit, columns: Sequence[int], settings: DetectionSettings
) -> OutlineFit:
    """Replace parameters of all outlines by smooth functions of the place in the image.

    Each parameter in `columns` is replaced by a polynomial of the outlines' centers: quadratic for
    12 outlines or more, linear for 6 or more, unchanged for fewer. The other parameters follow by
    conditioning a normal distribution (a Kalman update without observation noise). With the
    replaced parameters S, their polynomial s, and its leverage h at the outline,

        θ ← θ + K (s − θ_S),   C ← C − (1 − h) K C_S,   K = C_Sᵀ C_SS⁻¹,

    where C_S are the rows S of C. The factor 1 − h allows for the error of s, to which the outline
    itself contributes h. A parameter is not replaced if its χ² against the polynomial is too large.
    """
    basis, degrees = polynomial_basis(fit.centers, points_per_term=2, max_degree=2)
    if degrees.max() == 0:
        return fit
    pseudoinverse = np.linalg.pinv(basis)
    dof = len(basis) - basis.shape[1]
    change = basis @ (pseudoinverse @ fit.parameters) - fit.parameters
    reduced_chi2 = (change**2 / np.einsum("npp->np", fit.covariance)).sum(axis=0) / dof
    limit = 1 + settings.max_chi2_deviation * np.sqrt(2 / dof)
    replaced = [k for k in columns if reduced_chi2[k] < limit]
    covariance = fit.covariance[:, :, replaced]
    gain = covariance @ inverse_symmetric(covariance[:, replaced])
    leverage = np.einsum("ij,ji->i", basis, pseudoinverse)[:, None, None]
    return replace(
        fit,
        parameters=fit.parameters + (gain @ change[:, replaced, None])[..., 0],
        covariance=fit.covariance - (1 - leverage) * (gain @ covariance.transpose(0, 2, 1)),
    )


def band(
    centers: Array, radius: float, settings: DetectionSettings
) -> tuple[tuple[float, float], float]:
    """Limits of the distance to an outline of half-width `radius`, positive inside, of the pixels
    up to the middle of the gap to the next mark, and the gap, px."""
    distance, _ = cKDTree(centers).query(centers, k=2)
    half = float(np.median(distance[:, 1])) / 2 - radius
    outer, inner = (max(min(half, settings.max_band), least) for least in settings.min_band)
    return (-outer, inner), 2 * half
