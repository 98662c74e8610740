"""Detect a grid of circles, of squares or of the corners of a chessboard.

One way for all: grey image → marks → lattice → one fit of each mark → points freed of their bias →
the test that they lie where a lens would put a lattice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, flag, one_of, scalar
from microlib.calibration._agreement import agree
from microlib.calibration._chessboard import find_crossings
from microlib.calibration._detection import FEWEST, Detection
from microlib.calibration._grid_map import GridMap, fit_grid_map, homography_map
from microlib.calibration._lattice import (
    STEPS,
    complete,
    counting,
    grow_lattices,
    lattice_gram,
    refuse_fields,
    refuse_gaps,
)
from microlib.calibration._marks import Marks, crop, dark_regions, even_edges, to_grey
from microlib.calibration._outlines import BLUR, CONTRAST, find_inliers, smooth_parameters
from microlib.calibration._shapes import (
    CORNERS,
    OFFSET,
    SMOOTH_ELLIPSE,
    SMOOTH_QUAD,
    are_round,
    ellipse_center,
    ellipse_reach,
    ellipse_shape,
    fit_ellipses,
    fit_quads,
    quad_corners,
)

#: If a lattice holds this part of the dark regions of an image, the image shows it and nothing
#: else.
_NOTHING_ELSE = 0.7
#: Pieces of lattice in clutter that are looked at, the largest first.
_PIECES = 4
#: With more blur than this part of a mark's half-width its neighbors shade the places between.
_SHARP = 0.3
#: A mark alone in its row or column lies so near to where the others' map has it, in pitches.
_BESIDE = 0.05
#: Most ratio of width to height of a square, both in steps of the lattice: what is fitted to four
#: squares with noise comes within 0.02.
_MOST_RATIO = 1.1
#: The map is fitted anew to the points freed of their bias if that is more than this part of their
#: σ: less does not show in the residuals.
_SMALL_BIAS = 0.3
#: Corners of the polygon that stands for a circle's rim, errors are the same from 8 to 64; and
#: places along a side at which its bend by the distortion is taken, 3 to 33 give the same points.
_RIM, _PLACES = 32, 9


def detect_circles(
    image: ArrayLike,
    *,
    direction: float = 0.0,
    mirrored: bool = False,
    lattice: str = "square",
    region: tuple[int, int, int, int] | None = None,
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

    Returns
    -------
    Detection
        `points` are the images of the circles' centers. Circles that leave the image are not among
        them. `grid` begins at the first column and row that were found.

    Raises
    ------
    ValueError
        If `image` is no image, no grid of at least four whole circles is found in it, or what is
        found is none: the circles are not of one size, lie on another lattice, or beside any smooth
        image of it.

    Notes
    -----
    The thesis takes the center "by least squares" (§5.2); here the least squares are those of the
    grey levels around the whole outline. Under perspective and distortion the center of the ellipse
    is not the image of the circle's center: the map from the grid to the image is fitted to the
    points, the circle is sent through it, and the difference between the two centers is taken off.

    An image that shows nothing but the grid is thresholded. In any other, the
    circles are looked for among closed contours of many grey levels, of both polarities.

    Examples
    --------
    >>> from microlib.calibration import detect_circles
    >>> from microlib.microscope import Microscope
    >>> from microlib.synthetic import render_circles
    >>> scope = Microscope(200000, 126000, 79380, tx=-300, ty=-300, image_size=(160, 120))
    >>> found = detect_circles(render_circles(scope))
    >>> error = found.points - scope.project(280.0 * found.positions)
    >>> len(found.points), bool(abs(error).max() < 0.01)
    (9, True)
    """
    lattice = one_of("lattice", lattice, tuple(STEPS))
    return _detect(image, "circles", lattice, direction, mirrored, region)


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
    The thesis finds edges with a Sobel operator, links them, and intersects the lines fitted to
    them (§5.2). Here all four lines of a square are fitted together to the grey levels: a product
    of four blurred half-planes, which near a right angle is the exact image of a corner under a
    Gaussian point-spread function. They start along the steps of the lattice.

    An image that shows nothing but the grid is thresholded. In any other, the
    squares are looked for among closed contours of many grey levels, of both polarities. The
    corners of a chessboard are found by OpenCV (``findChessboardCornersSB``), and then two crossing
    edges are fitted to the grey levels around each.

    Examples
    --------
    >>> from microlib.calibration import detect_squares
    >>> from microlib.microscope import Microscope
    >>> from microlib.synthetic import render_squares
    >>> scope = Microscope(200000, 126000, 79380, tx=-450, ty=-330, image_size=(160, 120))
    >>> found = detect_squares(render_squares(scope))
    >>> error = found.points - scope.project(200.0 * found.grid)
    >>> len(found.points), bool(abs(error).max() < 0.01), round(found.side, 3)
    (16, True, 0.5)
    """
    pattern = one_of("pattern", pattern, ("squares", "chessboard"))
    return _detect(image, pattern, "square", direction, mirrored, region)


@dataclass(frozen=True, eq=False)
class _Found:
    """Points of marks (n, k, 2) with their σ (n, k), their grid (n, 2) in any integer coordinates
    and the inner products (2, 2) of its steps; of circles the areas (n,) in the image."""

    points: Array
    sigma: Array
    grid: NDArray[np.intp]
    gram: Array
    areas: Array | None

    def __getitem__(self, index: NDArray[np.bool_]) -> _Found:
        areas = None if self.areas is None else self.areas[index]
        return _Found(self.points[index], self.sigma[index], self.grid[index], self.gram, areas)


def _detect(
    image: ArrayLike,
    kind: str,
    lattice: str,
    direction: float,
    mirrored: bool,
    region: tuple[int, int, int, int] | None,
) -> Detection:
    direction = scalar("direction", direction, within=(-1e9, 1e9))
    mirrored = flag("mirrored", mirrored)
    whole = to_grey(image)
    grey, corner = crop(whole, region)

    view = (lattice, direction, mirrored, grey.shape, corner, whole.shape)
    if kind == "chessboard":
        points, sigma, grid = find_crossings(grey)
        refuse_gaps("corners", grid)
        return _detection(_Found(points[:, None], sigma[:, None], grid, np.eye(2), None), *view)
    refusal = ValueError(f"image must show a grid of {kind}, got none")
    for count, (marks, grid) in enumerate(_candidates(grey, lattice)):
        try:
            return _detection(_fit(marks, grid, kind, lattice), *view)
        except ValueError as fault:
            if count == 0:  # of the largest
                refusal = fault
    raise refusal


def _candidates(
    grey: NDArray[np.float32], lattice: str
) -> Iterator[tuple[Marks, NDArray[np.intp]]]:
    """Lattices of marks, the most likely first: that of the image as if it showed nothing else,
    then the largest pieces in clutter."""
    marks = dark_regions(grey)
    pieces = [(marks, *piece) for piece in grow_lattices(marks, lattice)[:1]]
    alone = bool(pieces) and len(pieces[0][1]) >= _NOTHING_ELSE * len(marks.centers)
    if alone:
        yield complete(*pieces.pop())
    for marks in even_edges(grey):
        pieces += [(marks, *piece) for piece in grow_lattices(marks, lattice)]
    for piece in sorted(pieces, key=lambda piece: -len(piece[1]))[:_PIECES]:
        yield complete(*piece)


def _fit(marks: Marks, grid: NDArray[np.intp], kind: str, lattice: str) -> _Found:
    """Fit the marks, and keep those that lie in the image and are fitted as well as the others."""
    flat = grid.astype(np.float64)
    steps = homography_map(marks.centers, flat, marks.image.shape).steps(flat)
    if not np.abs(np.linalg.det(steps)).min() > 1:
        raise ValueError(f"image must show a plane grid of {kind}, got marks that are on none")
    if kind == "circles":
        fit, origins = fit_ellipses(marks)
        locate, smooth = ellipse_center, SMOOTH_ELLIPSE
        reach = ellipse_reach(fit.parameters)[:, None] * np.array([[-1], [1]])
        half = 1 / np.sqrt(np.abs(np.linalg.det(ellipse_shape(fit.parameters))))
    else:
        fit, origins = fit_quads(marks, steps)
        locate, smooth, reach = quad_corners, SMOOTH_QUAD, np.zeros((1, 1, 2))
        half = fit.parameters[:, OFFSET].mean(axis=1)
    points, sigma = locate(fit, origins)
    good = find_inliers(
        marks.image.shape,
        (points + reach).min(axis=1),
        (points + reach).max(axis=1),
        fit.rms,
        fit.parameters[:, CONTRAST],
        sigma.max(axis=1),
    )
    if good.sum() < FEWEST:
        raise ValueError(f"image must show a grid of {kind}, got {int(good.sum())} whole ones")
    marks, flat, fit, origins = marks[good], flat[good], fit[good], origins[good]
    grid = grid[good]
    if are_round(marks, steps[good]) != (kind == "circles"):
        raise ValueError(
            f"image must show {kind}, got {'squares' if kind == 'circles' else 'circles'}"
        )
    if np.median(np.abs(fit.parameters[:, BLUR])) < _SHARP * np.median(half[good]):
        refuse_fields(kind, marks, grid)
    refuse_gaps(kind, grid)
    fit = smooth_parameters(fit, origins, smooth)
    points, sigma = locate(fit, origins)
    if kind == "squares":
        return _Found(points, sigma, grid, np.eye(2), None)
    shape = np.linalg.inv(ellipse_shape(fit.parameters))
    to_image, _ = fit_grid_map(points, flat, np.zeros((1, 2)), marks.image.shape)
    gram = lattice_gram(shape @ shape, to_image.steps(flat), lattice)
    return _Found(points, sigma, grid, gram, np.pi * np.abs(np.linalg.det(shape)))


def _detection(
    found: _Found,
    lattice: str,
    direction: float,
    mirrored: bool,
    image_shape: tuple[int, ...],
    corner: Array,
    whole: tuple[int, ...],
) -> Detection:
    """Points freed of bias, on a lattice that is tested; marks that are none of it are left out."""
    squares = found.points.shape[1] == 4
    grid_of = counting(
        found.points.mean(axis=1), found.grid, found.gram, lattice, direction, mirrored
    )
    offsets: Array = CORNERS @ grid_of if squares else np.zeros((1, 2))

    def counted(found: _Found) -> NDArray[np.intp]:
        return np.round(found.grid @ grid_of).astype(np.intp)

    # A mark alone in its row or column bends the map towards itself: the others' map tells.
    alone = np.zeros(len(found.grid), dtype=bool)
    for row in counted(found).T:
        alone |= np.bincount(row - row.min())[row - row.min()] == 1
    kept = ~alone
    if alone.any() and kept.sum() >= FEWEST:
        cells = counted(found) @ STEPS[lattice]
        to_image, _ = fit_grid_map(found.points[kept], cells[kept], offsets, image_shape)
        beside = np.linalg.norm(found.points.mean(axis=1) - to_image(cells), axis=1)
        kept |= beside < _BESIDE * np.sqrt(to_image.scale(cells))
    while True:
        found = found[kept]
        if len(found.grid) < FEWEST:
            raise ValueError(f"image must show a plane grid, got {len(found.grid)} marks of one")
        cells = counted(found) @ STEPS[lattice]
        to_image, positions = fit_grid_map(found.points, cells, offsets, image_shape)
        bias: Array = np.zeros_like(found.points)
        if squares:
            sides = np.ptp(positions[0], axis=0)
            if not 1 / _MOST_RATIO < sides[0] / sides[1] < _MOST_RATIO or sides.max() >= 1:
                raise ValueError(
                    "image must show squares on a square lattice, got rectangles of "
                    f"{sides[0]:.3g} × {sides[1]:.3g} steps"
                )
            bias = _corner_bias(to_image, positions)
        elif found.areas is not None:
            bias = _center_bias(to_image, cells, found.areas)[:, None]
        points = found.points - bias
        if np.abs(bias).max() > _SMALL_BIAS * np.median(found.sigma):
            to_image, positions = fit_grid_map(points, cells, offsets, image_shape)
        pitch = float(np.sqrt(np.median(to_image.scale(cells))))
        kept, sigma, misfit = agree(points, positions, to_image, found.sigma, pitch)
        if kept.all():
            break  # else strays bent the map
    grid = counted(found)
    grid = (grid - grid.min(axis=0))[:, None]
    ends = (offsets > 0).astype(np.intp)
    side = float(np.ptp(positions[0], axis=0).mean()) if squares else 1.0
    return Detection(
        points.reshape(-1, 2) + corner,
        ((1 + squares) * grid + ends).reshape(-1, 2),
        sigma.ravel(),
        np.repeat(np.arange(len(grid)), points.shape[1]),
        (grid @ STEPS[lattice] + side * ends).reshape(-1, 2),
        side if found.areas is None else np.nan,
        misfit,
        (whole[1], whole[0]),
    )


def _center_bias(to_image: GridMap, cells: Array, areas: Array) -> Array:
    """How far the center of each circle's image lies from the image of its center, px."""
    radius = np.sqrt(np.median(areas / (np.pi * to_image.scale(cells))))  # in pitches
    turn = np.linspace(0, 2 * np.pi, _RIM, endpoint=False)
    rim = to_image(cells[:, None] + radius * np.column_stack([np.cos(turn), np.sin(turn)]))
    middle = rim.mean(axis=1)
    here = rim - middle[:, None]
    following = np.roll(here, -1, axis=1)
    cross = here[..., 0] * following[..., 1] - here[..., 1] * following[..., 0]
    third = 3 * cross.sum(axis=1)[:, None]  # the centroid of the polygon's area
    return middle + ((here + following) * cross[..., None]).sum(axis=1) / third - to_image(cells)


def _corner_bias(to_image: GridMap, corners: Array) -> Array:
    """How far straight lines through distorted sides cross from the images of the corners, (n, 4,
    2), px."""
    first, last = corners[:, :, None], np.roll(corners, -1, axis=1)[:, :, None]
    sides = to_image(first + (last - first) * np.linspace(0, 1, _PLACES)[:, None])  # (n, 4, 9, 2)
    middle = sides.mean(axis=2)
    offset = sides - middle[:, :, None]
    normal = np.linalg.eigh(offset.swapaxes(-1, -2) @ offset)[1][..., 0]  # (n, 4, 2)
    pair = np.stack([normal, np.roll(normal, 1, axis=1)], axis=2)  # a side and the one before
    along = np.stack([middle, np.roll(middle, 1, axis=1)], axis=2)
    distance = (pair * along).sum(axis=-1)
    try:
        crossing = np.linalg.solve(pair, distance[..., None])[..., 0]
    except np.linalg.LinAlgError:
        raise ValueError(
            "image must show squares, got one with parallel neighboring sides"
        ) from None
    return np.asarray(crossing - to_image(corners))
