"""Inner corners of chessboards and of ChArUco boards: saddle points of the grey levels.

At a corner two dark and two bright fields meet. The smoothed image has a saddle point there, and
the directions in which its second derivative is zero are those of the two edges. From corner to
corner along an edge dark and bright change places, so that the second derivatives change their
sign: a lattice grown by this rule skips no row.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from microlib._common import Array
from microlib.calibration._detection import FEWEST
from microlib.calibration.detection._grid_map import fit_grid_map
from microlib.calibration.detection._lattice import (
    CELL,
    MIDDLE,
    Index,
    fill,
    grow_pieces,
    likeness,
    neighbors,
)
from microlib.calibration.detection._marks import Marks
from microlib.calibration.detection._settings import Settings


def find_corners(grey: NDArray[np.float32], kind: str, settings: Settings) -> tuple[Marks, Index]:
    """Corners of a chessboard or ChArUco board, as large as its fields there, and their grid.

    Raises
    ------
    ValueError
        If the image shows no board of at least four corners.
    """
    smooth: NDArray = cv2.GaussianBlur(grey, (0, 0), 1.0)
    found = []
    for blur in settings.saddle_blurs:
        with suppress(ValueError):
            found.append(_verified(smooth, *_grow_board(grey, blur, kind), kind))
    if not found:
        raise ValueError(f"image must show a {kind}, got fewer than {FEWEST} of its corners")
    centers, grid = max(found, key=lambda piece: len(piece[1]))
    to_image, _ = fit_grid_map(centers[:, None], grid.astype(float), MIDDLE, grey.shape)
    unknown = np.full((len(grid), 2, 2), np.nan)
    return Marks(grey, smooth, centers, unknown, to_image.scale(grid), settings), grid


def _verified(smooth: NDArray, centers: Array, grid: Index, kind: str) -> tuple[Array, Index]:
    """The corners around which the image is alike a drawn board."""
    for least in (0.4, 0.6, Settings.least_alike):  # what is no corner bends the map
        to_image, _ = fit_grid_map(centers[:, None], grid.astype(float), MIDDLE, smooth.shape)
        beside = np.linalg.norm(centers - to_image(grid), axis=1) / np.sqrt(to_image.scale(grid))
        steps = _local_steps(centers, grid, to_image.steps(grid))
        alike = _likeness(smooth, centers, steps, grid, kind)
        kept = (alike > least) & (beside < 1 - least)
        centers, grid = centers[kept], grid[kept]
        if len(grid) < FEWEST or fill(grid) == 0:
            raise ValueError("no board is left")
    return centers, grid


def _local_steps(centers: Array, grid: Index, steps: Array) -> Array:
    """Mean step from each corner to its neighbors, where it has some, else as the map has it."""
    steps, place = steps.copy(), tuple((grid - grid.min(axis=0) + 1).T)
    board = np.full((*np.ptp(grid, axis=0) + 3, 2), np.nan)
    board[place] = centers
    for axis in (0, 1):
        change = np.diff(board, axis=axis, append=np.nan)
        both = np.stack([change, np.roll(change, 1, axis)])[:, *place]
        known = np.isfinite(both)
        total, count = np.where(known, both, 0).sum(axis=0), known.sum(axis=0)
        steps[..., axis] = np.where(count, total / np.maximum(count, 1), steps[..., axis])
    return steps


def _grow_board(grey: NDArray[np.float32], blur: float, kind: str) -> tuple[Array, Index]:
    """Corners of the largest board among the saddle points, and the column and row of each."""
    centers, hessians = _saddles(grey, blur)
    if len(centers) < FEWEST:
        raise ValueError("no board is found")
    # Of a ChArUco board most of the saddle points are those of its markers.
    near = neighbors(centers, 50 if kind == "charuco" else 12)
    step = centers[near] - centers[:, None]
    toward = step / np.linalg.norm(step, axis=2, keepdims=True)
    opposite = np.einsum("nij,nkij->nk", hessians, hessians[near]) < -1 / 2
    along = np.abs(np.einsum("nki,nij,nkj->nk", toward, hessians, toward)) < 1 / 4
    first = opposite & along

    tree = cKDTree(centers)

    def alike(here: int, there: int) -> bool:
        return bool((hessians[here] * hessians[there]).sum() < -1 / 2)

    def first_steps(seed: int) -> Iterator[Array]:
        candidates = np.flatnonzero(first[seed])
        for one in candidates[:3]:
            (x, y), (u, v) = toward[seed, one], toward[seed, candidates].T
            for other in candidates[np.abs(x * v - y * u) > 1 / 2][:3]:
                steps = step[seed, [one, other]]
                beyond, fourth = tree.query(centers[seed] + steps.sum(axis=0))
                if 3 * beyond < np.hypot(*steps[0]) and alike(near[seed, one], fourth):
                    yield steps

    # Under a strong distortion one step differs from the next by a quarter.
    pieces = grow_pieces(centers, range(len(centers)), first_steps, alike, reach=1 / 3)
    if not pieces:
        raise ValueError("no board is found")
    return centers[pieces[0][0]], pieces[0][1]


def _saddles(grey: NDArray[np.float32], blur: float) -> tuple[Array, Array]:
    """Saddle points of the blurred image, the strongest first, and their second derivatives as
    matrices (n, 2, 2) of length one."""
    smooth = cv2.GaussianBlur(grey, (0, 0), blur)
    x, y = (cv2.Sobel(smooth, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    xx, xy, yy = (cv2.Sobel(*each) for each in ((x, -1, 1, 0), (x, -1, 0, 1), (y, -1, 0, 1)))
    strength = xy * xy - xx * yy
    size = 2 * int(np.ceil(blur)) + 1
    peak = strength == cv2.dilate(strength, np.ones((size, size), np.uint8))
    row, column = np.nonzero(peak & (strength > strength.max() / 100))
    order = np.argsort(-strength[row, column], kind="stable")[:4000]
    at = row[order], column[order]
    hessians = np.stack([xx[at], xy[at], xy[at], yy[at]], axis=-1).reshape(-1, 2, 2).astype(float)
    slope = np.stack([x[at], y[at]], axis=-1).astype(float)
    # Sobel's weights make 8 of a slope, and 64 of a curvature.
    move = -8 * np.linalg.solve(hessians, slope[..., None])[..., 0]
    near = np.abs(move).max(axis=1) < 2
    centers = np.column_stack(at[::-1]) + move
    return centers[near], (hessians / np.linalg.norm(hessians, axis=(1, 2), keepdims=True))[near]


def _likeness(smooth: NDArray, centers: Array, steps: Array, grid: Index, kind: str) -> Array:
    """Correlation of the fields around each corner with those of a drawn board, (n,)."""
    places = CELL
    if kind == "charuco":  # along the edges alone: markers lie in the bright fields
        places = places[np.abs(places).min(axis=1) < 1 / 12]
    drawn = np.sign(places.prod(axis=1)) * (-1.0) ** grid.sum(axis=1)[:, None]
    both = [likeness(smooth, centers, steps, places, sign * drawn) for sign in (1, -1)]
    return max(both, key=np.median)
