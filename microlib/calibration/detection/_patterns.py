"""Find a grid of circles, of squares or of the corners of a board.

One way for all: grey image → marks → lattice → one fit of each mark → points freed of their bias →
the tests that they lie where a lens would put a lattice, and that the image shows the pattern.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.calibration._detection import FEWEST, Detection
from microlib.calibration.detection._corners import find_corners
from microlib.calibration.detection._grid_map import GridMap, agree, fit_grid_map
from microlib.calibration.detection._lattice import (
    MIDDLE,
    STEPS,
    Index,
    complete,
    counting,
    fill,
    grow_lattices,
    likeness,
    refuse_lattice,
)
from microlib.calibration.detection._marks import Marks, dark_regions, even_edges
from microlib.calibration.detection._outlines import Rows
from microlib.calibration.detection._settings import Settings
from microlib.calibration.detection._shapes import CORNERS, are_round, fit_marks

#: Marks of a lattice in clutter that are fitted first, since chance is refused by them, and sooner.
_FIRST = 30
_BOARDS = ("chessboard", "charuco")


@dataclass(frozen=True, eq=False)
class Scene:
    """An image and its marks, which are looked for when they are first asked for.

    Parameters
    ----------
    grey : ndarray of float32, shape (height, width)
        Grey levels.
    settings : Settings
        Those of the detection.
    """

    grey: NDArray[np.float32]
    settings: Settings = field(default_factory=Settings)

    @cached_property
    def dark(self) -> Marks:
        """The dark regions of an even ground."""
        return dark_regions(self.grey, self.settings)

    @cached_property
    def edges(self) -> list[Marks]:
        """What even edges surround in clutter, dark and bright."""
        return even_edges(self.grey, self.settings)


@dataclass(frozen=True)
class Fitted(Rows):
    """Marks of a lattice as they were fitted.

    Parameters
    ----------
    points, sigma : ndarray, shapes (n, k, 2) and (n, k)
        Of each mark, px, and the standard deviation of a coordinate.
    grid : ndarray of int, shape (n, 2)
        Places in the lattice.
    areas : ndarray, shape (n,)
        Of circles in the image, px²; zero of others.
    """

    points: Array
    sigma: Array
    grid: Index
    areas: Array


def find_pattern(scene: Scene, kind: str, lattice: str = "square") -> Detection:
    """The circles, squares, or corners of a chessboard or ChArUco board that an image shows.

    Raises
    ------
    ValueError
        If there are none on such a lattice.
    """
    refusal = ""
    for marks, grid, to_image, alone in _candidates(scene, kind, lattice):
        try:
            if not alone and len(grid) > 2 * _FIRST:
                _fit(marks[:_FIRST], grid[:_FIRST], to_image, kind, lattice)
            fitted = _fit(marks, grid, to_image, kind, lattice)
            found = _place(fitted, marks, kind, lattice)
            # A homography leads to any four centers, and clutter has many.
            if alone or np.isfinite(found.misfit):
                return found
            raise ValueError(f"image must show more {kind} or nothing else, got {len(grid)}")
        except ValueError as fault:
            refusal = refusal or str(fault)  # of the largest
    raise ValueError(refusal or f"image must show a grid of {kind}, got none")


def _candidates(
    scene: Scene, kind: str, lattice: str
) -> Iterator[tuple[Marks, Index, GridMap, bool]]:
    """Lattices of marks with a map to them, the most likely first: that of the image as if it
    showed nothing else, then the largest pieces in clutter; and whether the image shows nothing
    else."""
    if kind in _BOARDS:
        yield *find_corners(scene.grey, kind, scene.settings), True
        return
    pieces = grow_lattices(scene.dark, lattice)[:1]
    if pieces and len(pieces[0][1]) >= scene.settings.nothing_else * len(scene.dark.centers):
        yield *complete(*pieces.pop()), True
    for edges in scene.edges:
        pieces += grow_lattices(edges, lattice)
    for piece in sorted(pieces, key=lambda piece: -len(piece[1]))[:4]:
        yield *complete(*piece), False


def _fit(marks: Marks, grid: Index, to_image: GridMap, kind: str, lattice: str) -> Fitted:
    """Fit the marks, and keep those that lie in the image and are fitted as well as the others."""
    flat = grid.astype(np.float64)
    steps = to_image.steps(flat)
    if not to_image.scale(flat).min() > 1:
        raise ValueError(f"image must show a plane grid of {kind}, got marks that are on none")
    if kind not in _BOARDS and are_round(marks, steps) != (kind == "circles"):
        raise ValueError(f"image must show {kind}, got marks of another shape")
    good, points, sigma, matrices = fit_marks(marks, steps, kind)
    grid = grid[good]
    share = fill(grid)
    if share < marks.settings.least_full:  # as chance puts it together
        raise ValueError(f"image must show a grid of {kind}, got {share:.0%} of its places")
    if kind == "circles":
        refuse_lattice(matrices @ matrices, steps[good], lattice, marks.settings)
    return Fitted(points, sigma, grid, np.pi * np.abs(np.linalg.det(matrices)))


def _place(fitted: Fitted, marks: Marks, kind: str, lattice: str) -> Detection:
    """Points freed of bias, on a lattice that is tested; marks that are none of it are left out."""
    middles = fitted.points.mean(axis=1)
    turn = counting(middles, fitted.grid, lattice)
    squares = kind == "squares"
    offsets: Array = CORNERS @ turn if squares else MIDDLE
    shape, kept = marks.image.shape, np.ones(len(middles), dtype=bool)
    while True:
        fitted = fitted[kept]
        if len(fitted.grid) < FEWEST:
            raise ValueError(f"image must show a plane grid, got {len(fitted.grid)} marks of one")
        points, grid = fitted.points.copy(), np.round(fitted.grid @ turn).astype(np.intp)
        cells = grid @ STEPS[lattice]
        to_image, positions = fit_grid_map(points, cells, offsets, shape)
        if squares:
            _refuse_rectangles(np.ptp(positions[0], axis=0), marks.settings)
            points -= _corner_bias(to_image, positions)
        elif kind == "circles":
            points -= _center_bias(to_image, cells, fitted.areas)[:, None]
        to_image, positions = fit_grid_map(points, cells, offsets, shape)
        kept, sigma, misfit = agree(points, positions, to_image, fitted.sigma, marks.settings)
        if kept.all():
            break  # else strays bent the map
    ends = (offsets > 0).astype(np.intp)
    side = float(np.ptp(positions[0], axis=0).mean()) if squares else 1.0
    size = side if squares else float(np.sqrt(np.median(fitted.areas / to_image.scale(cells))))
    if kind not in _BOARDS:
        _refuse_other_image(marks, points.mean(axis=1), to_image.steps(cells), size, kind, lattice)
    grid = (grid - grid.min(axis=0))[:, None]
    return Detection(
        points.reshape(-1, 2),
        ((1 + squares) * grid + ends).reshape(-1, 2),
        sigma.ravel(),
        np.repeat(np.arange(len(grid)), points.shape[1]),
        (grid @ STEPS[lattice] + side * ends).reshape(-1, 2),
        np.nan if kind == "circles" else side,
        misfit,
        (shape[1], shape[0]),
    )


def _refuse_other_image(
    marks: Marks, centers: Array, steps: Array, size: float, kind: str, lattice: str
) -> None:
    """Refuse marks whose surroundings are not those of the pattern as it is drawn: with other marks
    between them, as in a lattice of every second one or on a chessboard."""
    side = (np.arange(16) + 1 / 2) / 16 - 1 / 2
    places = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    flat = np.abs(places @ STEPS[lattice])
    beyond = np.hypot(*flat.T) * np.sqrt(np.pi) if kind == "circles" else 2 * flat.max(axis=1)
    drawn = (beyond < size).astype(float)
    alike = float(np.median(likeness(marks.smooth, centers, steps, places @ STEPS[lattice], drawn)))
    if alike < marks.settings.least_alike:
        raise ValueError(
            f"image must show {kind} apart from each other, got other marks between them: "
            f"the image correlates with the pattern by {alike:.2f}"
        )


def _refuse_rectangles(sides: Array, settings: Settings) -> None:
    """Refuse marks whose sides, in steps, are not those of squares, or leave no gap."""
    if np.ptp(sides) > settings.most_skew * sides.min() or sides.max() >= 1:
        width, height = sides
        raise ValueError(f"image must show squares, got rectangles of {width:.3g} × {height:.3g}")


def _center_bias(to_image: GridMap, cells: Array, areas: Array) -> Array:
    """How far the center of each circle's image lies from the image of its center, px."""
    radius = np.sqrt(np.median(areas / (np.pi * to_image.scale(cells))))  # in pitches
    turn = np.linspace(0, 2 * np.pi, 4, endpoint=False)
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
