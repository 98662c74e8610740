"""Least-squares fit of blurred outlines to grey levels, many small patches at once.

A dark shape on a bright ground, seen through a Gaussian point-spread function, has the grey levels
B·(1 − c·F): B is the local ground (a plane), c the contrast, and F the part of the light that the
shape takes, a function of the distance to its outline. Fitting all of this to the grey levels
themselves uses every edge pixel with the weight that it deserves, so the error of the outline comes
close to the Cramér–Rao bound of the image noise.

The grey levels of separate marks add: where two lie close, both take light from the pixels between
them, and an outline that is fitted alone is drawn to its neighbor. So what the others take, as they
were fitted, is given back, and all are fitted again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from microlib._common import Array
from microlib.calibration._uncertainty import polynomial_basis
from microlib.calibration.detection._marks import Marks
from microlib.calibration.detection._settings import Settings

#: From parameters (n, p) and pixels x, y (n, k) to the part F of the light that the shape takes and
#: its derivatives by all parameters but contrast and ground, (n, k, p − 4).
Outline = Callable[[Array, Array, Array], tuple[Array, Array]]

#: Places of the parameters that every outline has at the end: blur, px; contrast as a part of the
#: ground; ground b₀ + b₁x + b₂y.
BLUR, CONTRAST, GROUND = -5, -4, slice(-3, None)
#: An eigenvalue of a matrix of unit diagonal below this is none; rounding makes 1e-15 of it. A
#: parameter without any effect has as much on the diagonal, so that it stays where it is.
_SINGULAR = 1e-12


class Rows:
    """Arrays of n rows each."""

    def __getitem__(self, index: NDArray) -> Self:
        """The rows that `index` picks."""
        return type(self)(*(each[index] for each in vars(self).values()))


@dataclass(frozen=True)
class Patches(Rows):
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
class OutlineFit(Rows):
    """Fitted parameters with what their accuracy is.

    Parameters
    ----------
    parameters : ndarray, shape (n, p)
        As the model defines them.
    covariance : ndarray, shape (n, p, p)
        From the residual's variance; NaN where the fit failed.
    rms : ndarray, shape (n,)
        Standard deviation of the residual, grey levels.
    centers : ndarray, shape (n, 2)
        Where the outlines' own coordinates begin in the image, px.
    """

    parameters: Array
    covariance: Array
    rms: Array
    centers: Array


def cut_patches(
    marks: Marks,
    half: float,
    distance: Callable[[Array, Array], Array],
    band: tuple[float, float],
) -> Patches:
    """Cut a square of half a width `half` around each mark; keep the pixels in a band.

    `distance` gets the (n, m) coordinates relative to the *rounded* centers; of what it returns,
    `band` has the least and the most, px. Pixels outside of the image are dropped.
    """
    origin = np.round(marks.centers)
    step = np.arange(-np.ceil(half), np.ceil(half) + 1)
    dx, dy = (axis.ravel()[None] for axis in np.meshgrid(step, step))
    column, row = origin[:, :1] + dx, origin[:, 1:] + dy
    height, width = marks.image.shape
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
        grey=marks.image.ravel()[place.astype(int)].astype(np.float64),
        weight=weight.astype(np.float64),
        centers=origin,
    )


def fit_shapes(
    outline: Outline, start: Array, patches: Patches, gap: float, settings: Settings
) -> OutlineFit:
    """Fit outlines that lie `gap` apart, px, which may be no further than their blur reaches."""
    start[:, BLUR], start[:, CONTRAST] = settings.start_blur, 2 / 3
    start[:, GROUND.start] = patches.grey.max(axis=1)
    fit = _fit_alone(outline, start, patches, settings)
    # Beyond two blurs a neighbor takes less than a fortieth of the light.
    if gap < 4 * np.median(np.abs(fit.parameters[:, BLUR])):
        # With a gap of 2.8 times the blur one is 0.085 px off without any round, then 0.0092 after
        # two, 0.0074 after three, and 0.0070 after six.
        for _ in range(3):
            grey = patches.grey + _taken(outline, fit, patches)
            fit = _fit_alone(outline, fit.parameters, replace(patches, grey=grey), settings)
    return fit


def _parts(
    outline: Outline, parameters: Array, patches: Patches
) -> tuple[Array, Array, Array, Array]:
    """The light on each pixel, the part of it that the shape takes, the derivatives of that, and
    those of the light by the three numbers of the ground."""
    basis = np.stack([np.ones_like(patches.x), patches.x, patches.y], axis=-1)
    light = np.einsum("nkj,nj->nk", basis, parameters[:, GROUND])
    return light, *outline(parameters, patches.x, patches.y), basis


def _taken(outline: Outline, fit: OutlineFit, patches: Patches) -> Array:
    """What their neighbors take from the pixels of each mark, grey levels."""
    centers = patches.centers
    distance, index = cKDTree(centers).query(centers, k=9)  # eight on a square lattice
    # The diagonal of a square of the lattice has √2, two steps of it 2.
    near = distance < np.sqrt(3) * np.median(distance[:, 1])  # infinite where there are no more
    taken = np.zeros_like(patches.x)
    for other, beside in zip(np.where(near, index, 0).T[1:], near.T[1:], strict=True):
        x, y = (centers - centers[other]).T[..., None]
        parameters = fit.parameters[other]
        there = replace(patches, x=patches.x + x, y=patches.y + y)
        light, inside, *_ = _parts(outline, parameters, there)
        known = beside & np.isfinite(fit.covariance[other, 0, 0])
        taken += np.where(known[:, None], light * inside * parameters[:, CONTRAST, None], 0.0)
    return taken * patches.weight


def _fit_alone(outline: Outline, start: Array, patches: Patches, settings: Settings) -> OutlineFit:
    """Levenberg–Marquardt on every patch at once, each with its own damping.

    A patch that cannot be fitted, or still moves after the last step, leaves the others alone; its
    covariance is NaN.
    """
    best = start.copy()
    damping = np.full(len(start), 1e-3)
    normal, gradient, cost = _equations(outline, best, patches)
    moving = np.isfinite(cost)  # a patch at NaN is lost
    for _ in range(settings.steps):
        if not moving.any():
            break
        some = np.flatnonzero(moving)
        damped = normal[some]
        diagonal = np.maximum(np.einsum("npp->np", damped), _SINGULAR)
        np.einsum("npp->np", damped)[...] += damping[some, None] * diagonal
        trial = best[some] + (_invert(damped) @ gradient[some, :, None])[..., 0]
        found = _equations(outline, trial, patches[some])
        better = found[2] < cost[some]  # False for NaN, from which more damping may lead away
        moving[some] = ~(np.abs(found[2] - cost[some]) < settings.settled * cost[some])
        damping[some] *= np.where(better, 1 / 10, 10)
        some = some[better]
        best[some] = trial[better]
        normal[some], gradient[some], cost[some] = (each[better] for each in found)
    freedom = patches.weight.sum(axis=1) - start.shape[1]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what is not finite failed
        variance = np.where(freedom > 0, cost / freedom, np.nan)
        covariance = _invert(normal) * variance[:, None, None]
    failed = moving | ~np.isfinite(covariance).all(axis=(1, 2))
    covariance[failed] = np.nan
    return OutlineFit(best, covariance, np.sqrt(variance), patches.centers)


def _equations(outline: Outline, parameters: Array, patches: Patches) -> tuple[Array, Array, Array]:
    """Normal matrices (n, p, p), right-hand sides (n, p) and sums of squares (n,)."""
    light, inside, by, basis = _parts(outline, parameters, patches)
    contrast = parameters[:, CONTRAST, None]
    residual = (patches.grey - light * (1 - contrast * inside)) * patches.weight
    jacobian = np.empty((*light.shape, parameters.shape[1]))
    jacobian[..., :CONTRAST] = -(light * contrast)[..., None] * by
    jacobian[..., CONTRAST] = -light * inside
    jacobian[..., GROUND] = basis * (1 - contrast * inside)[..., None]
    jacobian *= patches.weight[..., None]
    turned = jacobian.transpose(0, 2, 1)
    return turned @ jacobian, (turned @ residual[..., None])[..., 0], (residual**2).sum(axis=1)


def smooth_parameters(fit: OutlineFit, columns: list[int], settings: Settings) -> OutlineFit:
    """Let the outlines of one image share what varies smoothly across it.

    The parameters in `columns` are replaced by a polynomial of the place in the image, fitted to
    all of them (quadratic from 12 outlines on, linear from 6 on, nothing below), and the others
    follow as their covariance says: this is the fit that would have been found, had the shared ones
    been known. A column whose values lie further from the polynomial than their errors explain is
    not shared.
    """
    basis, degrees = polynomial_basis(fit.centers, points_per_term=2, max_degree=2)
    if degrees.max() == 0:
        return fit
    inverse = np.linalg.pinv(basis)
    freedom = len(basis) - basis.shape[1]
    smooth = basis @ (inverse @ fit.parameters)
    change = smooth - fit.parameters
    misfit = (change**2 / np.einsum("npp->np", fit.covariance)).sum(axis=0) / freedom
    columns = [k for k in columns if misfit[k] < 1 + settings.rough * np.sqrt(2 / freedom)]
    across = fit.covariance[:, :, columns]
    gain = across @ _invert(across[:, columns])
    # What an outline adds to the shared values itself is its leverage; that much of its own error
    # stays.
    leverage = np.einsum("ij,ji->i", basis, inverse)[:, None, None]
    return replace(
        fit,
        parameters=fit.parameters + (gain @ change[:, columns, None])[..., 0],
        covariance=fit.covariance - (1 - leverage) * (gain @ across.transpose(0, 2, 1)),
    )


def _invert(matrices: Array) -> Array:
    """Inverse of each symmetric positive matrix after scaling to unit diagonal; NaN where
    singular."""
    scale = np.sqrt(np.maximum(np.einsum("npp->np", matrices), np.finfo(float).tiny))
    unit = matrices / scale[:, :, None] / scale[:, None, :]
    values, vectors = np.linalg.eigh(np.where(np.isfinite(unit), unit, 0.0))
    with np.errstate(divide="ignore"):
        inverse = np.where(values > _SINGULAR, 1 / values, np.nan)
    out = (vectors * inverse[:, None, :]) @ vectors.transpose(0, 2, 1)
    return out / scale[:, :, None] / scale[:, None, :]


def band(marks: Marks, radius: float) -> tuple[tuple[float, float], float]:
    """The band around outlines of half a width `radius` that belongs to no neighbor, out to the
    middle of the gap: least and most distance, positive inside, px; and the gap."""
    distance, _ = cKDTree(marks.centers).query(marks.centers, k=2)
    half = float(np.median(distance[:, 1])) / 2 - radius
    # Across the middle of a narrow gap the corners would be 0.010 px off instead of 0.005.
    outer, inner = (max(min(half, marks.settings.widest), least) for least in (1.0, 2.0))
    return (-outer, inner), 2 * half
