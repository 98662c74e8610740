"""Marks to a lattice: grown from mark to mark, of a chessboard as OpenCV finds it; completed, named
by the marks' shapes, and counted.

Round marks are seen as ellipses. Sent back through the derivatives of the map from the lattice's
coordinates to the image they all are one ellipse, and that ellipse is the metric of the
coordinates: it tells a square lattice from a tilted hexagonal one, which points alone cannot.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, cKDTree

from microlib._common import Array
from microlib.calibration._detection import FEWEST
from microlib.calibration._grid_map import GridMap, fit_grid_map
from microlib.calibration._marks import Marks, to_bytes
from microlib.calibration._settings import Settings

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
#: Places half a step from a mark, across and along the axes.
_ACROSS = np.array([[0.5, 0.5], [0.5, -0.5], [-0.5, 0.5], [-0.5, -0.5]])
_ALONG = np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])


def grow_lattices(marks: Marks, lattice: str) -> list[tuple[Marks, Index]]:
    """Pieces of lattice among the marks, the largest first, with their integer coordinates.

    From a mark with like neighbors two steps are taken that are equal and at the lattice's angle in
    the metric that the mark's own shape tells, and each step predicts the next.
    """
    if len(marks.centers) < FEWEST:
        return []
    tree = cKDTree(marks.centers)
    white, near, like = _alike_neighbors(marks, tree)
    angle = np.pi / 3 if lattice == "hexagonal" else np.pi / 2
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    free = np.ones(len(marks.centers), dtype=bool)
    pieces = []
    for seed in np.argsort(-like.sum(axis=1), kind="stable").tolist():
        steps = (marks.centers[near[seed]] - marks.centers[seed])[like[seed]]
        if not free[seed] or len(steps) < 2:
            continue
        best: dict[tuple[int, int], int] = {}
        for first, second in _first_steps(steps @ white[seed], turn):
            best = max(best, _grow(marks, tree, seed, steps[[first, second]]), key=len)
            if len(best) > marks.settings.near:  # no chance piece
                break
        if len(best) >= FEWEST:
            index, grid = (np.array(list(each), dtype=np.intp) for each in (best.values(), best))
            free[index] = False
            if fill(grid) > marks.settings.least_full:
                pieces.append((marks[index], grid))
    return sorted(pieces, key=lambda piece: -len(piece[1]))


def _alike_neighbors(marks: Marks, tree: cKDTree) -> tuple[Array, Index, NDArray[np.bool_]]:
    """What makes a circle of each mark (n, 2, 2), its neighbors (n, k), and which are like it."""
    values, vectors = np.linalg.eigh(marks.moments)
    white = (vectors / np.sqrt(values)[:, None, :]) @ vectors.transpose(0, 2, 1)
    count = min(marks.settings.near + 1, len(marks.centers))
    near = tree.query(marks.centers, k=count)[1][:, 1:]
    ratio = marks.areas[near] / marks.areas[:, None]
    seen = white[:, None] @ marks.moments[near] @ white[:, None]
    shape = np.linalg.norm(seen / ratio[..., None, None] - np.eye(2), axis=(2, 3))
    return white, near, (ratio > 1 / 2) & (ratio < 2) & (shape < 1 / 2)


def _first_steps(flat: Array, turn: Array) -> Iterator[tuple[int, int]]:
    """Pairs of steps, in the mark's metric, of which the second is the first, turned, or nearly;
    of the four shortest."""
    length = np.hypot(*flat.T)
    for first in np.argsort(length)[:4]:
        off = np.hypot(*(flat - flat[first] @ turn).T)
        second = int(np.argmin(off))
        if second != first and off[second] < length[first] / 4:
            yield int(first), second


def _grow(marks: Marks, tree: cKDTree, seed: int, steps: Array) -> dict[tuple[int, int], int]:
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
            distance, index = tree.query(marks.centers[here] + sign * local[axis])
            alike = 1 / 2 < marks.areas[index] / marks.areas[here] < 2
            if alike and index not in taken and distance < np.hypot(*local[axis]) / 4:
                following = local.copy()
                following[axis] += sign * (marks.centers[index] - marks.centers[here])
                following[axis] /= 2
                found[target] = int(index)
                taken.add(int(index))
                queue.append((target, following))
    return found


def complete(
    marks: Marks, grid: Index, contrast: Callable[..., Array]
) -> tuple[Marks, Index, GridMap]:
    """The marks of a lattice, with those that the image shows where it would have them, and the map
    from its coordinates to the image.

    `contrast` tells them, from the smoothed image, places and the lattice's mean steps.
    """
    for _ in range(8):  # rings around the lattice
        beside = (grid[:, None] + (2 * _ALONG).astype(int)).reshape(-1, 2)
        taken = set(map(tuple, grid.tolist()))
        absent = np.array(sorted({*map(tuple, beside.tolist())} - taken), dtype=np.intp)
        some = slice(None, None, 1 + len(grid) // 200)  # of many, evenly, that tell it well enough
        cells = grid[some].astype(np.float64)
        to_image, _ = fit_grid_map(marks.centers[some, None], cells, MIDDLE, marks.image.shape)
        places = to_image(absent.astype(np.float64))
        near = np.linalg.norm(absent[:, None] - grid, axis=2).argmin(axis=1)
        # Half a mark's width: two standard deviations of a circle's area, √3 of a square's.
        reach = 2 * np.sqrt(np.einsum("nii->ni", marks.moments[near])) + 1
        limit = np.array(marks.image.shape[::-1]) - 1 - reach
        new = np.flatnonzero(((places > reach) & (places < limit)).all(axis=1))
        steps = mean_steps(marks.centers, grid)
        held = contrast(marks.smooth, marks.centers, steps)[near[new]]
        new = new[contrast(marks.smooth, places[new], steps) > marks.settings.least_contrast * held]
        if len(new) == 0:
            break
        marks = marks[np.concatenate([np.arange(len(grid)), near[new]])]
        marks.centers[len(grid) :] = places[new]
        grid = np.concatenate([grid, absent[new]])
    return marks, grid, to_image


def find_corners(grey: NDArray[np.float32], settings: Settings) -> tuple[Marks, Index, GridMap]:
    """Corners of a board, each with the moments of a circle within its fields, their grid, and the
    map from that to the image.

    Raises
    ------
    ValueError
        If the image shows no chessboard of at least three by three corners.
    """
    smooth: NDArray = cv2.GaussianBlur(grey, (0, 0), 1.0)
    centers, grid = _opencv_corners(grey)
    # Corners of chance, as between blurred circles, lie on no plane.
    beside = max(1 / 4 * np.sqrt(np.abs(np.linalg.det(mean_steps(centers, grid)))), 1.0)
    inside = cv2.findHomography(grid.astype(np.float64), centers, cv2.RANSAC, beside)[1]
    kept = np.ones(len(grid), dtype=bool) if inside is None else inside.ravel() > 0
    centers, grid = _alternating(smooth, centers[kept], grid[kept])
    if len(grid) < 3 * 3:
        raise ValueError(f"image must show a chessboard, got {len(grid)} corners on a plane one")
    side = np.sqrt(np.abs(np.linalg.det(mean_steps(centers, grid))))
    moments = np.tile((side / 6) ** 2 * np.eye(2), (len(grid), 1, 1))
    marks = Marks(grey, smooth, centers, moments, np.full(len(grid), side**2), settings)
    return complete(marks, grid, lambda *at: np.abs(saddle(*at)))


def _opencv_corners(grey: NDArray[np.float32]) -> tuple[Array, Index]:
    """What OpenCV takes for the corners of a board, and the column and row of each."""
    eight = to_bytes(grey)
    half = cv2.pyrDown(cv2.GaussianBlur(eight, (0, 0), 2.0))
    # It is asked for parts of a larger board. Of 26 photographs it gives 46 to 54 of 54 corners in
    # the blurred half image, in the whole one of some only five.
    quick = cv2.CALIB_CB_LARGER
    thorough = quick | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    for scale, image, board, flags in ((2, half, (5, 4), quick), (1, eight, (3, 3), thorough)):
        found, corners, meta = cv2.findChessboardCornersSBWithMeta(image, board, flags)
        if found:
            grid = np.argwhere(np.ones(np.shape(meta)))[:, ::-1]  # by rows
            return scale * np.asarray(corners, dtype=np.float64).reshape(-1, 2), grid
    raise ValueError("image must show a chessboard, got none")


def _alternating(smooth: NDArray, centers: Array, grid: Index) -> tuple[Array, Index]:
    """The corners between fields of a board, where from corner to corner dark and bright change
    places, and their grid with the rows that were skipped."""
    # A third of a step is within a field also where every second row was skipped.
    dark = saddle(smooth, centers, mean_steps(centers, grid) / 3)
    ways = [dark * (-1.0) ** (grid @ np.array(changes)) for changes in np.ndindex(2, 2)]
    best = int(np.argmax([np.abs(np.sign(way).sum()) for way in ways]))
    # What OpenCV gives beyond the board has no such fields, and would bend the map.
    alternate = np.abs(ways[best].sum()) / len(grid) / 2
    kept = ways[best] * np.sign(ways[best].sum()) > alternate
    return centers[kept], grid[kept] * (2 - np.array(np.unravel_index(best, (2, 2))))


def refuse_fields(kind: str, marks: Marks, grid: Index) -> None:
    """Refuse marks between which there is more than ground: fields of a chessboard, or a part of a
    finer lattice. The grey levels half a step away along the axes and across differ there."""
    steps = mean_steps(marks.centers, grid)
    middle = _levels(marks.smooth, marks.centers)[:, None]
    beside = [_levels(marks.smooth, marks.centers[:, None] + h @ steps) for h in (_ACROSS, _ALONG)]
    across, along = (float(np.median(levels - middle)) for levels in beside)
    if min(across, along) < 3 / 4 * max(across, along):
        raise ValueError(f"image must show {kind} apart from each other, got marks between them")


def darkness(smooth: NDArray, centers: Array, steps: Array) -> Array:
    """Grey levels half a step away on all four sides across, less that in the middle."""
    around = centers[:, None] + _ACROSS @ steps
    return _levels(smooth, around).min(axis=1) - _levels(smooth, centers)


def saddle(smooth: NDArray, centers: Array, steps: Array) -> Array:
    """Grey levels half a step away, of two opposite sides across less those of the other two."""
    one, two, three, four = _levels(smooth, centers[:, None] + _ACROSS @ steps).T
    return one + four - two - three


def _levels(smooth: NDArray, points: Array) -> Array:
    pixels = np.clip(np.round(points), 0, np.array(smooth.shape[::-1]) - 1).astype(int)
    return np.asarray(smooth[pixels[..., 1], pixels[..., 0]])


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
    hull = ConvexHull(grid)
    corners = grid[hull.vertices]
    border = np.gcd(*np.abs(corners - np.roll(corners, 1, axis=0)).T).sum()
    # Pick's theorem; a hull's volume in the plane is its area.
    return float(len(grid) / (hull.volume + border / 2 + 1))


def counting(points: Array, grid: Index, lattice: str, direction: float, mirrored: bool) -> Array:
    """Matrix (2, 2) by which coordinates of equal steps become those with the first step in the
    wanted direction.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        Image points, px.
    grid : ndarray of int, shape (N, 2)
        Coordinates whose steps are at a right angle, on a hexagonal lattice at 60°.
    lattice : str
        One of `STEPS`.
    direction : float
        Direction of the pattern's x axis in the image, rad.
    mirrored : bool
        True if the pattern is seen from behind.
    """
    if lattice == "asymmetric":  # its square lattice stands on a corner
        direction += -np.pi / 4 if mirrored else np.pi / 4
    along = mean_steps(points, grid)
    axes = np.array([[1, 0], [0, 1], [-1, 1]][: 3 if lattice == "hexagonal" else 2])
    axes = np.concatenate([axes, -axes])  # all the way round
    seen = axes @ along
    heading = seen @ [np.cos(direction), np.sin(direction)] / np.hypot(*seen.T)
    first = int(np.argmax(heading))
    turn = 1 if (np.linalg.det(along) > 0) != mirrored else -1
    basis = np.linalg.inv(np.stack([axes[first], axes[(first + turn) % len(axes)]]))
    return basis @ [[1, 1], [-1, 1]] if lattice == "asymmetric" else basis


def mean_steps(points: Array, grid: Index) -> Array:
    """Mean step in the image for each of the two coordinates, (2, 2), px."""
    design = np.column_stack([grid, np.ones(len(grid))])
    return np.linalg.lstsq(design, points, rcond=None)[0][:2]
