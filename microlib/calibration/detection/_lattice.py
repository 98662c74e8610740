"""Square lattices of marks: grown from mark to mark, completed, compared with the image, and
indexed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from microlib._common import Array
from microlib.calibration._detection import MIN_MARKS
from microlib.calibration.detection._grid_map import fit_grid_map
from microlib.calibration.detection._marks import Marks
from microlib.calibration.detection._settings import Settings

#: Integer coordinates of marks, or the indices of some.
Index = NDArray[np.intp]
#: The center, the one point of a round mark.
MIDDLE = np.zeros((1, 2))
#: Places in the cell around a mark, in steps, 16 by 16.
CELL = np.stack(np.meshgrid(*2 * [(np.arange(16) - 7.5) / 16]), axis=-1).reshape(-1, 2)


def grow_lattices(marks: Marks) -> list[tuple[Marks, Index]]:
    """Connected pieces of a square lattice among the marks, the largest first, with their
    coordinates."""
    if len(marks.centers) < MIN_MARKS:
        return []

    def may_adjoin(here: Index | int, there: Index | int) -> NDArray[np.bool_]:
        ratio = marks.areas[there] / marks.areas[here]
        return np.asarray((ratio > 1 / 2) & (ratio < 2))

    near = neighbors(marks.centers)
    index = np.arange(len(near))[:, None]
    pieces = grow_pieces(marks.centers, near, may_adjoin(index, near), may_adjoin)
    return [(marks[index], grid) for index, grid in pieces]


def neighbors(centers: Array, most: int = 12) -> Index:
    """Indices of the nearest marks of each mark, (n, k), the nearest first."""
    count = min(most + 1, len(centers))
    return np.asarray(cKDTree(centers).query(centers, k=count)[1][:, 1:], dtype=np.intp)


def grow_pieces(
    centers: Array,
    near: Index,
    suits: NDArray[np.bool_],
    may_adjoin: Callable[[int, int], NDArray[np.bool_]],
    tolerance: float = 1 / 4,
) -> list[tuple[Index, Index]]:
    """Pieces of a lattice grown from each mark: indices of the marks and their coordinates.

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
    tolerance : float
        Largest distance of a mark from its predicted place, in steps.
    """
    tree = cKDTree(centers)
    free = np.ones(len(centers), dtype=bool)
    step = centers[near] - centers[:, None]

    def first_steps(seed: int) -> Iterator[Array]:
        length = np.hypot(*step[seed].T)
        candidates = np.flatnonzero(suits[seed])
        for one in candidates[:3]:
            (x, y), (u, v) = step[seed, one], step[seed, candidates].T
            aside = np.abs(x * v - y * u) > length[one] * length[candidates] / 2
            for other in candidates[aside][:3]:
                steps = step[seed, [one, other]]
                distance, fourth = tree.query(centers[seed] + steps.sum(axis=0))
                if 3 * distance < length[one] and may_adjoin(near[seed, one], fourth):
                    yield steps

    pieces = []
    for seed in range(len(centers)):
        best: dict[tuple[int, int], int] = {}
        for steps in first_steps(seed) if free[seed] else ():
            best = max(best, _grow(centers, tree, seed, steps, may_adjoin, tolerance), key=len)
            if len(best) > 3 * MIN_MARKS:  # too many for a coincidence
                break
        if len(best) >= MIN_MARKS:
            index, grid = (np.array(list(each), dtype=np.intp) for each in (best.values(), best))
            free[index] = False
            if fill(grid) > Settings.min_fill:
                pieces.append((index, grid))
    return sorted(pieces, key=lambda piece: -len(piece[1]))


def _grow(
    centers: Array,
    tree: cKDTree,
    seed: int,
    steps: Array,
    may_adjoin: Callable[[int, int], NDArray[np.bool_]],
    tolerance: float,
) -> dict[tuple[int, int], int]:
    """Marks by their lattice coordinates, found breadth-first from the seed."""
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
            near = distance < tolerance * np.hypot(*local[axis])
            if near and index not in taken and may_adjoin(here, index):
                following = local.copy()
                following[axis] += sign * (centers[index] - centers[here])
                following[axis] /= 2
                # In perspective, steps in depth decrease as the square of steps across.
                shrunk = np.hypot(*following[axis]) / np.hypot(*local[axis])
                following[1 - axis] *= np.sqrt(shrunk)
                found[target] = int(index)
                taken.add(int(index))
                queue.append((target, following))
    return found


def complete(marks: Marks, grid: Index) -> tuple[Marks, Index]:
    """Add marks to a lattice where the image shows them at the predicted places.

    Without them, bright marks and marks under uneven light are a tenth fewer.
    """
    for _ in range(8):  # rings around the lattice
        adjoining = (grid[:, None] + [[1, 0], [-1, 0], [0, 1], [0, -1]]).reshape(-1, 2)
        absent = np.array(sorted({*map(tuple, adjoining.tolist())} - {*map(tuple, grid.tolist())}))
        cells = grid.astype(float)
        to_image, _ = fit_grid_map(marks.centers[:, None], cells, MIDDLE, marks.image.shape)
        places = to_image(absent)
        near = cKDTree(grid).query(absent)[1]
        # Half the width of a mark: two standard deviations of a disc, √3 of a square.
        extent = 2 * np.sqrt(np.einsum("nii->ni", marks.moments[near])) + 1
        limit = np.array(marks.image.shape[::-1]) - 1 - extent
        steps = mean_steps(marks.centers, grid)
        contrast = _contrast(marks.smooth, marks.centers, steps)[near]
        dark = _contrast(marks.smooth, places, steps) > marks.settings.min_contrast * contrast
        new = np.flatnonzero(dark & ((places > extent) & (places < limit)).all(axis=1))
        if len(new) == 0:
            break
        marks = marks[np.concatenate([np.arange(len(grid)), near[new]])]
        marks.centers[len(grid) :] = places[new]
        grid = np.concatenate([grid, absent[new]])
    return marks, grid


def _contrast(smooth: NDArray, centers: Array, steps: Array) -> Array:
    """Darkest grey level half a step away on the four diagonals minus that of the center."""
    across = np.array([[0, 0], [0.5, 0.5], [0.5, -0.5], [-0.5, 0.5], [-0.5, -0.5]])
    middle, *around = grey_levels(smooth, centers[:, None] + across @ steps).T
    return np.asarray(np.min(around, axis=0) - middle)


def grey_levels(smooth: NDArray, places: Array) -> Array:
    """Grey levels at places (n, k, 2), px; outside the image those of its border."""
    x, y = np.moveaxis(places.astype(np.float32), -1, 0)
    return np.asarray(cv2.remap(smooth, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def correlation(
    smooth: NDArray, centers: Array, steps: Array, places: Array, drawn: Array
) -> Array:
    """Correlation of the image around each mark with the drawn pattern, (n,).

    It is the least correlation of the four halves of the surroundings. Of a sublattice, such as
    every second mark, a half of the surroundings differs from the drawing; at the edge of a board a
    half has no contrast.

    Parameters
    ----------
    smooth : ndarray, shape (height, width)
        Image in which marks are dark.
    centers : ndarray, shape (n, 2)
        Centers of the marks, px.
    steps : ndarray, shape (n, 2, 2)
        Derivatives of the image points by the coordinates of the pattern, one column each, px.
    places : ndarray, shape (k, 2)
        Coordinates relative to a mark.
    drawn : ndarray, shape (n, k) or (k,)
        Darkness of the drawn pattern at these places.
    """
    darkness = -grey_levels(smooth, centers[:, None] + places @ steps.transpose(0, 2, 1))
    drawn = np.broadcast_to(drawn, darkness.shape)
    correlations = []
    for half in (*(places > 0).T, *(places < 0).T):
        one, two = (
            each[:, half] - each[:, half].mean(axis=1, keepdims=True) for each in (darkness, drawn)
        )
        length = np.sqrt((one**2).sum(axis=1) * (two**2).sum(axis=1))
        correlations.append((one * two).sum(axis=1) / np.maximum(length, np.finfo(float).tiny))
    return np.asarray(np.min(correlations, axis=0))


def check_lattice(shapes: Array, steps: Array, settings: Settings) -> None:
    """Raise an error if circles differ in shape, or lie on another lattice than a square one.

    The inverse of the map from lattice coordinates to the image makes one ellipse of the images of
    all circles. It is the metric of the coordinates, which the centers alone do not determine.

    Parameters
    ----------
    shapes : ndarray, shape (N, 2, 2)
        Second moments of each mark in the image, up to one factor, px².
    steps : ndarray, shape (N, 2, 2)
        Derivatives of the image by the grid's coordinates there, px.
    settings : Settings
        Settings of the detection.
    """
    inverse = np.linalg.inv(steps)
    metrics = inverse @ shapes @ inverse.transpose(0, 2, 1)
    metric = np.median(metrics, axis=0)
    deviation = np.linalg.norm(metrics - metric, axis=(1, 2)) / np.linalg.norm(metric)
    scatter = float(np.median(deviation))
    if scatter > settings.max_shape_scatter:
        raise ValueError(f"image must show marks of one shape, got a scatter of {scatter:.0%}")
    (a, b), (_, c) = np.linalg.inv(metric)  # the inner products of the steps, up to a factor
    ratio, cosine = np.sqrt(max(a, c) / min(a, c)), b / np.sqrt(a * c)
    if max(ratio - 1, abs(cosine)) > settings.max_skew:
        raise ValueError(
            f"image must show circles on a square lattice, got steps of 1 : {ratio:.2f} at "
            f"{np.rad2deg(np.arccos(cosine)):.0f}°"
        )


def fill(grid: Index) -> float:
    """Fraction of the lattice points in the convex hull of the marks that have a mark; zero for
    marks in one row."""
    if np.linalg.matrix_rank(grid - grid[0]) < 2:
        return 0.0
    places = (grid - grid.min(axis=0)).astype(np.int32)
    inside = np.zeros(places.max(axis=0)[::-1] + 1, np.uint8)
    return len(grid) / int(cv2.fillConvexPoly(inside, cv2.convexHull(places), 1).sum())


def index_basis(points: Array, grid: Index) -> Array:
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


def mean_steps(points: Array, grid: Index) -> Array:
    """Mean step in the image for each of the two coordinates, (2, 2), one row each, px."""
    design = np.column_stack([grid, np.ones(len(grid))])
    return np.linalg.lstsq(design, points, rcond=None)[0][:2]
