"""Detect a grid of circles, of squares or of the corners of a chessboard.

One way for all: grey image → marks → lattice → one fit of each mark → points freed of their bias →
the test that they lie where a lens would put a lattice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, flag, one_of, scalar
from microlib.calibration._agreement import agree
from microlib.calibration._chessboard import find_corners
from microlib.calibration._detection import FEWEST, Detection
from microlib.calibration._grid_map import GridMap, fit_grid_map
from microlib.calibration._lattice import (
    LEAST_FULL,
    STEPS,
    complete,
    counting,
    darkness,
    fill,
    grow_lattices,
    refuse_fields,
    refuse_lattice,
)
from microlib.calibration._marks import Marks, crop, dark_regions, even_edges, to_grey
from microlib.calibration._shapes import CORNERS, are_round, fit_marks

#: If a lattice holds this part of the dark regions of an image, the image shows it and nothing
#: else.
_NOTHING_ELSE = 0.7
#: Pieces of lattice in clutter that are looked at, the largest first.
_PIECES = 4
#: Most ratio of width to height of a square, both in steps of the lattice: what is fitted to four
#: squares with noise comes within 0.02.
_MOST_RATIO = 1.1
_MIDDLE = np.zeros((1, 2))
#: Places of a ring that stands for a circle.
_RIM = 8


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
    refusal = ValueError(f"image must show a grid of {kind}, got none")
    for count, (marks, grid, alone) in enumerate(_candidates(grey, kind, lattice)):
        try:
            points, sigma, grid, areas = _fit(marks, grid, kind, lattice)
            turn = counting(points.mean(axis=1), grid, lattice, direction, mirrored)
            found = _place(points, sigma, grid, areas, lattice, turn, grey.shape)
            # A homography leads to any four centers, and clutter has many.
            if alone or np.isfinite(found.misfit):
                return replace(found, points=found.points + corner, image_size=whole.shape[::-1])
            raise ValueError(f"image must show more {kind} or nothing else, got {len(grid)}")
        except ValueError as fault:
            if count == 0:  # of the largest
                refusal = fault
    raise refusal


def _candidates(
    grey: NDArray[np.float32], kind: str, lattice: str
) -> Iterator[tuple[Marks, NDArray[np.intp], bool]]:
    """Lattices of marks, the most likely first: that of the image as if it showed nothing else,
    then the largest pieces in clutter; and whether the image shows nothing else."""
    if kind == "chessboard":
        yield *find_corners(grey), True
        return
    marks = dark_regions(grey)
    pieces = [(marks, *piece) for piece in grow_lattices(marks, lattice)[:1]]
    if pieces and len(pieces[0][1]) >= _NOTHING_ELSE * len(marks.centers):
        marks, index, grid = pieces.pop()
        yield *complete(marks[index], grid, darkness), True
    for marks in even_edges(grey):
        pieces += [(marks, *piece) for piece in grow_lattices(marks, lattice)]
    for marks, index, grid in sorted(pieces, key=lambda piece: -len(piece[1]))[:_PIECES]:
        yield *complete(marks[index], grid, darkness), False


def _fit(
    marks: Marks, grid: NDArray[np.intp], kind: str, lattice: str
) -> tuple[Array, Array, NDArray[np.intp], Array]:
    """Fit the marks, and keep those that lie in the image and are fitted as well as the others.

    Their points (n, k, 2) with σ (n, k), their grid (n, 2), and of circles the areas (n,) in the
    image.
    """
    flat = grid.astype(np.float64)
    steps = fit_grid_map(marks.centers[:, None], flat, _MIDDLE, marks.image.shape)[0].steps(flat)
    if not np.abs(np.linalg.det(steps)).min() > 1:
        raise ValueError(f"image must show a plane grid of {kind}, got marks that are on none")
    good, points, sigma, shapes = fit_marks(marks, steps, kind)
    marks, grid, flat = marks[good], grid[good], flat[good]
    share = fill(grid)
    if share < LEAST_FULL:  # as chance puts it together
        raise ValueError(
            f"image must show a grid of {kind}, got {len(grid)} that fill {100 * share:.0f} % of "
            "the places of one"
        )
    if kind != "chessboard":
        if are_round(marks, steps[good]) != (kind == "circles"):
            raise ValueError(
                f"image must show {kind}, got {'squares' if kind == 'circles' else 'circles'}"
            )
        refuse_fields(kind, marks, grid)
    if kind == "circles":
        to_image, _ = fit_grid_map(points, flat, _MIDDLE, marks.image.shape)
        refuse_lattice(shapes @ shapes, to_image.steps(flat), lattice)
    return points, sigma, grid, np.pi * np.abs(np.linalg.det(shapes))


def _place(
    points: Array,
    sigma: Array,
    grid: NDArray[np.intp],
    areas: Array,
    lattice: str,
    turn: Array,
    image_shape: tuple[int, ...],
) -> Detection:
    """Points freed of bias, on a lattice that is tested; marks that are none of it are left out."""
    squares = points.shape[1] == 4
    offsets: Array = CORNERS @ turn if squares else _MIDDLE
    grid = np.round(grid @ turn).astype(np.intp)
    kept = np.ones(len(grid), dtype=bool)
    while True:
        points, sigma, grid, areas = points[kept], sigma[kept], grid[kept], areas[kept]
        if len(grid) < FEWEST:
            raise ValueError(f"image must show a plane grid, got {len(grid)} marks of one")
        cells = grid @ STEPS[lattice]
        to_image, positions = fit_grid_map(points, cells, offsets, image_shape)
        if squares:
            sides = np.ptp(positions[0], axis=0)
            if not 1 / _MOST_RATIO < sides[0] / sides[1] < _MOST_RATIO or sides.max() >= 1:
                raise ValueError(
                    "image must show squares on a square lattice, got rectangles of "
                    f"{sides[0]:.3g} × {sides[1]:.3g} steps"
                )
        bias = _corner_bias(to_image, positions) if squares else 0 * points
        if areas.any():
            bias = _center_bias(to_image, cells, areas)[:, None]
        to_image, positions = fit_grid_map(points - bias, cells, offsets, image_shape)
        pitch = float(np.sqrt(np.median(to_image.scale(cells))))
        kept, stated, misfit = agree(points - bias, positions, to_image, sigma, pitch)
        if kept.all():
            break  # else strays bent the map
    grid = (grid - grid.min(axis=0))[:, None]
    ends = (offsets > 0).astype(np.intp)
    side = float(np.ptp(positions[0], axis=0).mean()) if squares else 1.0
    return Detection(
        (points - bias).reshape(-1, 2),
        ((1 + squares) * grid + ends).reshape(-1, 2),
        stated.ravel(),
        np.repeat(np.arange(len(grid)), points.shape[1]),
        (grid @ STEPS[lattice] + side * ends).reshape(-1, 2),
        np.nan if areas.any() else side,
        misfit,
        (image_shape[1], image_shape[0]),
    )


def _center_bias(to_image: GridMap, cells: Array, areas: Array) -> Array:
    """How far the center of each circle's image lies from the image of its center, px."""
    radius = np.sqrt(np.median(areas / (np.pi * to_image.scale(cells))))  # in pitches
    turn = np.linspace(0, 2 * np.pi, _RIM, endpoint=False)
    # The mean over a disc, of polynomials up to the third degree, is that over this ring.
    ring = radius / np.sqrt(2) * np.column_stack([np.cos(turn), np.sin(turn)])
    within = cells[:, None] + ring
    weight = to_image.scale(within)[..., None]
    return (weight * to_image(within)).sum(axis=1) / weight.sum(axis=1) - to_image(cells)


def _corner_bias(to_image: GridMap, corners: Array) -> Array:
    """How far straight lines through distorted sides cross from the images of the corners, (n, 4,
    2), px."""
    last = np.roll(corners, -1, axis=1)
    here, there = to_image(corners), to_image(last)
    along = (there - here) / np.linalg.norm(there - here, axis=-1, keepdims=True)
    bend = to_image((corners + last) / 2) - (here + there) / 2
    bend -= (bend * along).sum(axis=-1, keepdims=True) * along
    # The mean of a parabola is two thirds of its height; near right angles one side's line moves
    # the corner along the other.
    return np.asarray(2 / 3 * (bend + np.roll(bend, 1, axis=1)))
