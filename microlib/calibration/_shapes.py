"""Blurred dark ellipses and quadrilaterals, and the fit of many of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from microlib._common import Array
from microlib.calibration._marks import Marks
from microlib.calibration._outlines import (
    BLUR,
    CONTRAST,
    GROUND,
    LEAST_BLUR,
    START_CONTRAST,
    OutlineFit,
    Patches,
    band,
    cut_patches,
    fit_shapes,
)

# Ellipses: center, shape matrix A (|A·(x − center)| = 1 on the ellipse), then what all have.
CENTER, _SHAPE = slice(0, 2), slice(2, 5)
#: Half the side of a patch in radii, without the band: the longer axis of an ellipse is 1.2 times
#: its mean radius at an axis ratio of 1.44, a tilt of 46°.
_HALF_PATCH = 1.2
#: Keeps the center of an ellipse, where ρ has no gradient, from 0/0; no fitted pixel is near it.
_AT_CENTER = 1e-9

# Quadrilaterals: directions of the four outward normals, distances of the lines from the patch's
# origin along them, then what all have.
_ANGLE, OFFSET = slice(0, 4), slice(4, 8)
#: Corners of a square about its middle, in sides, along the lattice's two steps; line k leads from
#: the corner before to corner k.
CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
#: Sine of the angle below which two lines are parallel.
_PARALLEL = 1e-9
#: Half the side of a patch in sides, without the band: half a diagonal and a tenth for the tilt.
_HALF_SQUARE = 0.8

# What varies smoothly across the image: blur, contrast and slope of the ground, and of squares the
# directions of the sides.
SMOOTH_ELLIPSE = [5, 6, 8, 9]
SMOOTH_QUAD = [0, 1, 2, 3, 8, 9, 11, 12]

#: Area over that of the ellipse of the same moments: 1 for ellipses, 0.955 for squares, and up to
#: 0.991 where blur of a fifth of a side rounds them. In between the grey levels decide, not the
#: outline at one of them.
_SURELY_SQUARE, _SURELY_ROUND = 0.965, 0.992
#: Marks that are asked, evenly among all: each has hundreds of pixels to tell by.
_ASKED = 6


def are_round(marks: Marks, steps: Array) -> bool:
    """Say whether ellipses fit the marks' grey levels better than quadrilaterals do."""
    fullness = float(np.median(marks.fullness))
    if not _SURELY_SQUARE < fullness < _SURELY_ROUND:
        return fullness >= _SURELY_ROUND
    every = np.s_[:: -(-len(steps) // _ASKED)]
    ellipses, _ = fit_ellipses(marks[every])
    quads, _ = fit_quads(marks[every], steps[every])
    both = np.isfinite(ellipses.rms) & np.isfinite(quads.rms)
    if not both.any():
        return bool(np.isfinite(ellipses.rms).sum() > np.isfinite(quads.rms).sum())
    return bool(np.median(ellipses.rms[both] / quads.rms[both]) < 1)


def fit_ellipses(marks: Marks) -> tuple[OutlineFit, Array]:
    """Fit an ellipse to each mark; also the origins that its center counts from."""
    values, vectors = np.linalg.eigh(marks.moments)  # a filled ellipse has A = ½ Σ^(−½)
    shape = (vectors / (2 * np.sqrt(values))[:, None, :]) @ vectors.transpose(0, 2, 1)
    start = np.zeros((len(shape), 10))
    start[:, CENTER] = marks.centers - np.round(marks.centers)
    start[:, _SHAPE] = shape[:, [0, 0, 1], [0, 1, 1]]
    radius = float(1 / np.sqrt(np.linalg.det(shape).min()))
    outer, inner = band(marks.centers, radius)

    def near(x: Array, y: Array) -> NDArray[np.bool_]:
        distance = _to_ellipse(start, x, y)[0]
        return (distance >= -outer) & (distance <= inner)

    half = int(np.ceil(radius * _HALF_PATCH + outer))
    return _fit(marks, start, cut_patches(marks.image, marks.centers, half, near), _ellipse)


def ellipse_shape(parameters: Array) -> Array:
    """Symmetric matrix A of each ellipse, (n, 2, 2)."""
    a, b, d = np.moveaxis(parameters[:, _SHAPE], 1, 0)
    return np.stack([a, b, b, d], axis=-1).reshape(-1, 2, 2)


def ellipse_center(fit: OutlineFit, origins: Array) -> tuple[Array, Array]:
    """Center of each ellipse, (n, 1, 2), and the standard deviation of a coordinate, (n, 1), px."""
    sigma = np.sqrt(np.einsum("nii->ni", fit.covariance[:, CENTER, CENTER]).mean(axis=1))
    return (fit.parameters[:, CENTER] + origins)[:, None], sigma[:, None]


def ellipse_reach(parameters: Array) -> Array:
    """Half the width and height of each ellipse, px; (AᵀA)⁻¹ has their squares on its diagonal."""
    a, b, d = parameters[:, _SHAPE].T
    return np.sqrt(np.column_stack([b * b + d * d, a * a + b * b])) / np.abs(a * d - b * b)[:, None]


def fit_quads(marks: Marks, steps: Array) -> tuple[OutlineFit, Array]:
    """Fit four lines to each mark, from a square along the lattice's steps; also the origins."""
    origin = np.round(marks.centers)
    side = np.sqrt(marks.areas / np.abs(np.linalg.det(steps)))[:, None, None]
    corners = side * (CORNERS @ steps.transpose(0, 2, 1)) + (marks.centers - origin)[:, None]
    before = np.roll(corners, 1, axis=1)
    normal = (corners - before)[..., ::-1] * [1, -1]
    middle = (corners + before) / 2
    outward = (normal * (middle - corners.mean(axis=1, keepdims=True))).sum(axis=-1)
    normal *= np.sign(outward)[..., None] / np.linalg.norm(normal, axis=-1, keepdims=True)
    start = np.zeros((len(corners), 13))
    angle = np.arctan2(normal[..., 1], normal[..., 0])
    start[:, _ANGLE] = angle[0] + np.angle(np.exp(1j * (angle - angle[0])))  # of one branch
    start[:, OFFSET] = (normal * middle).sum(axis=-1)
    width = float(np.median(start[:, OFFSET].sum(axis=1)) / 2)
    outer, inner = band(marks.centers, width / 2)

    def near(x: Array, y: Array) -> NDArray[np.bool_]:
        distance = _to_lines(start, x, y).min(axis=-1)
        return (distance >= -outer) & (distance <= inner)

    half = int(np.ceil(width * _HALF_SQUARE + outer))
    return _fit(marks, start, cut_patches(marks.image, marks.centers, half, near), _quad)


def quad_corners(fit: OutlineFit, origins: Array) -> tuple[Array, Array]:
    """Intersections of consecutive lines, (n, 4, 2), and the standard deviation of a coordinate,
    (n, 4), px."""
    angle, offset = fit.parameters[:, _ANGLE], fit.parameters[:, OFFSET]
    corners, sigma = np.empty((len(angle), 4, 2)), np.empty((len(angle), 4))
    for k in range(4):
        pair = [k, (k + 1) % 4]
        cos, sin = np.cos(angle[:, pair]), np.sin(angle[:, pair])
        det = cos[:, 0] * sin[:, 1] - sin[:, 0] * cos[:, 1]
        det = np.where(np.abs(det) > _PARALLEL, det, np.nan)[:, None]
        inverse = (
            np.stack([sin[:, ::-1] * [1, -1], cos[:, ::-1] * [-1, 1]], axis=1) / det[..., None]
        )
        corners[:, k] = np.einsum("nij,nj->ni", inverse, offset[:, pair])
        # Turning a line by dθ moves it at the corner by (sin θ x − cos θ y) dθ along its normal.
        slide = sin * corners[:, k, :1] - cos * corners[:, k, 1:]
        by = np.concatenate([inverse * slide[:, None], inverse], axis=-1)
        places = [*pair, *(4 + np.array(pair))]
        part = fit.covariance[:, places][:, :, places]
        sigma[:, k] = np.sqrt(np.einsum("nij,njk,nik->n", by, part, by) / 2)
    return corners + origins[:, None], sigma


def _fit(marks: Marks, start: Array, patches: Patches, outline) -> tuple[OutlineFit, Array]:  # type: ignore[no-untyped-def]
    start[:, BLUR], start[:, CONTRAST] = marks.blur, START_CONTRAST
    start[:, GROUND.start] = patches.grey.max(axis=1)
    return fit_shapes(outline, start, patches), patches.centers


def _to_ellipse(parameters: Array, x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """Distance to the ellipse, positive inside, px: (1 − ρ)/|∇ρ| with ρ = |A (x − center)|.

    Also the unit normal ∇ρ/|∇ρ| (two arrays) and ∂ρ/∂A divided by |∇ρ|, (n, k, 3).
    """
    a, b, d = (p[:, None] for p in parameters[:, _SHAPE].T)
    dx, dy = x - parameters[:, :1], y - parameters[:, 1:2]
    qx, qy = a * dx + b * dy, b * dx + d * dy
    rho = np.maximum(np.hypot(qx, qy), _AT_CENTER)
    gx, gy = (a * qx + b * qy) / rho, (b * qx + d * qy) / rho
    steep = np.maximum(np.hypot(gx, gy), _AT_CENTER)
    by_shape = np.stack([qx * dx, qx * dy + qy * dx, qy * dy], axis=-1) / (rho * steep)[..., None]
    return (1 - rho) / steep, gx / steep, gy / steep, by_shape


def _ellipse(parameters: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """The part of the light that a blurred ellipse takes, and its derivatives."""
    distance, nx, ny, by_shape = _to_ellipse(parameters, x, y)
    blur, sign = _blur(parameters)
    z = distance / blur
    slope = np.exp(-0.5 * z * z) / (np.sqrt(2 * np.pi) * blur)
    by = np.empty((*z.shape, 6))
    by[..., 0], by[..., 1] = slope * nx, slope * ny
    by[..., _SHAPE] = -slope[..., None] * by_shape
    by[..., -1] = -slope * z * sign
    return ndtr(z), by


def _to_lines(parameters: Array, x: Array, y: Array) -> Array:
    """Distances to the four lines, positive inside, (n, k, 4), px."""
    angle = parameters[:, None, _ANGLE]
    across = np.cos(angle) * x[..., None] + np.sin(angle) * y[..., None]
    return parameters[:, None, OFFSET] - across


def _quad(parameters: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """The part of the light that a blurred quadrilateral takes: a product of four half-planes,
    which near a right angle is the exact image of a corner; and its derivatives."""
    blur, sign = (each[..., None] for each in _blur(parameters))
    z = _to_lines(parameters, x, y) / blur
    a, b, c, d = np.moveaxis(ndtr(z), -1, 0)
    others = np.stack([b * c * d, a * c * d, a * b * d, a * b * c], axis=-1)
    by_distance = others * np.exp(-0.5 * z * z) / (np.sqrt(2 * np.pi) * blur)
    angle = parameters[:, None, _ANGLE]
    turning = np.sin(angle) * x[..., None] - np.cos(angle) * y[..., None]
    by = np.empty((*x.shape, 9))
    by[..., _ANGLE], by[..., OFFSET] = by_distance * turning, by_distance
    by[..., -1] = -(by_distance * z * sign).sum(axis=-1)
    return a * b * c * d, by


def _blur(parameters: Array) -> tuple[Array, Array]:
    """|blur| of each outline, of which the model is, and its derivative."""
    blur = parameters[:, BLUR, None]
    return np.maximum(np.abs(blur), LEAST_BLUR), np.where(blur < 0, -1.0, 1.0)
