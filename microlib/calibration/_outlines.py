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

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from microlib._common import Array
from microlib.calibration._marks import Marks

#: From parameters (n, p) and pixels x, y (n, k) to the part F of the light that the shape takes and
#: its derivatives by all parameters but contrast and ground, (n, k, p − 4).
Outline = Callable[[Array, Array, Array], tuple[Array, Array]]

#: Places of the parameters that every outline has at the end: blur, px; contrast as a part of the
#: ground; ground b₀ + b₁x + b₂y.
BLUR, CONTRAST, GROUND = -5, -4, slice(-3, None)
#: Blur, px, and contrast with which a fit starts. Less blur does no harm, 2.5 px may end in a wrong
#: minimum; more contrast does no harm (0.9), 0.3 may end in one.
START_BLUR, _START_CONTRAST = 1.2, 0.6
#: Least blur of a model, px: a sharper edge is a step between two pixels and has no derivative.
LEAST_BLUR = 0.05
#: First damping, of the normal matrix' diagonal; tenfold after a refused step, a tenth after a good
#: one. 1e-5 to 0.1, and factors from 3 to 30, find the same minima.
_FIRST_DAMPING, _FACTOR = 1e-3, 10.0
#: Most steps of a fit. In renders of Table 5.1's views nine outlines of ten are at their minimum
#: after 5; of photographed circles one in ten needs more than 15, and of corners of photographed
#: chessboards one in five more than 25.
STEPS = 50
#: The search for an outline ends as soon as a step changes its sum of squares by no more than this
#: part of it, be it down or up. The last step then moved the outline by about √(1e-6 k) of its
#: standard deviation for k pixels, a sixtieth for 250; and the one not made is smaller still.
_SETTLED = 1e-6
#: A parameter without any effect has at least this on the diagonal, so that it stays where it is.
_NO_EFFECT = 1e-12
#: An eigenvalue of a matrix of unit diagonal below this is none; rounding makes 1e-15 of it.
_SINGULAR = 1e-12
#: A parameter is not shared if its misfit, 1 ± √(2/freedom) by chance, is so many of these
#: deviations above 1. Without any sharing the error of rendered patterns is 1.6 times as large;
#: from 3 on there is no difference in renders, whose parameters are smooth: the limit is for lenses
#: whose blur is not.
_ROUGH = 6.0
#: Narrowest and widest band around an outline, px. Pixels far from it tell the ground that the
#: outline stands on: a widest of 4, 5, 7 and 10 leaves errors of 1.06, 1.02, 1 and 0.99, more and
#: more of it for dirt to lie in; the narrowest makes no difference from 1 to 3 inside, but across
#: the middle of a narrow gap the corners are 0.010 px off instead of 0.005.
_LEAST_OUTER, _NARROWEST, _WIDEST = 1.0, 2.0, 7.0
#: A neighbor lies no further than this times the distance to the nearest: the diagonal of a square
#: of the lattice has 1.41, two steps of it 2.
_NEAR = 1.7
#: Neighbors of a mark on a square lattice; a hexagonal one has six.
_NEIGHBORS = 8
#: Half a gap of so many blurs: beyond it a neighbor takes less than a fortieth of the light.
_UNSEEN = 2.0
#: Most rounds of taking the neighbors off and fitting anew. With a gap of 2.8 times the blur one is
#: 0.085 px off without any, then 0.0092 after two, 0.0074 after three, and 0.0070 after six.
_ROUNDS = 3


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

    def __getitem__(self, index: NDArray) -> Patches:
        """The patches that `index` picks."""
        return Patches(*(each[index] for each in vars(self).values()))


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
        Standard deviation of the residual, grey levels.
    centers : ndarray, shape (n, 2)
        Where the outlines' own coordinates begin in the image, px.
    """

    parameters: Array
    covariance: Array
    rms: Array
    centers: Array

    def __getitem__(self, index: NDArray[np.bool_]) -> OutlineFit:
        """The fits that `index` picks."""
        return OutlineFit(*(each[index] for each in vars(self).values()))


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
    outline: Outline, start: Array, patches: Patches, gap: float, most: int = STEPS
) -> OutlineFit:
    """Fit outlines that lie `gap` apart, px, which may be no further than their blur reaches."""
    start[:, BLUR], start[:, CONTRAST] = START_BLUR, _START_CONTRAST
    start[:, GROUND.start] = patches.grey.max(axis=1)
    fit = _fit_alone(outline, start, patches, most)
    if gap < 2 * _UNSEEN * np.median(np.abs(fit.parameters[:, BLUR])):
        for _ in range(_ROUNDS):
            grey = patches.grey + _taken(outline, fit, patches)
            fit = _fit_alone(outline, fit.parameters, replace(patches, grey=grey), most)
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
    distance, index = cKDTree(centers).query(centers, k=_NEIGHBORS + 1)
    near = distance < _NEAR * np.median(distance[:, 1])  # infinite where there are no more
    taken = np.zeros_like(patches.x)
    for other, beside in zip(np.where(near, index, 0).T[1:], near.T[1:], strict=True):
        x, y = (centers - centers[other]).T[..., None]
        parameters = fit.parameters[other]
        there = replace(patches, x=patches.x + x, y=patches.y + y)
        light, inside, *_ = _parts(outline, parameters, there)
        known = beside & np.isfinite(fit.covariance[other, 0, 0])
        taken += np.where(known[:, None], light * inside * parameters[:, CONTRAST, None], 0.0)
    return taken * patches.weight


def _fit_alone(outline: Outline, start: Array, patches: Patches, most: int) -> OutlineFit:
    """Levenberg–Marquardt on every patch at once, each with its own damping.

    A patch that cannot be fitted, or still moves after `most` steps, leaves the others alone; its
    covariance is NaN.
    """
    best = start.copy()
    damping = np.full(len(start), _FIRST_DAMPING)
    normal, gradient, cost = _equations(outline, best, patches)
    moving = np.isfinite(cost)  # a patch at NaN is lost
    for _ in range(most):
        if not moving.any():
            break
        some = np.flatnonzero(moving)
        damped = normal[some]
        diagonal = np.maximum(np.einsum("npp->np", damped), _NO_EFFECT)
        np.einsum("npp->np", damped)[...] += damping[some, None] * diagonal
        trial = best[some] + (_invert(damped) @ gradient[some, :, None])[..., 0]
        found = _equations(outline, trial, patches[some])
        better = found[2] < cost[some]  # False for NaN, from which more damping may lead away
        moving[some] = ~(np.abs(found[2] - cost[some]) < _SETTLED * cost[some])
        damping[some] *= np.where(better, 1 / _FACTOR, _FACTOR)
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


def smooth_parameters(fit: OutlineFit, columns: list[int]) -> OutlineFit:
    """Let the outlines of one image share what varies smoothly across it.

    The parameters in `columns` are replaced by a polynomial of the place in the image, fitted to
    all of them (quadratic from 12 outlines on, linear from 6 on, nothing below), and the others
    follow as their covariance says: this is the fit that would have been found, had the shared ones
    been known. A column whose values lie further from the polynomial than their errors explain is
    not shared.
    """
    # At least twice as many outlines as the polynomial has coefficients.
    centers = fit.centers
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
    return replace(
        fit,
        parameters=fit.parameters + (gain @ change[..., None])[..., 0],
        covariance=fit.covariance - (1 - leverage) * (gain @ across.transpose(0, 2, 1)),
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


def band(centers: Array, radius: float) -> tuple[tuple[float, float], float]:
    """The band around outlines of half a width `radius` that belongs to no neighbor, out to the
    middle of the gap: least and most distance, positive inside, px; and the gap."""
    distance, _ = cKDTree(centers).query(centers, k=2)
    half = float(np.median(distance[:, 1])) / 2 - radius
    outer, inner = max(min(half, _WIDEST), _LEAST_OUTER), max(min(half, _WIDEST), _NARROWEST)
    return (-outer, inner), 2 * half
