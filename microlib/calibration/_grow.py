"""Find lattices among marks in clutter, each from three marks whose shapes tell the metric."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from microlib._common import Array
from microlib.calibration._dark_regions import DarkRegions
from microlib.calibration._detection import FEWEST

#: Neighbors that may be the next in the lattice: a hexagonal one has six, and clutter lies between.
_NEAR = 12
#: Most ratio of the areas of neighbors, and most difference of their shapes.
_LIKE_AREA, _LIKE_SHAPE = 2.0, 0.5
#: The second step may lie so far from where the first, turned in the marks' metric, has it, in
#: steps; and later marks so far from where the step before predicts them.
_SEED_REACH, _REACH = 0.3, 0.25
#: Most first steps that are tried from one mark.
_TRIES = 4


def grow_lattices(regions: DarkRegions, lattice: str) -> list[tuple[NDArray, NDArray]]:
    """Pieces of lattice among the regions, from the most likely marks on.

    Parameters
    ----------
    regions : DarkRegions
        Marks and clutter.
    lattice : str
        "hexagonal" for steps at 60°, else at 90°.

    Returns
    -------
    list of (index, grid)
        Regions of each piece, and their integer coordinates.
    """
    if len(regions.centers) < FEWEST:
        return []
    marks = _Marks(regions)
    angle = np.pi / 3 if lattice == "hexagonal" else np.pi / 2
    free = np.ones(len(regions.centers), dtype=bool)
    pieces = []
    for seed in np.argsort(-marks.liked, kind="stable"):
        if not free[seed]:
            continue
        best: dict[tuple[int, int], int] = {}
        for steps in marks.first_steps(int(seed), angle):
            piece = marks.grow(int(seed), steps)
            best = max(best, piece, key=len)
            if len(best) > _NEAR:  # no chance piece
                break
        if len(best) >= FEWEST:
            free[list(best.values())] = False
            index = np.fromiter(best.values(), dtype=np.intp)
            grid = np.array(list(best), dtype=np.intp)
            if (np.ptp(grid, axis=0) > 0).all():
                pieces.append((index, grid))
    return pieces


class _Marks:
    """Marks with their neighbors."""

    def __init__(self, regions: DarkRegions) -> None:
        self.points, self.areas = regions.centers, regions.areas
        self.tree = cKDTree(self.points)
        values, vectors = np.linalg.eigh(regions.moments)
        self.white = (vectors / np.sqrt(values)[:, None, :]) @ vectors.transpose(0, 2, 1)
        self.moments = regions.moments
        _, near = self.tree.query(self.points, k=min(_NEAR + 1, len(self.points)))
        near = near[:, 1:]
        ratio = self.areas[near] / self.areas[:, None]
        seen = self.white[:, None] @ self.moments[near] @ self.white[:, None]
        shape = np.linalg.norm(seen / ratio[..., None, None] - np.eye(2), axis=(2, 3))
        like = (ratio > 1 / _LIKE_AREA) & (ratio < _LIKE_AREA) & (shape < _LIKE_SHAPE)
        self.neighbors = [row[ok] for row, ok in zip(near, like, strict=True)]
        self.liked = like.sum(axis=1)

    def first_steps(self, seed: int, angle: float) -> list[Array]:
        """Pairs of steps to neighbors that are equal and at the angle in the seed's metric."""
        near = self.neighbors[seed]
        if len(near) < 2:
            return []
        steps = self.points[near] - self.points[seed]
        flat = steps @ self.white[seed]
        length = np.hypot(*flat.T)
        order = np.argsort(length)[:_TRIES]
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        pairs = []
        for k in order:
            off = np.hypot(*(flat - flat[k] @ turn).T)
            second = int(np.argmin(off))
            if second != k and off[second] < _SEED_REACH * length[k]:
                pairs.append(np.stack([steps[k], steps[second]]))
        return pairs

    def grow(self, seed: int, steps: Array) -> dict[tuple[int, int], int]:
        """Breadth first; each step predicts the next."""
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
                distance, index = self.tree.query(self.points[here] + sign * local[axis])
                ratio = self.areas[index] / self.areas[here]
                near = distance < _REACH * np.hypot(*local[axis])
                if not near or index in taken or not 1 / _LIKE_AREA < ratio < _LIKE_AREA:
                    continue
                following = local.copy()
                step = sign * (self.points[index] - self.points[here])
                following[axis] = (local[axis] + step) / 2
                found[target] = int(index)
                taken.add(int(index))
                queue.append((target, following))
        return found
