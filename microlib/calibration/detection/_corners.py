"""Inner corners of chessboards and ChArUco boards: saddle points of the grey levels.

Two dark and two bright fields meet at a corner. The smoothed image has a saddle point there, whose
second derivative is zero along the two edges. From one corner to the next along an edge, dark and
bright fields are exchanged and the second derivatives change their sign. A lattice that is grown by
this rule skips no row.
"""

from __future__ import annotations

from contextlib import suppress

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.calibration._detection import MIN_MARKS
from microlib.calibration.detection._grid_map import fit_grid_map
from microlib.calibration.detection._lattice import (
    CELL,
    MIDDLE,
    Index,
    correlation,
    fill,
    grey_levels,
    grow_pieces,
    neighbors,
)
from microlib.calibration.detection._marks import Marks
from microlib.calibration.detection._settings import Settings


def find_corners(grey: NDArray[np.float32], kind: str, settings: Settings) -> tuple[Marks, Index]:
    """Inner corners of a chessboard or ChArUco board, with the area of a field, and their grid.

    Raises
    ------
    ValueError
        If the image shows no such board of at least four corners, or one with markers in its fields
        for a chessboard, or without markers for a ChArUco board.
    """
    smooth: NDArray = cv2.GaussianBlur(grey, (0, 0), 1.0)
    boards, fault = [], f"fewer than {MIN_MARKS} of its corners"
    for blur in settings.saddle_blurs:
        with suppress(ValueError):
            board = _correlated(smooth, *_grow_board(grey, blur, kind), kind, settings)
            if has_markers(smooth, *board) == (kind == "charuco"):
                boards.append(board)
            else:
                fault = f"{'no markers' if kind == 'charuco' else 'one with markers'} in its fields"
    if not boards:
        raise ValueError(f"image must show a {kind}, got {fault}")
    centers, grid = max(boards, key=lambda board: len(board[1]))
    to_image, _ = fit_grid_map(centers[:, None], grid.astype(float), MIDDLE, grey.shape)
    unknown = np.full((len(grid), 2, 2), np.nan)
    return Marks(grey, smooth, centers, unknown, to_image.scale(grid), settings), grid


def has_markers(smooth: NDArray, centers: Array, grid: Index) -> bool:
    """Whether the fields of one color contain markers, by the scatter of their grey levels.

    It also scatters on a sheared lattice, whose fields contain edges.
    """
    to_image, _ = fit_grid_map(centers[:, None], grid.astype(float), MIDDLE, smooth.shape)
    steps = to_image.steps(grid)
    inside = CELL[np.abs(CELL).min(axis=1) > 0.15]  # clear of the blurred edges
    levels = grey_levels(smooth, centers[:, None] + inside @ steps.transpose(0, 2, 1))
    color = np.sign(inside.prod(axis=1)) * (-1.0) ** grid.sum(axis=1)[:, None]
    first, second = (
        np.median(np.nanstd(np.where(color == sign, levels, np.nan), axis=1)) for sign in (1, -1)
    )
    low, high = np.percentile(levels, [5, 95])
    # Of 60 photographed chessboards the two differ by 0.02 of the contrast at most, of ChArUco
    # boards by 0.19 at least; where the markers are blurred beyond recognition, by 0.03.
    return bool(abs(first - second) > 0.05 * (high - low))


def _correlated(
    smooth: NDArray, centers: Array, grid: Index, kind: str, settings: Settings
) -> tuple[Array, Index]:
    """The corners around which the image correlates with a drawn board."""
    places = CELL
    if kind == "charuco":  # along the edges only: the bright fields contain markers
        places = places[np.abs(places).min(axis=1) < 1 / 12]
    # False corners bend the map by which others are judged, so that the worst ones go first. Of 36
    # photographs by a wide-angle lens, one or two limits reject two, and three limits one.
    for limit in (0.4, 0.6, settings.min_correlation):
        to_image, _ = fit_grid_map(centers[:, None], grid.astype(float), MIDDLE, smooth.shape)
        offset = np.linalg.norm(centers - to_image(grid), axis=1)
        side = np.sqrt(to_image.scale(grid))  # zero where false corners coincide
        drawn = np.sign(places.prod(axis=1)) * (-1.0) ** grid.sum(axis=1)[:, None]
        steps = to_image.steps(grid)
        both = [correlation(smooth, centers, steps, places, sign * drawn) for sign in (1, -1)]
        kept = (max(both, key=np.median) > limit) & (offset < (1 - limit) * side)
        centers, grid = centers[kept], grid[kept]
        if len(grid) < MIN_MARKS or fill(grid) == 0:
            raise ValueError("no corner of a board is left")
    return centers, grid


def _grow_board(grey: NDArray[np.float32], blur: float, kind: str) -> tuple[Array, Index]:
    """Corners of the largest board among the saddle points, and the column and row of each."""
    centers, hessians = _saddles(grey, blur)
    if len(centers) < MIN_MARKS:
        raise ValueError("no board is found")
    # Most saddle points of a ChArUco board belong to its markers.
    near = neighbors(centers, 50 if kind == "charuco" else 12)
    toward = centers[near] - centers[:, None]
    toward /= np.linalg.norm(toward, axis=2, keepdims=True)
    along = np.abs(np.einsum("nki,nij,nkj->nk", toward, hessians, toward)) < 1 / 4

    def may_adjoin(here: Index | int, there: Index | int) -> NDArray[np.bool_]:
        return np.asarray((hessians[here] * hessians[there]).sum(axis=(-2, -1)) < -1 / 2)

    suits = along & may_adjoin(np.arange(len(near))[:, None], near)
    # Under a strong distortion one step differs from the next by a quarter.
    pieces = grow_pieces(centers, near, suits, may_adjoin, tolerance=1 / 3)
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
