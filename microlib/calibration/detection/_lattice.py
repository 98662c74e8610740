"""Marks to a lattice: grown from mark to mark, completed, held against the image, and counted.

Round marks are seen as ellipses. Sent back through the derivatives of the map from the lattice's
coordinates to the image they all are one ellipse, and that ellipse is the metric of the
coordinates: it distinguishes a square lattice from a tilted hexagonal one, which points alone
cannot.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from microlib._common import Array
from microlib.calibration._detection import FEWEST
from microlib.calibration.detection._grid_map import fit_grid_map
from microlib.calibration.detection._marks import Marks
from microlib.calibration.detection._settings import Settings

#: Lattices by name, and the coordinates of their steps in the pattern's plane, in pitches.
STEPS = {
    "square": np.eye(2),
    "hexagonal": np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]]),
    "asymmetric": np.eye(2),
}
#: Integer coordinates of marks, or the indices of some.
Index = NDArray[np.intp]
#: Where the one point of a round mark lies in it.
MIDDLE = np.zeros((1, 2))
#: Places in the cell around a mark, in steps, 16 by 16.
CELL = np.stack(np.meshgrid(*2 * [(np.arange(16) - 7.5) / 16]), axis=-1).reshape(-1, 2)


def grow_lattices(marks: Marks, lattice: str) -> list[tuple[Marks, Index]]:
    """Pieces of lattice among the marks, the largest first, with their integer coordinates.

    From a mark with like neighbors two steps are taken that are equal and at the lattice's angle in
    the metric that the mark's own shape gives, and each step predicts the next.
    """
    if len(marks.centers) < FEWEST:
        return []
    white, near, like = _alike_neighbors(marks)
    angle = np.pi / 3 if lattice == "hexagonal" else np.pi / 2
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])

    def first_steps(seed: int) -> Iterator[Array]:
        steps = (marks.centers[near[seed]] - marks.centers[seed])[like[seed]]
        flat = steps @ white[seed]
        length = np.hypot(*flat.T)
        for first in np.argsort(length)[:4]:
            off = np.hypot(*(flat - flat[first] @ turn).T)
            second = int(np.argmin(off))
            if second != first and off[second] < length[first] / 4:
                yield steps[[first, second]]

    def alike(here: int, there: int) -> bool:
        return bool(1 / 2 < marks.areas[there] / marks.areas[here] < 2)

    seeds = np.argsort(-like.sum(axis=1), kind="stable")
    pieces = grow_pieces(marks.centers, seeds, first_steps, alike)
    return [(marks[index], grid) for index, grid in pieces]


def neighbors(centers: Array, most: int = 12) -> Index:
    """Indices of the marks next to each, (n, k), the nearest first: a hexagonal lattice has six,
    and clutter lies between."""
    count = min(most + 1, len(centers))
    return np.asarray(cKDTree(centers).query(centers, k=count)[1][:, 1:], dtype=np.intp)


def _alike_neighbors(marks: Marks) -> tuple[Array, Index, NDArray[np.bool_]]:
    """What makes a circle of each mark (n, 2, 2), its neighbors (n, k), and which are like it."""
    values, vectors = np.linalg.eigh(marks.moments)
    white = (vectors / np.sqrt(values)[:, None, :]) @ vectors.transpose(0, 2, 1)
    near = neighbors(marks.centers)
    ratio = marks.areas[near] / marks.areas[:, None]
    seen = white[:, None] @ marks.moments[near] @ white[:, None]
    shape = np.linalg.norm(seen / ratio[..., None, None] - np.eye(2), axis=(2, 3))
    return white, near, (ratio > 1 / 2) & (ratio < 2) & (shape < 1 / 2)


def grow_pieces(
    centers: Array,
    seeds: Iterable[int],
    first_steps: Callable[[int], Iterator[Array]],
    alike: Callable[[int, int], bool],
    reach: float = 1 / 4,
) -> list[tuple[Index, Index]]:
    """Pieces of lattice that grow from seeds: indices of the marks and their coordinates.

    Parameters
    ----------
    centers : ndarray, shape (N, 2)
        Places of the marks, px.
    seeds : iterable of int
        Where to begin, the likeliest marks first.
    first_steps : callable
        Yields, for a seed, two steps (2, 2) to try, px.
    alike : callable
        Says of two neighbors whether they may belong to one lattice.
    reach : float
        How far a mark may lie from where the last step predicts it, in steps.
    """
    tree = cKDTree(centers)
    free = np.ones(len(centers), dtype=bool)
    pieces = []
    for seed in map(int, seeds):
        best: dict[tuple[int, int], int] = {}
        for steps in first_steps(seed) if free[seed] else ():
            best = max(best, _grow(centers, tree, seed, steps, alike, reach), key=len)
            if len(best) > 3 * FEWEST:  # no piece of chance
                break
        if len(best) >= FEWEST:
            index, grid = (np.array(list(each), dtype=np.intp) for each in (best.values(), best))
            free[index] = False
            if fill(grid) > Settings.least_full:
                pieces.append((index, grid))
    return sorted(pieces, key=lambda piece: -len(piece[1]))


def _grow(
    centers: Array,
    tree: cKDTree,
    seed: int,
    steps: Array,
    alike: Callable[[int, int], bool],
    reach: float,
) -> dict[tuple[int, int], int]:
    """Marks by their coordinates, breadth first from the seed."""
    found = {(0, 0): seed}
    taken = {seed}
    queue = deque([((0, 0), steps)])
    while queue:
        cell, local = queue.popleft()
        here = found[cell]
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
            target = (cell[0] + sign * (axis == 0), cell[1] + sign * (axis == 1))
            if target in found:
                continue
            distance, index = tree.query(centers[here] + sign * local[axis])
            near = distance < reach * np.hypot(*local[axis])
            if near and index not in taken and alike(here, index):
                following = local.copy()
                following[axis] += sign * (centers[index] - centers[here])
                following[axis] /= 2
                # In perspective a step in depth shrinks as the square of one across.
                shrunk = np.hypot(*following[axis]) / np.hypot(*local[axis])
                following[1 - axis] *= np.sqrt(shrunk)
                found[target] = int(index)
                taken.add(int(index))
                queue.append((target, following))
    return found


def complete(marks: Marks, grid: Index) -> tuple[Marks, Index]:
    """The marks of a lattice, with those that the image shows where it would have them."""
    for _ in range(8):  # rings around the lattice
        beside = (grid[:, None] + [[1, 0], [-1, 0], [0, 1], [0, -1]]).reshape(-1, 2)
        absent = np.array(sorted({*map(tuple, beside.tolist())} - {*map(tuple, grid.tolist())}))
        cells = grid.astype(float)
        to_image, _ = fit_grid_map(marks.centers[:, None], cells, MIDDLE, marks.image.shape)
        places = to_image(absent)
        near = cKDTree(grid).query(absent)[1]
        # Half a mark's width: two standard deviations of a circle's area, √3 of a square's.
        reach = 2 * np.sqrt(np.einsum("nii->ni", marks.moments[near])) + 1
        limit = np.array(marks.image.shape[::-1]) - 1 - reach
        steps = mean_steps(marks.centers, grid)
        held = _darkness(marks.smooth, marks.centers, steps)[near]
        dark = _darkness(marks.smooth, places, steps) > marks.settings.least_contrast * held
        new = np.flatnonzero(dark & ((places > reach) & (places < limit)).all(axis=1))
        if len(new) == 0:
            break
        marks = marks[np.concatenate([np.arange(len(grid)), near[new]])]
        marks.centers[len(grid) :] = places[new]
        grid = np.concatenate([grid, absent[new]])
    return marks, grid


def _darkness(smooth: NDArray, centers: Array, steps: Array) -> Array:
    """Grey levels half a step away on all four sides across, less that in the middle."""
    across = np.array([[0, 0], [0.5, 0.5], [0.5, -0.5], [-0.5, 0.5], [-0.5, -0.5]])
    middle, *around = _levels(smooth, centers[:, None] + across @ steps).T
    return np.asarray(np.min(around, axis=0) - middle)


def _levels(smooth: NDArray, places: Array) -> Array:
    """Grey levels at places (n, k, 2), px; beside the image those of its border."""
    x, y = np.moveaxis(places.astype(np.float32), -1, 0)
    return np.asarray(cv2.remap(smooth, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def likeness(smooth: NDArray, centers: Array, steps: Array, places: Array, drawn: Array) -> Array:
    """Correlation of the image around each mark with the pattern as it is drawn, (n,): the least of
    the four halves of what surrounds the mark.

    A part of the pattern, as a lattice of every second mark, has something else in a half of its
    cells; at the rim of a board a half has no contrast.

    Parameters
    ----------
    smooth : ndarray, shape (height, width)
        Image in which marks are dark.
    centers : ndarray, shape (n, 2)
        Places of the marks, px.
    steps : ndarray, shape (n, 2, 2)
        Derivatives of the image points by the pattern's coordinates there: one column each, px.
    places : ndarray, shape (k, 2)
        Coordinates beside a mark.
    drawn : ndarray, shape (n, k) or (k,)
        How much light the pattern takes there.
    """
    taken = -_levels(smooth, centers[:, None] + places @ steps.transpose(0, 2, 1))
    drawn = np.broadcast_to(drawn, taken.shape)
    correlations = []
    for half in (*(places > 0).T, *(places < 0).T):
        one, two = (
            each[:, half] - each[:, half].mean(axis=1, keepdims=True) for each in (taken, drawn)
        )
        length = np.sqrt((one**2).sum(axis=1) * (two**2).sum(axis=1))
        correlations.append((one * two).sum(axis=1) / np.maximum(length, np.finfo(float).tiny))
    return np.asarray(np.min(correlations, axis=0))


def refuse_lattice(shapes: Array, steps: Array, lattice: str, settings: Settings) -> None:
    """Refuse marks that are not of one shape, or lie on another lattice than the one named.

    Parameters
    ----------
    shapes : ndarray, shape (N, 2, 2)
        Second moments of each mark in the image, up to one factor, px².
    steps : ndarray, shape (N, 2, 2)
        Derivatives of the image by the grid's coordinates there, px.
    lattice : str
        What it must be: one of `STEPS`.
    settings : Settings
        Those of the detection.
    """
    inverse = np.linalg.inv(steps)
    metrics = inverse @ shapes @ inverse.transpose(0, 2, 1)
    metric = np.median(metrics, axis=0)
    beside = np.linalg.norm(metrics - metric, axis=(1, 2)) / np.linalg.norm(metric)
    scatter = float(np.median(beside))
    if scatter > settings.most_scatter:
        raise ValueError(f"image must show marks of one shape, got a scatter of {scatter:.0%}")
    (a, b), (_, c) = np.linalg.inv(metric)  # the inner products of the steps, up to a factor
    ratio, cosine = np.sqrt(max(a, c) / min(a, c)), b / np.sqrt(a * c)
    wanted = 0.5 if lattice == "hexagonal" else 0.0
    if max(ratio - 1, abs(cosine - wanted)) > settings.most_skew:
        name = "hexagonal" if wanted else "square"
        raise ValueError(
            f"image must show circles on a {name} lattice, got steps of 1 : {ratio:.2f} at "
            f"{np.rad2deg(np.arccos(cosine)):.0f}°"
        )


def fill(grid: Index) -> float:
    """Part of a lattice's places inside the convex hull of the marks that hold one; zero for marks
    in one row."""
    if np.linalg.matrix_rank(grid - grid[0]) < 2:
        return 0.0
    places = (grid - grid.min(axis=0)).astype(np.int32)
    inside = np.zeros(places.max(axis=0)[::-1] + 1, np.uint8)
    return len(grid) / int(cv2.fillConvexPoly(inside, cv2.convexHull(places), 1).sum())


def counting(points: Array, grid: Index, lattice: str) -> Array:
    """Matrix (2, 2) by which coordinates of equal steps become those whose first step points most
    to the right in the image, and whose second is clockwise from it, as y is from x."""
    along = mean_steps(points, grid)
    axes = np.array([[1, 0], [0, 1], [-1, 1]][: 3 if lattice == "hexagonal" else 2])
    axes = np.concatenate([axes, -axes])  # all the way round
    seen = axes @ along
    # The square lattice of an asymmetric grid stands on a corner.
    right = [1, 1] if lattice == "asymmetric" else [1, 0]
    first = int(np.argmax(seen @ right / np.hypot(*seen.T)))
    turn = 1 if np.linalg.det(along) > 0 else -1
    basis = np.linalg.inv(np.stack([axes[first], axes[(first + turn) % len(axes)]]))
    return basis @ [[1, 1], [-1, 1]] if lattice == "asymmetric" else basis


def mean_steps(points: Array, grid: Index) -> Array:
    """Mean step in the image for each of the two coordinates, (2, 2), px."""
    design = np.column_stack([grid, np.ones(len(grid))])
    return np.linalg.lstsq(design, points, rcond=None)[0][:2]
