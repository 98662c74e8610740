"""Detect a grid of circles: ellipses fitted to grey levels, their centers freed of bias."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from microlib._common import Array, flag, scalar
from microlib.calibration._dark_regions import find_dark_regions
from microlib.calibration._detection import FEWEST, Detection, band_half_width, find_inliers
from microlib.calibration._grid_map import GridMap, fit_grid_map
from microlib.calibration._grid_order import order_grid
from microlib.calibration._outline_fit import (
    LEAST_BLUR,
    START_BLUR,
    START_CONTRAST,
    OutlineFit,
    Patches,
    cut_patches,
    fit_outlines,
    ground,
    smooth_parameters,
)

# Places of the parameters: center, shape matrix A (|A·(x − center)| = 1 on the ellipse), blur,
# contrast, ground.
CENTER, SHAPE, BLUR, CONTRAST, GROUND = slice(0, 2), slice(2, 5), 5, 6, slice(7, 10)
# What varies smoothly across the image: blur, contrast, slope of the ground.
_SMOOTH = [5, 6, 8, 9]
#: Ellipses have a fullness of 1, squares of 0.955 to 0.97 as blur rounds them.
_LEAST_FULLNESS = 0.98
#: Half the side of a patch in radii, without the band: the longer axis of an ellipse is 1.2 times
#: its mean radius at an axis ratio of 1.44, a tilt of 46°.
_HALF_SIDE = 1.2
#: Corners of the polygon that stands for a circle's rim; errors are the same from 8 to 64.
_RIM = 32
#: Keeps the center of an ellipse, where ρ has no gradient, from 0/0; no fitted pixel is near it.
_AT_CENTER = 1e-9


def detect_circles(
    image: ArrayLike, *, direction: float = 0.0, mirrored: bool = False
) -> Detection:
    """Centers of the dark circles of a regular grid, with their places in the grid.

    Parameters
    ----------
    image : array_like, shape (height, width)
        Grey levels, any range; the circles darker than their ground.
    direction : float
        Direction in the image in which the pattern's x axis points (about α), rad, right to within
        45°.
    mirrored : bool
        True if the pattern is seen from behind (γ near 180°).

    Returns
    -------
    Detection
        `points` are the images of the circles' centers. Circles that leave the image are not among
        them.

    Raises
    ------
    ValueError
        If `image` is not a grey image or no grid of at least four whole circles is found in it.

    Notes
    -----
    The thesis takes the center "by least squares" (§5.2); here the least squares are those of the
    grey levels around the whole outline. Under perspective and distortion the center of the ellipse
    is not the image of the circle's center: the map from the grid to the image is fitted to the
    points, the circle is sent through it, and the difference between the two centers is taken off.

    Examples
    --------
    >>> from microlib.microscope import Microscope
    >>> from microlib.synthetic import render_circles
    >>> scope = Microscope(200000, 126000, 79380, tx=-300, ty=-300, image_size=(160, 120))
    >>> found = detect_circles(render_circles(scope))
    >>> error = found.points - scope.project(280.0 * found.grid)
    >>> len(found.points), bool(abs(error).max() < 0.01)
    (9, True)
    """
    direction = scalar("direction", direction, within=(-1e9, 1e9))
    mirrored = flag("mirrored", mirrored)
    regions = find_dark_regions(image)
    try:
        index, grid = order_grid(regions.centers, direction=direction, mirrored=mirrored)
    except ValueError as error:
        raise ValueError(f"image must show a grid of circles: {error}") from None
    start = _start(regions.centers[index], regions.moments[index])
    patches = _patches(regions.image, regions.centers[index], start)
    fit = fit_outlines(lambda p: _grey_levels(p, patches), start, patches)

    found = fit.parameters
    points = found[:, CENTER] + patches.centers
    reach = _reach(found)
    inlier = find_inliers(
        regions.image.shape,
        points - reach,
        points + reach,
        fit.rms,
        found[:, CONTRAST],
        _sigma(fit),
    )
    if inlier.sum() < FEWEST:
        raise ValueError(f"image must show a grid of circles, got {int(inlier.sum())} whole ones")
    fullness = np.median(regions.fullness[index][inlier])
    if fullness < _LEAST_FULLNESS:
        raise ValueError(f"image must show circles, got shapes of fullness {fullness:.3f}, not 1")
    fit, origins = (
        smooth_parameters(fit[inlier], patches.centers[inlier], _SMOOTH),
        patches.centers[inlier],
    )
    points = fit.parameters[:, CENTER] + origins
    grid = grid[inlier] - grid[inlier].min(axis=0)
    area = np.pi / np.abs(np.linalg.det(_shape(fit.parameters)))
    to_image = fit_grid_map(points, grid.astype(np.float64), regions.image.shape)
    points = points - _center_bias(to_image, grid, area)
    return Detection(points, grid, _sigma(fit), np.arange(len(points)))


def _sigma(fit: OutlineFit) -> Array:
    """Standard deviation of a coordinate of each center, px."""
    return np.sqrt(np.einsum("nii->ni", fit.covariance[:, CENTER, CENTER]).mean(axis=1))


def _shape(parameters: Array) -> Array:
    """Symmetric matrix A of each ellipse, (n, 2, 2)."""
    a, b, d = np.moveaxis(parameters[:, SHAPE], 1, 0)
    return np.stack([a, b, b, d], axis=-1).reshape(-1, 2, 2)


def _reach(parameters: Array) -> Array:
    """Half the width and height of each ellipse, px; (AᵀA)⁻¹ has their squares on its diagonal."""
    a, b, d = parameters[:, SHAPE].T
    return np.sqrt(np.column_stack([b * b + d * d, a * a + b * b])) / np.abs(a * d - b * b)[:, None]


def _start(centers: Array, moments: Array) -> Array:
    """Parameters from the regions' moments: a filled ellipse has A = ½ Σ^(−½)."""
    values, vectors = np.linalg.eigh(moments)
    shape = (vectors / (2 * np.sqrt(values))[:, None, :]) @ vectors.transpose(0, 2, 1)
    start = np.zeros((len(centers), 10))
    start[:, CENTER] = centers - np.round(centers)
    start[:, SHAPE] = shape[:, [0, 0, 1], [0, 1, 1]]
    start[:, BLUR], start[:, CONTRAST] = START_BLUR, START_CONTRAST
    return start


def _patches(image: NDArray[np.float32], centers: Array, start: Array) -> Patches:
    """Pixels in a band around each outline."""
    radius = float(1 / np.sqrt(np.linalg.det(_shape(start)).min()))
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
    jacobian[..., BLUR] = -slope * z
    jacobian[..., CONTRAST] = -light * inside
    jacobian[..., GROUND] = by_light * (1 - contrast * inside)[..., None]
    return light * (1 - contrast * inside), jacobian


def _center_bias(to_image: GridMap, grid: Array, area: Array) -> Array:
    """How far the center of each circle's image lies from the image of its center, px."""
    radius = np.sqrt(np.median(area / (np.pi * to_image.scale(grid))))  # in steps of the grid
    turn = np.linspace(0, 2 * np.pi, _RIM, endpoint=False)
    rim = to_image(grid[:, None] + radius * np.column_stack([np.cos(turn), np.sin(turn)]))
    return _centroid(rim) - to_image(grid)


def _centroid(polygons: Array) -> Array:
    """Centroid of the area of each polygon, (n, k, 2) to (n, 2)."""
    origin = polygons.mean(axis=1)
    here = polygons - origin[:, None]
    following = np.roll(here, -1, axis=1)
    cross = here[..., 0] * following[..., 1] - here[..., 1] * following[..., 0]
    return origin + ((here + following) * cross[..., None]).sum(axis=1) / (
        3 * cross.sum(axis=1)[:, None]
    )
