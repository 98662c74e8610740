"""Find a grid of circles, of squares or of the corners of a chessboard.

One way for all: grey image → marks → lattice → one fit of each mark → points freed of their bias →
the test that they lie where a lens would put a lattice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.calibration._detection import FEWEST, Detection
from microlib.calibration._grid_map import GridMap, agree, fit_grid_map
from microlib.calibration._lattice import (
    MIDDLE,
    STEPS,
    Index,
    complete,
    counting,
    darkness,
    fill,
    find_corners,
    grow_lattices,
    refuse_fields,
    refuse_lattice,
)
from microlib.calibration._marks import Marks, dark_regions, even_edges
from microlib.calibration._outlines import Rows
from microlib.calibration._settings import Settings
from microlib.calibration._shapes import CORNERS, are_round, fit_marks

#: Marks of a lattice that are fitted first, and by which a pattern is named.
FIRST = 30


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
class Wanted:
    """A pattern to look for: circles, squares or the corners of a chessboard, the lattice that they
    lie on, the direction of its x axis in the image, rad, and whether it is seen from behind."""

    kind: str
    lattice: str = "square"
    direction: float = 0.0
    mirrored: bool = False


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


def find_pattern(
    scene: Scene, wanted: Wanted, *, most: int | None = None
) -> tuple[Detection, bool]:
    """The pattern that an image shows, and whether it shows nothing else.

    With `most`, no more than so many marks of the likeliest lattice: enough to name it by.

    Raises
    ------
    ValueError
        If there is none.
    """
    kind, refusal = wanted.kind, ""
    candidates = _candidates(scene, wanted, most)
    for marks, grid, to_image, alone in islice(candidates, 1 if most else None):
        try:
            if not alone and len(grid) > 2 * FIRST:  # chance is refused by a part, and sooner
                _fit(marks[:FIRST], grid[:FIRST], to_image, wanted)
            found = _place(_fit(marks, grid, to_image, wanted), wanted, scene)
            # A homography leads to any four centers, and clutter has many.
            if alone or np.isfinite(found.misfit):
                return found, alone
            raise ValueError(f"image must show more {kind} or nothing else, got {len(grid)}")
        except ValueError as fault:
            refusal = refusal or str(fault)  # of the largest
    raise ValueError(refusal or f"image must show a grid of {kind}, got none")


def _candidates(
    scene: Scene, wanted: Wanted, most: int | None
) -> Iterator[tuple[Marks, Index, GridMap, bool]]:
    """Lattices of marks with a map to them, the most likely first: that of the image as if it
    showed nothing else, then the largest pieces in clutter; and whether the image shows nothing
    else. With `most` they are completed from so many marks."""
    if wanted.kind == "chessboard":
        yield *find_corners(scene.grey, scene.settings), True
        return
    pieces = grow_lattices(scene.dark, wanted.lattice)[:1]
    if pieces and len(pieces[0][1]) >= scene.settings.nothing_else * len(scene.dark.centers):
        marks, grid = pieces.pop()
        yield *complete(marks[:most], grid[:most], darkness), True
    for edges in scene.edges:
        pieces += grow_lattices(edges, wanted.lattice)
    for marks, grid in sorted(pieces, key=lambda piece: -len(piece[1]))[:4]:
        yield *complete(marks[:most], grid[:most], darkness), False


def _fit(marks: Marks, grid: Index, to_image: GridMap, wanted: Wanted) -> Fitted:
    """Fit the marks, and keep those that lie in the image and are fitted as well as the others."""
    kind, flat = wanted.kind, grid.astype(np.float64)
    steps = to_image.steps(flat)
    if not to_image.scale(flat).min() > 1:
        raise ValueError(f"image must show a plane grid of {kind}, got marks that are on none")
    if kind != "chessboard":
        refuse_fields(kind, marks, grid)
        if are_round(marks, steps) != (kind == "circles"):
            raise ValueError(f"image must show {kind}, got marks of another shape")
    good, points, sigma, matrices = fit_marks(marks, steps, kind)
    grid = grid[good]
    share = fill(grid)
    if share < marks.settings.least_full:  # as chance puts it together
        raise ValueError(f"image must show a grid of {kind}, got {share:.0%} of its places")
    if kind == "circles":
        refuse_lattice(matrices @ matrices, steps[good], wanted.lattice, marks.settings)
    return Fitted(points, sigma, grid, np.pi * np.abs(np.linalg.det(matrices)))


def _place(fitted: Fitted, wanted: Wanted, scene: Scene) -> Detection:
    """Points freed of bias, on a lattice that is tested; marks that are none of it are left out."""
    middles = fitted.points.mean(axis=1)
    turn = counting(middles, fitted.grid, wanted.lattice, wanted.direction, wanted.mirrored)
    squares = wanted.kind == "squares"
    offsets: Array = CORNERS @ turn if squares else MIDDLE
    shape, kept = scene.grey.shape, np.ones(len(middles), dtype=bool)
    while True:
        fitted = fitted[kept]
        if len(fitted.grid) < FEWEST:
            raise ValueError(f"image must show a plane grid, got {len(fitted.grid)} marks of one")
        points, grid = fitted.points.copy(), np.round(fitted.grid @ turn).astype(np.intp)
        cells = grid @ STEPS[wanted.lattice]
        to_image, positions = fit_grid_map(points, cells, offsets, shape)
        if squares:
            _refuse_rectangles(np.ptp(positions[0], axis=0), scene.settings)
            points -= _corner_bias(to_image, positions)
        elif wanted.kind == "circles":
            points -= _center_bias(to_image, cells, fitted.areas)[:, None]
        to_image, positions = fit_grid_map(points, cells, offsets, shape)
        kept, sigma, misfit = agree(points, positions, to_image, fitted.sigma, scene.settings)
        if kept.all():
            break  # else strays bent the map
    ends = (offsets > 0).astype(np.intp)
    side = float(np.ptp(positions[0], axis=0).mean()) if squares else 1.0
    grid = (grid - grid.min(axis=0))[:, None]
    return Detection(
        points.reshape(-1, 2),
        ((1 + squares) * grid + ends).reshape(-1, 2),
        sigma.ravel(),
        np.repeat(np.arange(len(grid)), points.shape[1]),
        (grid @ STEPS[wanted.lattice] + side * ends).reshape(-1, 2),
        np.nan if wanted.kind == "circles" else side,
        misfit,
        (shape[1], shape[0]),
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
