"""Inner corners of a chessboard, as OpenCV finds them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.calibration._lattice import Index, complete, mean_steps, saddle
from microlib.calibration._marks import Marks
from microlib.calibration._settings import Settings


def find_corners(grey: NDArray[np.float32], settings: Settings) -> tuple[Marks, Index]:
    """Corners of a board, each with the moments of a circle within its fields, and their grid.

    Raises
    ------
    ValueError
        If the image shows no chessboard of at least three by three corners.
    """
    eight: NDArray = cv2.normalize(grey, np.empty(0), 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)
    smooth: NDArray = cv2.GaussianBlur(grey, (0, 0), 1.0)
    half = cv2.pyrDown(cv2.GaussianBlur(eight, (0, 0), 2.0))
    # It is asked for parts of a larger board. Of 26 photographs it gives 46 to 54 of 54 corners in
    # the blurred half image, in the whole one of some only five.
    quick, least = cv2.CALIB_CB_LARGER, (3, 3)
    thorough = quick | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    for each, board, flags in ((half, (5, 4), quick), (eight, least, thorough)):
        found, corners, meta = cv2.findChessboardCornersSBWithMeta(each, board, flags)
        if found:
            break
    else:
        raise ValueError("image must show a chessboard, got none")
    grid = np.argwhere(np.ones(np.shape(meta)))[:, ::-1]  # (column, row) of each corner, by rows
    scale = 2 if each is half else 1
    centers: Array = scale * np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    beside = max(1 / 4 * np.sqrt(np.abs(np.linalg.det(mean_steps(centers, grid)))), 1.0)
    inside = cv2.findHomography(grid.astype(np.float64), centers, cv2.RANSAC, beside)[1]
    kept = np.ones(len(grid), dtype=bool) if inside is None else inside.ravel() > 0
    centers, grid = centers[kept], grid[kept]
    # From corner to corner dark and bright change places, unless a row between them was skipped.
    # A third of a step is within a field also where every second row was skipped.
    dark = saddle(smooth, centers, mean_steps(centers, grid) / 3)
    ways = [dark * (-1.0) ** (grid @ np.array(changes)) for changes in np.ndindex(2, 2)]
    best = int(np.argmax([np.abs(np.sign(way).sum()) for way in ways]))
    # What OpenCV gives beyond the board has no such fields, and would bend the map.
    alternate = np.abs(ways[best].sum()) / len(grid) / 2
    kept = ways[best] * np.sign(ways[best].sum()) > alternate
    centers, grid = centers[kept], grid[kept] * (2 - np.array(np.unravel_index(best, (2, 2))))
    if len(grid) < np.prod(least):
        raise ValueError(f"image must show a chessboard, got {len(grid)} corners on a plane one")
    side = np.sqrt(np.abs(np.linalg.det(mean_steps(centers, grid))))
    moments = np.tile((side / 6) ** 2 * np.eye(2), (len(grid), 1, 1))
    marks = Marks(grey, smooth, centers, moments, np.full(len(grid), side**2), settings)
    return complete(marks, grid, lambda *at: np.abs(saddle(*at)))
