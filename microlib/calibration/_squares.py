"""Detect a grid of squares: Sobel edges linked into lines, then four lines fitted to the grey
levels of each."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, flag, one_of, scalar
from microlib.calibration._agreement import agree_with_map
from microlib.calibration._chessboard import chessboard
from microlib.calibration._complete import SHARP, refuse_fields
from microlib.calibration._dark_regions import DarkRegions
from microlib.calibration._detection import FEWEST, Detection, find_inliers
from microlib.calibration._grid_map import GridMap, fit_square_map
from microlib.calibration._grid_order import mean_steps
from microlib.calibration._lattice_form import Form, orient, refuse_gaps
from microlib.calibration._outline_fit import smooth_parameters
from microlib.calibration._quads import BLUR, CONTRAST, OFFSET, fit_quads, quad_corners, untangle
from microlib.calibration._roundness import are_round
from microlib.calibration._search import search

# What varies smoothly across the image: directions of the sides, blur, contrast, slope of the
# ground.
_SMOOTH = [0, 1, 2, 3, 8, 9, 11, 12]
#: Places along a side at which its bend by the distortion is taken; 3 to 33 give the same points.
_PLACES = 9
#: The map is fitted anew to the points freed of their bias if that is more than this part of their
#: σ: less does not show in the residuals.
_SMALL_BIAS = 0.3
#: Most ratio of width to height of a square, both in steps of the lattice: what is fitted to four
#: squares with noise comes within 0.02.
_MOST_RATIO = 1.1
#: Squares are counted along their sides.
_SQUARE = Form("square", np.eye(2))


def detect_squares(
    image: ArrayLike,
    *,
    direction: float = 0.0,
    mirrored: bool = False,
    pattern: str = "squares",
    region: tuple[int, int, int, int] | None = None,
) -> Detection:
    """Corners of the squares of a regular grid, with their places in the grid.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue, which become luminance. The squares are
        darker than their ground or, if no such grid is found, brighter.
    direction : float
        Direction in the image in which the pattern's x axis points (about α), rad, right to within
        45°.
    mirrored : bool
        True if the pattern is seen from behind (γ near 180°).
    pattern : {"squares", "chessboard"}
        Squares with gaps between them, or the fields of a chessboard, which touch at their corners:
        of it the inner corners are found, one `points` each, and a pitch is the side of a field.
    region : (int, int, int, int), optional
        Where to look, (x, y, width, height) in px.

    Returns
    -------
    Detection
        Four `points` for each square that lies whole in the image. `grid` counts sides and gaps:
        square (m, n) has its corners from (2m, 2n) to (2m + 1, 2n + 1). Where they are of one
        length, the side times `grid` gives world points. `side` says what was measured, and
        `positions` allow for it.

    Raises
    ------
    ValueError
        If `image` is no image, no grid of at least four whole squares is found in it, or what is
        found is none: the marks are rectangles, or lie beside any smooth image of a grid.

    Notes
    -----
    As in §5.2 of the thesis a Sobel operator finds the edges, edge pixels of like direction are
    linked, lines are fitted to them and intersected. These lines are only the start here: all four
    are then fitted together to the grey levels, a product of four blurred half-planes, which near a
    right angle is the exact image of a corner under a Gaussian point-spread function.

    An image that shows nothing but the grid is thresholded against its light. In any other, the
    squares are looked for among closed contours of many grey levels, of both polarities.

    Examples
    --------
    >>> from microlib.microscope import Microscope
    >>> from microlib.synthetic import render_squares
    >>> scope = Microscope(200000, 126000, 79380, tx=-450, ty=-330, image_size=(160, 120))
    >>> found = detect_squares(render_squares(scope))
    >>> error = found.points - scope.project(200.0 * found.grid)
    >>> len(found.points), bool(abs(error).max() < 0.01), round(found.side, 3)
    (16, True, 0.5)
    """
    direction = scalar("direction", direction, within=(-1e9, 1e9))
    mirrored = flag("mirrored", mirrored)
    one_of("pattern", pattern, ("squares", "chessboard"))

    def assemble(
        regions: DarkRegions, index: NDArray[np.intp], grid: NDArray[np.intp]
    ) -> Detection:
        if pattern == "chessboard":
            return chessboard(regions, index, grid, direction, mirrored)
        corners, sigma, grid = _fit(regions, index, grid)
        refuse_gaps("squares", grid)
        grid = orient(
            corners.mean(axis=1), grid, _SQUARE, "square", direction=direction, mirrored=mirrored
        )
        return _detection(corners, sigma, grid, regions.image.shape)

    return search(image, assemble, pattern, region=region)


def _fit(
    regions: DarkRegions, index: NDArray[np.intp], grid: NDArray[np.intp]
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Corners of the whole squares (n, 4, 2), their σ (n, 4), and the squares' grid."""
    fit, patches = fit_quads(regions, index)
    corners, sigma = quad_corners(fit, patches.centers)
    inlier = find_inliers(
        regions.image.shape,
        corners.min(axis=1),
        corners.max(axis=1),
        fit.rms,
        fit.parameters[:, CONTRAST],
        sigma.max(axis=1),
    )
    if inlier.sum() < FEWEST:
        raise ValueError(f"image must show a grid of squares, got {int(inlier.sum())} whole ones")
    if are_round(regions, index[inlier]):
        raise ValueError("image must show squares, got circles")
    origins = patches.centers[inlier]
    half = np.median(fit.parameters[inlier, OFFSET])
    if np.median(np.abs(fit.parameters[inlier, BLUR])) < SHARP * half:
        refuse_fields("squares", regions, index[inlier], grid[inlier])
    corners, sigma = quad_corners(
        smooth_parameters(untangle(fit[inlier]), origins, _SMOOTH), origins
    )
    return corners, sigma, grid[inlier]


def _detection(
    corners: Array, sigma: Array, cells: NDArray[np.intp], image_shape: tuple[int, ...]
) -> Detection:
    """Corners freed of bias, on a grid that is measured and tested."""
    grid = _corner_grid(corners, cells)
    places = grid.reshape(-1, 2)
    middle, half = (places // 2).astype(np.float64), places % 2 - 0.5
    to_image, sides = fit_square_map(corners.reshape(-1, 2), middle, half, image_shape)
    if not 1 / _MOST_RATIO < sides[0] / sides[1] < _MOST_RATIO or not 0 < sides.min() < 1:
        raise ValueError(
            "image must show squares on a square lattice, got rectangles of "
            f"{sides[0]:.3g} × {sides[1]:.3g} steps"
        )
    positions = middle + half * sides
    bias = _corner_bias(to_image, positions.reshape(corners.shape))
    points = (corners - bias).reshape(-1, 2)
    if np.abs(bias).max() > _SMALL_BIAS * np.median(sigma):
        to_image, sides = fit_square_map(points, middle, half, image_shape)
        positions = middle + half * sides
    agreement = agree_with_map(
        points,
        positions,
        to_image,
        sigma.ravel(),
        np.repeat(np.arange(len(corners)), 4),
        middles=middle,
    )
    kept = agreement.kept
    if not kept.all():  # strays bent the map
        marks = kept[::4]
        return _detection(corners[marks], sigma[marks], cells[marks], image_shape)
    side = float(sides.mean())
    places = places[kept] - 2 * (places[kept].min(axis=0) // 2)
    return Detection(
        points[kept],
        places,
        agreement.sigma[kept],
        np.repeat(np.arange(len(places) // 4), 4),
        places // 2 + side * (places % 2),
        side,
        agreement.misfit,
    )


def _corner_grid(corners: Array, grid: NDArray[np.intp]) -> NDArray[np.intp]:
    """Grid coordinates of the corners: twice the square's own, plus the side of its center they lie
    on."""
    centers = corners.mean(axis=1)
    steps = mean_steps(centers, grid)
    try:
        local = (corners - centers[:, None]) @ np.linalg.inv(steps)
    except np.linalg.LinAlgError:
        raise ValueError("image must show a grid of squares, got them in one row") from None
    return 2 * grid[:, None] + (local > 0)


def _corner_bias(to_image: GridMap, grid: Array) -> Array:
    """How far straight lines through distorted sides cross from the images of the corners, (n, 4,
    2), px."""
    first, last = grid[:, :, None], np.roll(grid, -1, axis=1)[:, :, None]
    sides = to_image(first + (last - first) * np.linspace(0, 1, _PLACES)[:, None])  # (n, 4, 9, 2)
    middle = sides.mean(axis=2)
    offset = sides - middle[:, :, None]
    spread = offset.swapaxes(-1, -2) @ offset
    normal = np.linalg.eigh(spread)[1][..., 0]  # (n, 4, 2)
    pair = np.stack([normal, np.roll(normal, 1, axis=1)], axis=2)  # a side and the one before
    along = np.stack([middle, np.roll(middle, 1, axis=1)], axis=2)
    distance = (pair * along).sum(axis=-1)
    try:
        return np.linalg.solve(pair, distance[..., None])[..., 0] - to_image(grid)
    except np.linalg.LinAlgError:
        raise ValueError(
            "image must show squares, got one with parallel neighboring sides"
        ) from None
