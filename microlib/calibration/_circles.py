"""Detect a grid of circles: ellipses fitted to grey levels, their centers freed of bias."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, flag, one_of, scalar
from microlib.calibration._agreement import agree_with_map
from microlib.calibration._complete import SHARP, refuse_fields
from microlib.calibration._dark_regions import DarkRegions
from microlib.calibration._detection import FEWEST, Detection, find_inliers
from microlib.calibration._ellipses import (
    BLUR,
    CENTER,
    CONTRAST,
    ellipse_reach,
    ellipse_shape,
    fit_ellipses,
)
from microlib.calibration._grid_map import GridMap, fit_grid_map, homography_map
from microlib.calibration._lattice_form import (
    LATTICES,
    STEPS,
    Form,
    lattice_form,
    orient,
    refuse_gaps,
    refuse_other,
)
from microlib.calibration._origin import find_origin
from microlib.calibration._outline_fit import OutlineFit, smooth_parameters
from microlib.calibration._roundness import are_round
from microlib.calibration._search import search

# What varies smoothly across the image: blur, contrast, slope of the ground.
_SMOOTH = [5, 6, 8, 9]
#: The map is fitted anew to the points freed of their bias if that is more than this part of their
#: σ: less does not show in the residuals.
_SMALL_BIAS = 0.3
#: Corners of the polygon that stands for a circle's rim; errors are the same from 8 to 64.
_RIM = 32


def detect_circles(
    image: ArrayLike,
    *,
    direction: float = 0.0,
    mirrored: bool = False,
    lattice: str = "square",
    region: tuple[int, int, int, int] | None = None,
    origin: str = "first",
) -> Detection:
    """Centers of the circles of a regular grid, with their places in the grid.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue, which become luminance. The circles are
        darker than their ground or, if no such grid is found, brighter.
    direction : float
        Direction in the image in which the pattern's x axis points (about α), rad, right to within
        45°, on a hexagonal lattice 30°.
    mirrored : bool
        True if the pattern is seen from behind (γ near 180°).
    lattice : {"square", "hexagonal", "asymmetric"}
        What the circles lie on. The second step of a hexagonal lattice is at 60° to the first.
        An asymmetric grid has every second row shifted by half a step; its x and y count the half
        steps and the rows, as OpenCV's does. Another lattice than the named one is refused.
    region : (int, int, int, int), optional
        Where to look, (x, y, width, height) in px.
    origin : {"first", "odd"}
        Where the coordinates begin: at the first column and row that were found, or at the origin
        mark of the pattern, the one circle that is larger or smaller than the others by a fifth of
        its diameter or more, or the one place inside the grid that has none.

    Returns
    -------
    Detection
        `points` are the images of the circles' centers. Circles that leave the image are not among
        them.

    Raises
    ------
    ValueError
        If `image` is no image, no grid of at least four whole circles is found in it, or what is
        found is none: the circles are not of one size, lie on another lattice, or beside any smooth
        image of it; or if there is not one origin mark that is asked for.

    Notes
    -----
    The thesis takes the center "by least squares" (§5.2); here the least squares are those of the
    grey levels around the whole outline. Under perspective and distortion the center of the ellipse
    is not the image of the circle's center: the map from the grid to the image is fitted to the
    points, the circle is sent through it, and the difference between the two centers is taken off.

    An image that shows nothing but the grid is thresholded against its light. In any other, the
    circles are looked for among closed contours of many grey levels, of both polarities.

    Examples
    --------
    >>> from microlib.microscope import Microscope
    >>> from microlib.synthetic import render_circles
    >>> scope = Microscope(200000, 126000, 79380, tx=-300, ty=-300, image_size=(160, 120))
    >>> found = detect_circles(render_circles(scope))
    >>> error = found.points - scope.project(280.0 * found.positions)
    >>> len(found.points), bool(abs(error).max() < 0.01)
    (9, True)
    """
    direction = scalar("direction", direction, within=(-1e9, 1e9))
    mirrored = flag("mirrored", mirrored)
    lattice = one_of("lattice", lattice, LATTICES)
    one_of("origin", origin, ("first", "odd"))

    def assemble(
        regions: DarkRegions, index: NDArray[np.intp], grid: NDArray[np.intp]
    ) -> Detection:
        fit, origins, grid = _fit(regions, index, grid)
        shape = regions.image.shape
        return _detection(fit, origins, grid, shape, lattice, direction, mirrored, origin == "odd")

    return search(image, assemble, "circles", lattice=lattice, region=region)


def _fit(
    regions: DarkRegions, index: NDArray[np.intp], grid: NDArray[np.intp]
) -> tuple[OutlineFit, Array, NDArray[np.intp]]:
    """Ellipses of the whole circles, the origins of their patches, and their grid."""
    fit, patches = fit_ellipses(regions, index)
    found = fit.parameters
    points = found[:, CENTER] + patches.centers
    reach = ellipse_reach(found)
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
    if not are_round(regions, index[inlier]):
        raise ValueError("image must show circles, got squares")
    origins = patches.centers[inlier]
    radius = 1 / np.sqrt(np.median(np.linalg.det(ellipse_shape(found[inlier]))))
    if np.median(np.abs(found[inlier, BLUR])) < SHARP * radius:
        refuse_fields("circles", regions, index[inlier], grid[inlier])
    return smooth_parameters(fit[inlier], origins, _SMOOTH), origins, grid[inlier]


def _detection(
    fit: OutlineFit,
    origins: Array,
    grid: NDArray[np.intp],
    image_shape: tuple[int, ...],
    lattice: str,
    direction: float,
    mirrored: bool,
    odd: bool,
) -> Detection:
    """Points freed of bias, on a lattice that is named and tested."""
    points = fit.parameters[:, CENTER] + origins
    shape = np.linalg.inv(ellipse_shape(fit.parameters))
    form = _form(points, grid, shape @ shape, image_shape)
    refuse_other("circles", form, lattice)
    refuse_gaps("circles", grid)
    grid = orient(points, grid, form, lattice, direction=direction, mirrored=mirrored)
    positions = grid @ STEPS[lattice]
    to_image = fit_grid_map(points, positions, image_shape)
    area = np.pi / np.abs(np.linalg.det(ellipse_shape(fit.parameters)))
    bias = _center_bias(to_image, positions, area)
    points, sigma = points - bias, _sigma(fit)
    if np.abs(bias).max() > _SMALL_BIAS * np.median(sigma):
        to_image = fit_grid_map(points, positions, image_shape)
    agreement = agree_with_map(
        points, positions, to_image, sigma, np.arange(len(points)), middles=positions
    )
    kept = agreement.kept
    if not kept.all():  # strays bent the map
        rest = fit[kept], origins[kept], grid[kept], image_shape, lattice, direction, mirrored, odd
        return _detection(*rest)
    first = find_origin(grid, area / to_image.scale(positions)) if odd else grid.min(axis=0)
    grid = grid - first
    return Detection(
        points[kept],
        grid,
        agreement.sigma[kept],
        np.arange(len(grid)),
        grid @ STEPS[lattice],
        np.nan,
        agreement.misfit,
    )


def _form(
    points: Array, grid: NDArray[np.intp], moments: Array, image_shape: tuple[int, ...]
) -> Form:
    """The lattice's form, by a homography where that does: it is quicker than a bent map."""
    flat = grid.astype(np.float64)
    try:
        return lattice_form(moments, homography_map(points, flat, image_shape).steps(flat))
    except ValueError:
        return lattice_form(moments, fit_grid_map(points, flat, image_shape).steps(flat))


def _sigma(fit: OutlineFit) -> Array:
    """Standard deviation of a coordinate of each center, px."""
    return np.sqrt(np.einsum("nii->ni", fit.covariance[:, CENTER, CENTER]).mean(axis=1))


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
