"""Inner corners of a ChArUco board, as OpenCV finds them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, as_image, luminance
from microlib.calibration._detection import FEWEST, Detection


def detect_charuco(image: ArrayLike) -> Detection:
    """Inner corners of a ChArUco board, a chessboard with markers in its bright fields.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue. A part of the board is enough; its size,
        its markers' dictionary and their size are read from it.

    Returns
    -------
    Detection
        A point for each corner that was found; a pitch is the side of a field. `sigma` is the
        points' distance from a plane view without distortion, and so holds the lens' as well.

    Raises
    ------
    ValueError
        If `image` is no image, or shows fewer than four markers of OpenCV's dictionaries or four
        corners beside them.

    Notes
    -----
    Markers, and the corners between them, are found by ``cv2.aruco``. The number of columns is the
    one with which the markers' numbers are a plane grid.

    Examples
    --------
    >>> import cv2
    >>> from microlib.calibration import detect_charuco
    >>> markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_50)
    >>> board = cv2.aruco.CharucoBoard((5, 4), 3.0, 2.0, markers)
    >>> found = detect_charuco(board.generateImage((500, 400), marginSize=20))
    >>> len(found.points), found.grid.max(axis=0).tolist()
    (12, [3, 2])
    """
    grey = as_image("image", luminance("image", image))
    eight = cv2.normalize(grey, np.empty(0), 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)
    names = ["4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL"]
    found: list[tuple[int, Any, Any, Any]] = []
    for name in names:
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))
        sides, numbers, _ = cv2.aruco.ArucoDetector(markers).detectMarkers(eight)
        if len(sides) >= FEWEST:
            found.append((len(sides), np.reshape(sides, (-1, 4, 2)), numbers.ravel(), markers))
    if not found:
        raise ValueError("image must show a ChArUco board, got fewer than four of its markers")
    _, sides, numbers, markers = max(found, key=lambda each: each[0])
    corners = [(np.empty((0, 2)), np.empty(0), 1), *_corners(eight, sides, numbers, markers)]
    points, which, columns = max(corners, key=lambda each: len(each[0]))
    if len(points) < FEWEST:
        raise ValueError(f"image must show a ChArUco board, got {len(points)} of its corners")
    grid = np.stack([which % columns, which // columns], axis=1).astype(np.intp)
    grid -= grid.min(axis=0)
    places = grid.astype(np.float64)
    to_image = cv2.findHomography(places, points)[0]
    if to_image is None or not np.isfinite(to_image).all():
        raise ValueError("image must show a ChArUco board, got its corners in one row")
    off = points - _seen(to_image, places)
    sigma = np.sqrt((off**2).sum() / max(2 * len(points) - 8, 1))
    count = len(points)
    size = (grey.shape[1], grey.shape[0])
    return Detection(
        points, grid, np.full(count, sigma), np.arange(count), places, 1.0, np.nan, size
    )


def _corners(
    eight: NDArray, sides: NDArray, numbers: NDArray, markers: Any
) -> Iterator[tuple[Array, NDArray, int]]:
    """Yield the corners that each kind of board finds, their numbers, and corners in a row.

    The number of columns is the one with which most markers lie on a plane, and the markers are as
    large as they are seen there.
    """
    for old in (False, True):
        best: tuple[int, Any] = (0, None)
        for columns in range(3, 30):
            board = cv2.aruco.CharucoBoard(
                (columns, 2 * int(numbers.max()) // columns + 3), 1.0, 0.5, markers
            )
            board.setLegacyPattern(old)
            placed = np.array(board.getObjPoints())[numbers, :, :2].mean(axis=1)
            to_board, flat = cv2.findHomography(sides.mean(axis=1), placed, cv2.RANSAC, 0.1)
            if to_board is not None and flat.sum() > best[0]:
                seen = _seen(to_board, sides.reshape(-1, 2)).reshape(-1, 4, 2)
                best = (int(flat.sum()), (board, seen))
        if best[0] < FEWEST:
            continue
        board, seen = best[1]
        side = float(np.median(np.linalg.norm(np.diff(seen, axis=1), axis=2)))
        size = board.getChessboardSize()
        board = cv2.aruco.CharucoBoard(size, 1.0, min(side, 0.99), markers)
        board.setLegacyPattern(old)
        points, which, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(eight)
        if which is not None:
            yield np.reshape(points, (-1, 2)).astype(np.float64), which.ravel(), size[0] - 1


def _seen(homography: Any, points: NDArray) -> Array:
    return np.asarray(cv2.perspectiveTransform(points[None].astype(np.float64), homography)[0])
