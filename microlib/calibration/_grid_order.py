"""Find the integer coordinates of points that lie on a bent, tilted and incomplete lattice."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from microlib._common import Array, as_array
from microlib.calibration._detection import FEWEST

#: A neighbor is accepted within this part of a step from where the step before predicts it;
#: 0.15 to 0.35 find the same lattices.
_REACH = 0.25
#: Two differences are votes for one step if they are this near each other, as a part of it; 0.08
#: to 0.3 find the same lattices.
_ALIKE = 0.15
#: Least angle between the two steps, rad: between the 90° of a lattice seen from the front and
#: the 45° of its diagonals.
_LEAST_ANGLE = np.deg2rad(55)
#: Each point has four neighbors in a lattice, and itself.
_NEAR = 5
#: The quadratic map has six coefficients for each coordinate; it is used with twice as many points.
_FEWEST_FOR_MAP = 12


def order_grid(
    points: ArrayLike, *, direction: float = 0.0, mirrored: bool = False
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Integer coordinates of the points of a lattice seen by a camera.

    Two steps of the lattice are voted for by the differences between near neighbors; from a seed
    the lattice then grows step by step, each step predicting the next, so that perspective,
    distortion and holes do no harm. Points that do not fit are left out.

    Parameters
    ----------
    points : array_like, shape (N, 2)
        (x, y), px.
    direction : float
        Direction in the image in which the pattern's x axis points, rad from x towards y; right to
        within 45° is enough. A regular lattice cannot tell which of its four axes is meant.
    mirrored : bool
        True if the pattern is seen from behind (γ near 180°), so that its axes turn the other way.

    Returns
    -------
    index : ndarray of int, shape (M,)
        Which of the points belong to the lattice.
    grid : ndarray of int, shape (M, 2)
        Their coordinates, from zero on along each axis.

    Raises
    ------
    ValueError
        If there are fewer than four points, or no lattice of at least four points that span a
        plane.

    Examples
    --------
    >>> points = np.array([[10.0, 10], [30, 11], [9, 30], [29, 31], [70, 80]])
    >>> index, grid = order_grid(points)
    >>> index.tolist(), grid.tolist()
    ([0, 1, 2, 3], [[0, 0], [1, 0], [0, 1], [1, 1]])
    """
    points = as_array("points", points, shape=(None, 2))
    if len(points) < FEWEST:
        raise ValueError(f"points must be at least {FEWEST} to show a lattice, got {len(points)}")
    steps = _basis(points)
    index, grid = _attach(points, *_grow(points, steps))
    if len(index) < FEWEST or np.linalg.matrix_rank(grid - grid.mean(axis=0)) < 2:
        raise ValueError(f"points must show a lattice, got {len(points)} that do not")
    axes = _axes(points[index], grid, direction, mirrored)
    grid = grid @ axes
    order = np.argsort(index)
    return index[order], (grid - grid.min(axis=0))[order]


def _basis(points: Array) -> Array:
    """Two steps of the lattice: the differences between near neighbors that most others
    resemble."""
    near = min(_NEAR, len(points))
    _, neighbor = cKDTree(points).query(points, k=near)
    vectors = (points[neighbor[:, 1:]] - points[:, None]).reshape(-1, 2)
    vectors = np.concatenate([vectors, -vectors])
    length = np.hypot(*vectors.T)
    if not (length > 0).all():
        raise ValueError("points must differ from each other, got two that coincide")
    tree = cKDTree(vectors)

    def densest(among: NDArray[np.intp]) -> Array:
        reach = _ALIKE * length[among]
        votes = tree.query_ball_point(vectors[among], reach, return_length=True)
        winner = among[np.argmax(votes)]
        return vectors[tree.query_ball_point(vectors[winner], _ALIKE * length[winner])].mean(axis=0)

    first = densest(np.arange(len(vectors)))
    cosine = np.abs(vectors @ first) / (length * np.hypot(*first))
    across = np.flatnonzero(cosine < np.cos(_LEAST_ANGLE))
    if len(across) == 0:
        raise ValueError("points must show a lattice, got points on one line")
    return np.stack([first, densest(across)])


def _grow(points: Array, steps: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Largest connected piece of lattice: indices of its points and their coordinates."""
    tree = cKDTree(points)
    free = np.ones(len(points), dtype=bool)
    best: dict[tuple[int, int], int] = {}
    middle = np.argsort(np.hypot(*(points - points.mean(axis=0)).T))
    for seed in middle:
        if not free[seed] or free.sum() <= len(best):
            continue
        piece = _grow_from(int(seed), points, tree, steps)
        free[list(piece.values())] = False
        best = max(best, piece, key=len)
    return np.fromiter(best.values(), dtype=np.intp), np.array(list(best), dtype=np.intp)


def _grow_from(seed: int, points: Array, tree: cKDTree, steps: Array) -> dict[tuple[int, int], int]:
    found = {(0, 0): seed}
    taken = {seed}
    queue = deque([((0, 0), steps)])
    while queue:
        cell, local = queue.popleft()
        here = points[found[cell]]
        for axis in (0, 1):
            for sign in (1, -1):
                shift = sign * np.eye(2, dtype=int)[axis]
                target = (int(cell[0] + shift[0]), int(cell[1] + shift[1]))
                if target in found:
                    continue
                distance, index = tree.query(here + sign * local[axis])
                if distance > _REACH * np.hypot(*local[axis]) or int(index) in taken:
                    continue
                following = local.copy()
                following[axis] = (local[axis] + sign * (points[index] - here)) / 2
                found[target] = int(index)
                taken.add(int(index))
                queue.append((target, following))
    return found


def _attach(
    points: Array, index: NDArray[np.intp], grid: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Add the points beyond holes: a quadratic map from the image to the lattice finds their
    place."""
    rest = np.setdiff1d(np.arange(len(points)), index)
    if len(index) < _FEWEST_FOR_MAP or len(rest) == 0:
        return index, grid
    center, size = points[index].mean(axis=0), np.ptp(points[index])
    x, y = ((points - center) / size).T
    basis = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    place = basis[rest] @ np.linalg.lstsq(basis[index], grid, rcond=None)[0]
    cell = np.round(place).astype(np.intp)
    taken = set(map(tuple, grid.tolist()))
    for k in np.flatnonzero(np.hypot(*(place - cell).T) < _REACH / 2):
        if tuple(cell[k].tolist()) not in taken:
            taken.add(tuple(cell[k].tolist()))
            index, grid = np.append(index, rest[k]), np.vstack([grid, cell[k]])
    return index, grid


def mean_steps(points: Array, grid: NDArray[np.intp]) -> Array:
    """Mean step in the image for each of the two coordinates, (2, 2), px."""
    design = np.column_stack([grid, np.ones(len(grid))])
    return np.linalg.lstsq(design, points, rcond=None)[0][:2]


def _axes(
    points: Array, grid: NDArray[np.intp], direction: float, mirrored: bool
) -> NDArray[np.intp]:
    """Signed permutation from the grown coordinates to those with the wanted direction and
    sense."""
    along = mean_steps(points, grid)
    unit = along / np.hypot(*along.T)[:, None]
    score = unit @ [np.cos(direction), np.sin(direction)]
    x = int(np.argmax(np.abs(score)))
    axes = np.zeros((2, 2), dtype=np.intp)
    axes[x, 0] = 1 if score[x] > 0 else -1
    turn = np.linalg.det(np.stack([axes[x, 0] * along[x], along[1 - x]]))
    axes[1 - x, 1] = 1 if (turn > 0) != mirrored else -1
    return axes
