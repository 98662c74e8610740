"""Detection of circles, squares, or the corners of a board, in the same steps for all patterns.

1. Find marks in the grey image, and connect them to a lattice.
2. Fit the outline of each mark to the grey levels.
3. Remove the bias of the points under perspective and distortion.
4. Test that the points are the image of a lattice, and that the image shows the pattern.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.calibration._detection import MIN_MARKS, Detection
from microlib.calibration.detection._corners import find_corners
from microlib.calibration.detection._grid_map import GridMap, check_residuals, fit_grid_map
from microlib.calibration.detection._lattice import (
    CELL,
    MIDDLE,
    Index,
    check_lattice,
    complete,
    correlation,
    fill,
    grow_lattices,
    index_basis,
)
from microlib.calibration.detection._marks import Marks, dark_regions, even_edges
from microlib.calibration.detection._settings import Settings
from microlib.calibration.detection._shapes import CORNERS, FittedMarks, are_round, fit_marks

_BOARDS = ("chessboard", "charuco")


def find_pattern(
    grey: NDArray[np.float32], kinds: Sequence[str], settings: Settings
) -> tuple[str, Detection]:
    """Detect circles, squares, or the corners of a chessboard or ChArUco board in an image.

    `kinds` has one name, or "squares" and "circles", of which the first result has the name.

    Raises
    ------
    ValueError
        If the image does not show them on a square lattice.
    """
    fault = f"image must show a grid of {' or '.join(kinds)}, got none"
    for number, (marks, grid, alone) in enumerate(_candidates(grey, kinds, settings)):
        try:
            kind, found = _fit(marks, grid, kinds)
            # A homography maps any four points to any others, and clutter has many.
            if alone or np.isfinite(found.misfit):
                return kind, found
            raise ValueError(f"image must show more {kind} or nothing else, got {len(grid)}")
        except ValueError as error:
            if number == 0:  # of the largest lattice
                fault = str(error)
    raise ValueError(fault)


def _candidates(
    grey: NDArray[np.float32], kinds: Sequence[str], settings: Settings
) -> Iterator[tuple[Marks, Index, bool]]:
    """Lattices of marks, the most likely first, and whether the image shows nothing else.

    The first is a lattice of most dark regions of the image; then follow the largest lattices in
    clutter.
    """
    if kinds[0] in _BOARDS:
        yield *find_corners(grey, kinds[0], settings), True
        return
    dark = dark_regions(grey, settings)
    pieces = grow_lattices(dark)[:1]
    if pieces and len(pieces[0][1]) >= settings.only_pattern * len(dark.centers):
        yield *complete(*pieces.pop()), True
    for edges in even_edges(grey, settings):
        pieces += grow_lattices(edges)
    for piece in sorted(pieces, key=lambda piece: -len(piece[1]))[:4]:
        yield *complete(*piece), False


def _fit(marks: Marks, grid: Index, kinds: Sequence[str]) -> tuple[str, Detection]:
    """Fit the marks of a lattice, and test that they form the pattern."""
    kind = kinds[0]
    settings, shape = marks.settings, marks.image.shape
    to_image, _ = fit_grid_map(marks.centers[:, None], grid.astype(float), MIDDLE, shape)
    steps = to_image.steps(grid)
    if not to_image.scale(grid).min() > 1:
        raise ValueError(f"image must show a plane grid of {kind}, got marks that are on none")
    if kind not in _BOARDS:
        kind = "circles" if are_round(marks, steps) else "squares"
    if kind not in kinds:
        raise ValueError(f"image must show {kinds[0]}, got {kind}")
    fitted = fit_marks(marks, grid, steps, kind)
    share = fill(fitted.grid)
    if share < settings.min_fill:
        raise ValueError(f"image must show a grid of {kind}, got {share:.0%} of its marks")
    if kind == "circles":
        check_lattice(fitted.ellipses @ fitted.ellipses, fitted.steps, settings)
    basis = index_basis(fitted.points.mean(axis=1), fitted.grid)
    fitted = replace(fitted, grid=np.round(fitted.grid @ basis).astype(np.intp))
    fitted = fitted[np.lexsort(fitted.grid.T)]  # row by row, wherever the lattice was begun
    offsets: Array = CORNERS @ basis if kind == "squares" else MIDDLE
    limit = settings.max_board_residual if kind in _BOARDS else settings.max_residual
    while True:
        cells = fitted.grid.astype(float)
        unbiased = _remove_bias(fitted, cells, offsets, kind, marks)
        to_image, positions = fit_grid_map(unbiased, cells, offsets, shape)
        test = check_residuals(unbiased, positions, to_image, fitted.sigma, limit, settings)
        if test.kept.all():
            break
        fitted = fitted[test.kept]  # without the outliers, which bend the map
    side = float(np.ptp(positions[0], axis=0).mean()) if kind == "squares" else 1.0
    if kind not in _BOARDS:
        areas = np.pi * np.abs(np.linalg.det(fitted.ellipses)) / to_image.scale(cells)
        size = side if kind == "squares" else float(np.sqrt(np.median(areas)))
        centers, steps = unbiased.mean(axis=1), to_image.steps(cells)
        _check_surroundings(marks, centers, steps, size, kind)
    ends = (offsets > 0).astype(np.intp)
    # The corners of a square row by row, too.
    order = np.lexsort(ends.T)
    ends, unbiased, sigma = ends[order], unbiased[:, order], test.sigma[:, order]
    first = fitted.grid[:, None] - fitted.grid.min(axis=0)
    return kind, Detection(
        points=unbiased.reshape(-1, 2),
        grid=(first * (2 if kind == "squares" else 1) + ends).reshape(-1, 2),
        sigma=sigma.ravel(),
        group=np.repeat(np.arange(len(first)), unbiased.shape[1]),
        positions=(first + side * ends).reshape(-1, 2),
        side=np.nan if kind == "circles" else side,
        misfit=test.misfit,
        image_size=(shape[1], shape[0]),
    )


def _remove_bias(
    fitted: FittedMarks, cells: Array, offsets: Array, kind: str, marks: Marks
) -> Array:
    """Points (n, k, 2) without their bias under perspective and distortion, by a map fitted to the
    points with the bias."""
    if len(cells) < MIN_MARKS:
        raise ValueError(f"image must show a plane grid, got {len(cells)} marks of one")
    to_image, positions = fit_grid_map(fitted.points, cells, offsets, marks.image.shape)
    if kind == "squares":
        _check_squares(np.ptp(positions[0], axis=0), marks.settings)
        return fitted.points - _corner_bias(to_image, positions)
    if kind == "circles":
        areas = np.pi * np.abs(np.linalg.det(fitted.ellipses))
        return fitted.points - _center_bias(to_image, cells, areas)[:, None]
    return fitted.points


def _check_surroundings(marks: Marks, centers: Array, steps: Array, size: float, kind: str) -> None:
    """Raise an error if the image around the marks does not correlate with the drawn pattern.

    Other marks lie between the marks of a sublattice and on a chessboard.
    """
    radius = 2 * np.abs(CELL).max(axis=1)
    if kind == "circles":
        radius = np.sqrt(np.pi) * np.hypot(*CELL.T)
    drawn = np.where(radius < size, 1.0, 0.0)
    between = centers + steps.mean(axis=2)
    on_marks, between_marks = (
        float(np.median(correlation(marks.smooth, at, steps, CELL, sign * drawn)))
        for at, sign in ((centers, 1), (between, -1))
    )
    if on_marks < max(marks.settings.min_correlation, between_marks):  # between blurred circles
        raise ValueError(
            f"image must show {kind} apart from each other, got a correlation of {on_marks:.2f} "
            f"with such a pattern, and of {between_marks:.2f} between its marks"
        )


def _check_squares(sides: Array, settings: Settings) -> None:
    """Raise an error if the sides of the marks, in steps, differ or leave no gap."""
    if np.ptp(sides) > settings.max_skew * sides.min() or sides.max() >= 1:
        width, height = sides
        raise ValueError(f"image must show squares, got rectangles of {width:.3g} × {height:.3g}")


def _center_bias(to_image: GridMap, cells: Array, areas: Array) -> Array:
    """Center of the image of each circle minus the image of its center, px."""
    radius = np.sqrt(np.median(areas / (np.pi * to_image.scale(cells))))  # in pitches
    turn = np.linspace(0, 2 * np.pi, 4, endpoint=False)
    # The mean of a cubic polynomial over a disc is its mean over these four points.
    ring = radius / np.sqrt(2) * np.column_stack([np.cos(turn), np.sin(turn)])
    within = cells[:, None] + ring
    weight = to_image.scale(within)[..., None]
    return (weight * to_image(within)).sum(axis=1) / weight.sum(axis=1) - to_image(cells)


def _corner_bias(to_image: GridMap, corners: Array) -> Array:
    """Crossings of straight lines through the distorted sides minus the images of the corners,
    (n, 4, 2), px."""
    last = np.roll(corners, -1, axis=1)
    here, there = to_image(corners), to_image(last)
    along = (there - here) / np.linalg.norm(there - here, axis=-1, keepdims=True)
    bend = to_image((corners + last) / 2) - (here + there) / 2
    bend -= (bend * along).sum(axis=-1, keepdims=True) * along
    # The mean of a parabola is two thirds of its height. Near a right angle, the line of one side
    # moves the corner along the other side.
    return np.asarray(2 / 3 * (bend + np.roll(bend, 1, axis=1)))
