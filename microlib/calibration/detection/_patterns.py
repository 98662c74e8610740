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
    CELL,
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
from microlib.calibration.detection._settings import Settings
from microlib.calibration.detection._shapes import CORNERS, are_round, fit_marks

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


def find_pattern(scene: Scene, kind: str, lattice: str = "square") -> Detection:
    """The circles, squares, or corners of a chessboard or ChArUco board that an image shows.

    Raises
    ------
    ValueError
        If there are none on such a lattice.
    """
    refusal = ""
    for marks, grid, alone in _candidates(scene, kind, lattice):
        try:
            found = _fit(marks, grid, kind, lattice)
            # A homography leads to any four centers, and clutter has many.
            if alone or np.isfinite(found.misfit):
                return found
            raise ValueError(f"image must show more {kind} or nothing else, got {len(grid)}")
        except ValueError as fault:
            refusal = refusal or str(fault)  # of the largest
    raise ValueError(refusal or f"image must show a grid of {kind}, got none")


def _candidates(scene: Scene, kind: str, lattice: str) -> Iterator[tuple[Marks, Index, bool]]:
    """Lattices of marks, the most likely first: that of the image as if it showed nothing else,
    then the largest pieces in clutter; and whether the image shows nothing else."""
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


def _fit(marks: Marks, grid: Index, kind: str, lattice: str) -> Detection:
    """Fit the marks, and keep those that lie in the image and are fitted as well as the others."""
    shape = marks.image.shape
    to_image, _ = fit_grid_map(marks.centers[:, None], grid.astype(float), MIDDLE, shape)
    steps = to_image.steps(grid)
    if not to_image.scale(grid).min() > 1:
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
    turn = counting(points.mean(axis=1), grid, lattice)
    grid = np.round(grid @ turn).astype(np.intp)
    offsets: Array = CORNERS @ turn if kind == "squares" else MIDDLE
    areas = np.pi * np.abs(np.linalg.det(matrices))
    return _place(marks, points, sigma, grid, areas, offsets, kind, lattice)


def _place(
    marks: Marks,
    points: Array,
    sigma: Array,
    grid: Index,
    areas: Array,
    offsets: Array,
    kind: str,
    lattice: str,
) -> Detection:
    """Points freed of bias, on a lattice that is tested; marks that are none of it are left out."""
    shape, squares = marks.image.shape, kind == "squares"
    kept = np.ones(len(points), dtype=bool)
    while True:
        points, sigma, grid, areas = points[kept], sigma[kept], grid[kept], areas[kept]
        if len(grid) < FEWEST:
            raise ValueError(f"image must show a plane grid, got {len(grid)} marks of one")
        cells, free = grid @ STEPS[lattice], points.copy()
        to_image, positions = fit_grid_map(free, cells, offsets, shape)
        if squares:
            _refuse_rectangles(np.ptp(positions[0], axis=0), marks.settings)
            free -= _corner_bias(to_image, positions)
        elif kind == "circles":
            free -= _center_bias(to_image, cells, areas)[:, None]
        to_image, positions = fit_grid_map(free, cells, offsets, shape)
        # The corners of boards were held against the image; a lens may bend them more than the map.
        most = marks.settings.most_residual * (10 if kind in _BOARDS else 1)
        kept, stated, misfit = agree(free, positions, to_image, sigma, most, marks.settings.stray)
        if kept.all():
            break  # else strays bent the map
    side = float(np.ptp(positions[0], axis=0).mean()) if squares else 1.0
    if kind not in _BOARDS:
        size = side if squares else float(np.sqrt(np.median(areas / to_image.scale(cells))))
        _refuse_other_image(marks, free.mean(axis=1), to_image.steps(cells), size, kind, lattice)
    ends = (offsets > 0).astype(np.intp)
    grid = (grid - grid.min(axis=0))[:, None]
    return Detection(
        free.reshape(-1, 2),
        ((1 + squares) * grid + ends).reshape(-1, 2),
        stated.ravel(),
        np.repeat(np.arange(len(grid)), free.shape[1]),
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
    places = CELL @ STEPS[lattice]
    beyond = 2 * np.abs(places).max(axis=1)
    if kind == "circles":
        beyond = np.sqrt(np.pi) * np.hypot(*places.T)
    drawn = np.where(beyond < size, 1.0, 0.0)
    between = centers + steps @ STEPS[lattice].mean(axis=0)
    alike, other = (
        float(np.median(likeness(marks.smooth, at, steps, places, sign * drawn)))
        for at, sign in ((centers, 1), (between, -1))
    )
    if alike < max(marks.settings.least_alike, other):  # bright places between blurred circles
        raise ValueError(
            f"image must show {kind} apart from each other, got a correlation of {alike:.2f} with "
            f"such a pattern, and of {other:.2f} with what lies between"
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
