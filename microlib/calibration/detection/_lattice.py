"""Square lattices of marks: grown from mark to mark, completed, and indexed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import islice
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from microlib._common import Array
from microlib.calibration._detection import MIN_MARKS
from microlib.calibration.detection._grid_map import GridIndex, map_centers, plane_map
from microlib.calibration.detection._image import GreyImage
from microlib.calibration.detection._marks import Marks, dark_regions, even_edges
from microlib.calibration.detection._settings import DetectionSettings

#: Whether marks, by their numbers, may be neighbors on the lattice.
MayAdjoin = Callable[[NDArray[np.intp] | int, NDArray[np.intp] | int], NDArray[np.bool_]]


class MarkLattice(NamedTuple):
    """Marks on a lattice, which may be those of a pattern.

    Attributes
    ----------
    image : GreyImage
        Image in which the marks are dark.
    marks : Marks
        The n marks.
    grid : ndarray of int, shape (n, 2)
        Coordinates of the marks in the lattice.
    alone : bool
        Whether the image shows nothing else.
    """

    image: GreyImage
    marks: Marks
    grid: GridIndex
    alone: bool = False

    def enlarged(self, image: GreyImage, factor: int) -> MarkLattice:
        """The lattice in an image of which the present image is `GreyImage.reduced`."""
        marks = Marks(
            centers=(self.marks.centers + 0.5) * factor - 0.5,
            moments=self.marks.moments * factor**2,
            areas=self.marks.areas * factor**2,
        )
        return self._replace(image=image, marks=marks)


def search_lattices(image: GreyImage, settings: DetectionSettings) -> Iterator[MarkLattice]:
    """Lattices of marks, the most likely first.

    The first is a lattice of most dark regions of the image. The largest lattices of marks in
    clutter follow.
    """
    dark = dark_regions(image, settings)
    lattices = grow_lattices(image, dark, settings)[:1]
    if lattices and len(lattices[0].grid) >= settings.only_pattern * len(dark.centers):
        yield from _plane_lattices([lattices.pop()._replace(alone=True)], settings)
    for shown, marks in even_edges(image, settings):
        lattices += grow_lattices(shown, marks, settings)
    lattices.sort(key=lambda lattice: -len(lattice.grid))
    yield from islice(_plane_lattices(lattices, settings), 4)


def _plane_lattices(
    lattices: list[MarkLattice], settings: DetectionSettings
) -> Iterator[MarkLattice]:
    """The lattices whose marks have one shape on a plane, with the marks that were missed."""
    for lattice in lattices:
        with suppress(ValueError):  # no plane has an image with these marks
            reduced, scatter = reduce_basis(lattice)
            if scatter < settings.max_moment_scatter:
                yield complete(reduced, settings)


def grow_lattices(image: GreyImage, marks: Marks, settings: DetectionSettings) -> list[MarkLattice]:
    """Connected pieces of a square lattice among the marks, the largest first."""
    if len(marks.centers) < MIN_MARKS:
        return []

    def may_adjoin(mark: NDArray[np.intp] | int, other: NDArray[np.intp] | int) -> NDArray:
        ratio = marks.areas[other] / marks.areas[mark]
        return np.asarray((ratio > 1 / 2) & (ratio < 2))

    near = neighbors(marks.centers, settings.neighbors)
    suits = may_adjoin(np.arange(len(near))[:, None], near)
    pieces = grow_pieces(marks.centers, near, suits, may_adjoin, settings)
    return [MarkLattice(image, marks[numbers], grid) for numbers, grid in pieces]


def neighbors(centers: Array, most: int) -> NDArray[np.intp]:
    """Numbers of the nearest marks of each mark, (n, k), the nearest first."""
    count = min(most + 1, len(centers))
    return np.asarray(cKDTree(centers).query(centers, k=count)[1][:, 1:], dtype=np.intp)


def grow_pieces(
    centers: Array,
    near: NDArray[np.intp],
    suits: NDArray[np.bool_],
    may_adjoin: MayAdjoin,
    settings: DetectionSettings,
) -> list[tuple[NDArray[np.intp], GridIndex]]:
    """Pieces of a lattice grown from each mark: numbers of the marks and their coordinates.

    A piece starts from a mark and two neighbors, beside both of which lies a fourth mark. Each
    step predicts the next.

    Parameters
    ----------
    centers : ndarray, shape (N, 2)
        Centers of the marks, px, those to start from first.
    near : ndarray of int, shape (N, k)
        Neighbors of each mark, the nearest first.
    suits : ndarray of bool, shape (N, k)
        Whether the step to a neighbor may be a step of the lattice.
    may_adjoin : callable
        Function of two marks: whether they may be neighbors on the lattice.
    settings : DetectionSettings
        Settings of the detection.
    """
    tree = cKDTree(centers)
    free = np.ones(len(centers), dtype=bool)
    step = centers[near] - centers[:, None]

    def first_steps(seed: int) -> Iterator[Array]:
        length = np.hypot(*step[seed].T)
        candidates = np.flatnonzero(suits[seed])
        for first in candidates[:3]:
            (x, y), (u, v) = step[seed, first], step[seed, candidates].T
            aside = np.abs(x * v - y * u) > length[first] * length[candidates] / 2
            for second in candidates[aside][:3]:
                steps = step[seed, [first, second]]
                distance, fourth = tree.query(centers[seed] + steps.sum(axis=0))
                if 3 * distance < length[first] and may_adjoin(near[seed, first], fourth):
                    yield steps

    pieces = []
    for seed in range(len(centers)):
        best: dict[tuple[int, int], int] = {}
        for steps in first_steps(seed) if free[seed] else ():
            grown = _grow(centers, tree, seed, steps, may_adjoin, settings.step_tolerance)
            best = max(best, grown, key=len)
            if len(best) > 3 * MIN_MARKS:  # too many for a coincidence
                break
        if len(best) >= MIN_MARKS:
            numbers, grid = (np.array(list(each), dtype=np.intp) for each in (best.values(), best))
            free[numbers] = False
            if fill(grid) > settings.min_fill:
                pieces.append((numbers, grid))
    return sorted(pieces, key=lambda piece: -len(piece[1]))


def _grow(
    centers: Array,
    tree: cKDTree,
    seed: int,
    steps: Array,
    may_adjoin: MayAdjoin,
    tolerance: float,
) -> dict[tuple[int, int], int]:
    """Marks by their lattice coordinates, found breadth-first from the seed."""
    marks = {(0, 0): seed}
    taken = {seed}
    queue = deque([((0, 0), steps)])
    while queue:
        cell, local = queue.popleft()
        mark = marks[cell]
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
            target = (cell[0] + sign * (axis == 0), cell[1] + sign * (axis == 1))
            if target in marks:
                continue
            distance, nearest = tree.query(centers[mark] + sign * local[axis])
            near = distance < tolerance * np.hypot(*local[axis])
            if near and nearest not in taken and may_adjoin(mark, nearest):
                following = local.copy()
                following[axis] += sign * (centers[nearest] - centers[mark])
                following[axis] /= 2
                # In perspective, steps in depth decrease as the square of steps across.
                shrunk = np.hypot(*following[axis]) / np.hypot(*local[axis])
                following[1 - axis] *= np.sqrt(shrunk)
                marks[target] = int(nearest)
                taken.add(int(nearest))
                queue.append((target, following))
    return marks


def reduce_basis(lattice: MarkLattice) -> tuple[MarkLattice, float]:
    """The lattice with coordinates along its shortest steps on the plane of the pattern, and the
    relative scatter of the shapes of its marks there.

    A mark at the edge of the image lacks a neighbor, and a lattice that is grown from this mark may
    have a diagonal as a step.
    """
    image, marks, grid, _ = lattice
    # Without distortion, which costs half of the time of a photograph without a pattern.
    steps = plane_map(marks.centers, grid, image.grey.shape).steps(grid)
    if not np.isfinite(steps).all():
        raise ValueError("image must show a plane grid, got marks beyond its horizon")
    metric, scatter = lattice_metric(marks.moments, steps)
    products = np.linalg.inv(metric)
    basis = np.eye(2)  # the new steps in old coordinates, one row each
    for _ in range(8):  # the algorithm of Lagrange and Gauss
        (first, mixed), (_, second) = basis @ products @ basis.T
        if second < first:
            basis, first = basis[::-1], second
        basis[1] -= np.round(mixed / first) * basis[0]
    grid = np.round(grid @ np.linalg.inv(basis)).astype(np.intp)
    return lattice._replace(grid=grid), scatter


def lattice_metric(shapes: Array, steps: Array) -> tuple[Array, float]:
    """Median second moments of marks in the coordinates of their lattice, (2, 2), and the relative
    scatter of the moments.

    The moments are equal for all marks of one shape. For circles and squares, their inverse has the
    inner products of the steps on the plane of the pattern, up to a factor. The centers alone do
    not determine these products.

    Parameters
    ----------
    shapes : ndarray, shape (n, 2, 2)
        Second moments in the image, px².
    steps : ndarray, shape (n, 2, 2)
        Derivatives of the image points by the coordinates, one column each, px.
    """
    inverse = np.linalg.inv(steps)
    metrics = inverse @ shapes @ inverse.transpose(0, 2, 1)
    metric = np.median(metrics, axis=0)
    deviation = np.linalg.norm(metrics - metric, axis=(1, 2)) / np.linalg.norm(metric)
    return metric, float(np.median(deviation))


def complete(lattice: MarkLattice, settings: DetectionSettings) -> MarkLattice:
    """Add marks to a lattice where the image shows them at the predicted places.

    Without them, a third of the marks are lost where the light falls to a half, and 3 to 29 % of
    bright marks, whose contours at other grey levels have a half of their area. Of 1629 marks in 48
    photographs two are lost.
    """
    image, marks, grid, _ = lattice
    for _ in range(8):  # rings around the lattice
        adjoining = (grid[:, None] + [[1, 0], [-1, 0], [0, 1], [0, -1]]).reshape(-1, 2)
        absent = np.array(sorted({*map(tuple, adjoining.tolist())} - {*map(tuple, grid.tolist())}))
        places = map_centers(marks.centers, grid, image.grey.shape)(absent)
        near = cKDTree(grid).query(absent)[1]
        # Half the width of a mark: two standard deviations of a disc, √3 of a square.
        extent = 2 * np.sqrt(np.einsum("nii->ni", marks.moments[near])) + 1
        inside = ((places > extent) & (places < image.last_pixel - extent)).all(axis=1)
        steps = mean_steps(marks.centers, grid)
        contrast = _contrast(image, marks.centers, steps)[near]
        dark = _contrast(image, places, steps) > settings.min_contrast * contrast
        new = np.flatnonzero(dark & inside)
        if len(new) == 0:
            break
        marks = marks[np.concatenate([np.arange(len(grid)), near[new]])]
        marks.centers[len(grid) :] = places[new]
        grid = np.concatenate([grid, absent[new]])
    return lattice._replace(marks=marks, grid=grid)


def _contrast(image: GreyImage, centers: Array, steps: Array) -> Array:
    """Darkest grey level half a step away on the four diagonals minus that of the center."""
    across = np.array([[0, 0], [0.5, 0.5], [0.5, -0.5], [-0.5, 0.5], [-0.5, -0.5]])
    middle, *around = image.levels(centers[:, None] + across @ steps).T
    return np.asarray(np.min(around, axis=0) - middle)


def fill(grid: GridIndex) -> float:
    """Fraction of the lattice points in the convex hull of the marks that have a mark; zero for
    marks in one row."""
    if np.linalg.matrix_rank(grid - grid[0]) < 2:
        return 0.0
    places = (grid - grid.min(axis=0)).astype(np.int32)
    inside = np.zeros(places.max(axis=0)[::-1] + 1, np.uint8)
    return len(grid) / int(cv2.fillConvexPoly(inside, cv2.convexHull(places), 1).sum())


def index_basis(points: Array, grid: GridIndex) -> Array:
    """Matrix (2, 2) from coordinates of a lattice to those of the result.

    Their first step is that which points most to the right in the image, and their second step is
    clockwise from it, as y is from x.
    """
    steps = mean_steps(points, grid)
    axes = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    seen = axes @ steps
    first = int(np.argmax(seen[:, 0] / np.hypot(*seen.T)))
    turn = 1 if np.linalg.det(steps) > 0 else -1
    return np.linalg.inv(axes[[first, (first + turn) % 4]])


def mean_steps(points: Array, grid: GridIndex) -> Array:
    """Mean step in the image for each of the two coordinates, (2, 2), one row each, px."""
    design = np.column_stack([grid, np.ones(len(grid))])
    return np.linalg.lstsq(design, points, rcond=None)[0][:2]
