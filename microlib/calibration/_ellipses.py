"""Blurred dark ellipses: their grey levels, and the fit of many of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from microlib._common import Array
from microlib.calibration._dark_regions import DarkRegions
from microlib.calibration._detection import band_half_width
from microlib.calibration._neighbors import fit_among_neighbors
from microlib.calibration._outline_fit import (
    LEAST_BLUR,
    START_CONTRAST,
    OutlineFit,
    Patches,
    cut_patches,
    ground,
)

# Places of the parameters: center, shape matrix A (|A·(x − center)| = 1 on the ellipse), blur,
# contrast, ground.
CENTER, SHAPE, BLUR, CONTRAST, GROUND = slice(0, 2), slice(2, 5), 5, 6, slice(7, 10)
#: Half the side of a patch in radii, without the band: the longer axis of an ellipse is 1.2 times
#: its mean radius at an axis ratio of 1.44, a tilt of 46°.
_HALF_SIDE = 1.2
#: Keeps the center of an ellipse, where ρ has no gradient, from 0/0; no fitted pixel is near it.
_AT_CENTER = 1e-9


def fit_ellipses(regions: DarkRegions, index: NDArray[np.intp]) -> tuple[OutlineFit, Patches]:
    """Fit an ellipse to each of the chosen regions; also the pixels that it was fitted to."""
    start = _start(regions.centers[index], regions.moments[index], regions.blur)
    patches = _patches(regions.image, regions.centers[index], start)
    return fit_among_neighbors(_grey_levels, start, patches, GROUND), patches


def ellipse_shape(parameters: Array) -> Array:
    """Symmetric matrix A of each ellipse, (n, 2, 2)."""
    a, b, d = np.moveaxis(parameters[:, SHAPE], 1, 0)
    return np.stack([a, b, b, d], axis=-1).reshape(-1, 2, 2)


def ellipse_reach(parameters: Array) -> Array:
    """Half the width and height of each ellipse, px; (AᵀA)⁻¹ has their squares on its diagonal."""
    a, b, d = parameters[:, SHAPE].T
    return np.sqrt(np.column_stack([b * b + d * d, a * a + b * b])) / np.abs(a * d - b * b)[:, None]


def _start(centers: Array, moments: Array, blur: float) -> Array:
    """Parameters from the regions' moments: a filled ellipse has A = ½ Σ^(−½)."""
    values, vectors = np.linalg.eigh(moments)
    shape = (vectors / (2 * np.sqrt(values))[:, None, :]) @ vectors.transpose(0, 2, 1)
    start = np.zeros((len(centers), 10))
    start[:, CENTER] = centers - np.round(centers)
    start[:, SHAPE] = shape[:, [0, 0, 1], [0, 1, 1]]
    start[:, BLUR], start[:, CONTRAST] = blur, START_CONTRAST
    return start


def _patches(image: NDArray[np.float32], centers: Array, start: Array) -> Patches:
    """Pixels in a band around each outline."""
    radius = float(1 / np.sqrt(np.linalg.det(ellipse_shape(start)).min()))
    margin = band_half_width(centers, radius)

    def near(x: Array, y: Array) -> NDArray[np.bool_]:
        distance, *_ = _distance(start, x, y)
        return np.abs(distance) <= margin

    patches = cut_patches(image, centers, int(np.ceil(radius * _HALF_SIDE + margin)), near)
    start[:, GROUND.start] = patches.grey.max(axis=1)
    return patches


def _distance(parameters: Array, x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """Distance to the ellipse, positive inside, px: (1 − ρ)/|∇ρ| with ρ = |A (x − center)|.

    Also the unit normal ∇ρ/|∇ρ| (two arrays) and ∂ρ/∂A divided by |∇ρ|, (n, k, 3).
    """
    a, b, d = (p[:, None] for p in parameters[:, SHAPE].T)
    dx, dy = x - parameters[:, :1], y - parameters[:, 1:2]
    qx, qy = a * dx + b * dy, b * dx + d * dy
    rho = np.maximum(np.hypot(qx, qy), _AT_CENTER)
    gx, gy = (a * qx + b * qy) / rho, (b * qx + d * qy) / rho
    steep = np.maximum(np.hypot(gx, gy), _AT_CENTER)
    by_shape = np.stack([qx * dx, qx * dy + qy * dx, qy * dy], axis=-1) / (rho * steep)[..., None]
    return (1 - rho) / steep, gx / steep, gy / steep, by_shape


def _grey_levels(parameters: Array, patches: Patches) -> tuple[Array, Array]:
    """Model of a blurred dark ellipse, and its derivatives."""
    distance, nx, ny, by_shape = _distance(parameters, patches.x, patches.y)
    blur = np.maximum(np.abs(parameters[:, BLUR, None]), LEAST_BLUR)
    contrast = parameters[:, CONTRAST, None]
    light, by_light = ground(patches, parameters[:, GROUND])
    z = distance / blur
    inside = ndtr(z)
    slope = -light * contrast * np.exp(-0.5 * z * z) / (np.sqrt(2 * np.pi) * blur)
    jacobian = np.empty((*distance.shape, 10))
    jacobian[..., 0], jacobian[..., 1] = slope * nx, slope * ny
    jacobian[..., SHAPE] = -slope[..., None] * by_shape
    turned = np.where(parameters[:, BLUR, None] < 0, -1.0, 1.0)  # the model has |blur|
    jacobian[..., BLUR] = -slope * z * turned
    jacobian[..., CONTRAST] = -light * inside
    jacobian[..., GROUND] = by_light * (1 - contrast * inside)[..., None]
    return light * (1 - contrast * inside), jacobian
