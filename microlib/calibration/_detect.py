"""The detectors: they find the pattern that is asked for, or name the one that is shown."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, Region, flag, one_of, scalar
from microlib.calibration._detection import FEWEST, Detection
from microlib.calibration._grid_map import fit_grid_map
from microlib.calibration._lattice import MIDDLE, STEPS, Index, fill, mean_steps
from microlib.calibration._marks import look_at, to_bytes
from microlib.calibration._micrometer import Micrometer, find_scale
from microlib.calibration._patterns import FIRST, Scene, Wanted, find_pattern

#: Patterns that are told from each other, and how they are called.
_NAMES = {
    ("chessboard", "square"): "a chessboard",
    ("circles", "square"): "circles on a square lattice",
    ("circles", "hexagonal"): "circles on a hexagonal lattice",
    ("squares", "square"): "squares",
    ("scale", "square"): "the lines of a scale",
    ("circles", "asymmetric"): "an asymmetric grid of circles",
}


def detect_circles(
    image: ArrayLike,
    *,
    direction: float = 0.0,
    mirrored: bool = False,
    lattice: str = "square",
    region: Region | None = None,
) -> Detection:
    """Centers of the circles of a regular grid, with their places in the grid.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue, which become luminance. The circles are
        darker than their ground or, if no such grid is found, brighter.
    direction : float
        Direction in the image in which the pattern's x axis points (about α), rad, right to within
        45°, on a hexagonal lattice 30°.
    mirrored : bool
        True if the pattern is seen from behind (γ near 180°).
    lattice : {"square", "hexagonal", "asymmetric"}
        What the circles lie on. The second step of a hexagonal lattice is at 60° to the first.
        An asymmetric grid has every second row shifted by half a step; its x and y count the half
        steps and the rows, as OpenCV's does. Another lattice than the named one is refused.
    region : (int, int, int, int), optional
        Where to look, (x, y, width, height) in px.

    Returns
    -------
    Detection
        `points` are the images of the circles' centers. Circles that leave the image are not among
        them. `grid` begins at the first column and row that were found.

    Raises
    ------
    ValueError
        If `image` is no image, no grid of at least four whole circles is found in it, or what is
        found is none: the circles are not of one size, lie on another lattice, or beside any smooth
        image of it.

    Notes
    -----
    The thesis takes the center "by least squares" (§5.2); here the least squares are those of the
    grey levels around the whole outline. Under perspective and distortion the center of the ellipse
    is not the image of the circle's center: the map from the grid to the image is fitted to the
    points, the circle is sent through it, and the difference between the two centers is taken off.

    An image that shows nothing but the grid is thresholded. In any other, the
    circles are looked for among closed contours of many grey levels, of both polarities.

    Examples
    --------
    >>> from microlib.calibration import detect_circles
    >>> from microlib.microscope import Microscope
    >>> from microlib.synthetic import render_circles
    >>> scope = Microscope(200000, 126000, 79380, tx=-300, ty=-300, image_size=(160, 120))
    >>> found = detect_circles(render_circles(scope))
    >>> error = found.points - scope.project(280.0 * found.positions)
    >>> len(found.points), bool(abs(error).max() < 0.01)
    (9, True)
    """
    lattice = one_of("lattice", lattice, tuple(STEPS))
    return _detect(image, Wanted("circles", lattice, direction, mirrored), region)


def detect_squares(
    image: ArrayLike,
    *,
    direction: float = 0.0,
    mirrored: bool = False,
    pattern: str = "squares",
    region: Region | None = None,
) -> Detection:
    """Corners of the squares of a regular grid, with their places in the grid.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue, which become luminance. The squares are
        darker than their ground or, if no such grid is found, brighter.
    direction : float
        Direction in the image in which the pattern's x axis points (about α), rad, right to within
        45°.
    mirrored : bool
        True if the pattern is seen from behind (γ near 180°).
    pattern : {"squares", "chessboard"}
        Squares with gaps between them, or the fields of a chessboard, which touch at their corners:
        of it the inner corners are found, one `points` each, and a pitch is the side of a field.
    region : (int, int, int, int), optional
        Where to look, (x, y, width, height) in px.

    Returns
    -------
    Detection
        Four `points` for each square that lies whole in the image. `grid` counts sides and gaps:
        square (m, n) has its corners from (2m, 2n) to (2m + 1, 2n + 1). Where they are of one
        length, the side times `grid` gives world points. `side` says what was measured, and
        `positions` allow for it.

    Raises
    ------
    ValueError
        If `image` is no image, no grid of at least four whole squares is found in it, or what is
        found is none: the marks are rectangles, or lie beside any smooth image of a grid.

    Notes
    -----
    The thesis finds edges with a Sobel operator, links them, and intersects the lines fitted to
    them (§5.2). Here all four lines of a square are fitted together to the grey levels: a product
    of four blurred half-planes, which near a right angle is the exact image of a corner under a
    Gaussian point-spread function. They start along the steps of the lattice.

    An image that shows nothing but the grid is thresholded. In any other, the
    squares are looked for among closed contours of many grey levels, of both polarities. The
    corners of a chessboard are found by OpenCV (``findChessboardCornersSB``), and then two crossing
    edges are fitted to the grey levels around each.

    Examples
    --------
    >>> from microlib.calibration import detect_squares
    >>> from microlib.microscope import Microscope
    >>> from microlib.synthetic import render_squares
    >>> scope = Microscope(200000, 126000, 79380, tx=-450, ty=-330, image_size=(160, 120))
    >>> found = detect_squares(render_squares(scope))
    >>> error = found.points - scope.project(200.0 * found.grid)
    >>> len(found.points), bool(abs(error).max() < 0.01), round(found.side, 3)
    (16, True, 0.5)
    """
    pattern = one_of("pattern", pattern, ("squares", "chessboard"))
    return _detect(image, Wanted(pattern, "square", direction, mirrored), region)


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
        points' distance from a plane view through a lens with one term of distortion.

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
    grey, _, size = look_at(image, None)
    eight = to_bytes(grey)
    kinds = [
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))
        for name in ("4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL")
    ]
    seen = [(*cv2.aruco.ArucoDetector(kind).detectMarkers(eight)[:2], kind) for kind in kinds]
    sides, numbers, kind = max(seen, key=lambda each: len(each[0]))
    if len(sides) < FEWEST:
        raise ValueError("image must show a ChArUco board, got fewer than four of its markers")
    known = eight, np.vstack(sides), numbers, kind
    found = [_marked_corners(*known, old) for old in (False, True)]
    points, grid = max(found, key=lambda each: len(each[0]))
    if len(points) < FEWEST:
        raise ValueError(f"image must show a ChArUco board, got {len(points)} of its corners")
    grid -= grid.min(axis=0)
    if fill(grid) == 0:
        raise ValueError("image must show a ChArUco board, got its corners in one row")
    # OpenCV 4 tells of corners that are half a pixel off; sought in the image they are not, by any
    # OpenCV. What is within the space between a corner and the next marker is looked at.
    field = np.linalg.norm(mean_steps(points, grid), axis=1).min()
    marker = np.sqrt(np.median([cv2.contourArea(each) for each in sides]))
    reach = max(2, int((field - marker) / 2) - 1)
    sought = points.astype(np.float32).reshape(-1, 1, 2)
    end = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-3)
    cv2.cornerSubPix(eight, sought, (reach, reach), (-1, -1), end)
    points = sought[:, 0].astype(float)
    to_image, positions = fit_grid_map(points[:, None], grid.astype(float), MIDDLE, grey.shape)
    off = points - to_image(positions[:, 0])
    sigma = np.sqrt((off**2).sum() / max(off.size - to_image.freedom, 1))
    count = len(points)
    return Detection(
        points, grid, np.full(count, sigma), np.arange(count), positions[:, 0], 1.0, np.nan, size
    )


def detect_micrometer(image: ArrayLike, *, region: Region | None = None) -> Micrometer:
    """Lines of a stage micrometer or a ruler, and their distance in pixels.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue. The lines may be darker or brighter than
        their ground and run in any direction; they need not be equally long.
    region : (int, int, int, int), optional
        Where to look, (x, y, width, height) in px.

    Returns
    -------
    Micrometer

    Raises
    ------
    ValueError
        If `image` is no image, or shows no scale of at least five equidistant lines.

    Notes
    -----
    The direction is that in which the image's mean profile is sharpest. The lines are the peaks of
    the profile over the rows that show most of them, each at the center of what is dark there, and
    a straight line through their places over whole numbers gives the spacing.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.calibration import detect_micrometer
    >>> x = np.arange(200.0)
    >>> lines = sum(np.exp(-((x - 13.3 - 17.2 * k) ** 2) / 4) for k in range(11))
    >>> noise = np.random.default_rng(0).normal(0, 2, (60, 200))
    >>> scale = detect_micrometer(200 - 120 * lines + noise)
    >>> len(scale.points), round(scale.spacing, 2), round(scale.um_per_pixel(10.0)[0], 3)
    (11, 17.2, 0.581)
    """
    grey, corner, _ = look_at(image, region)
    scene = Scene(grey)
    _refuse_other(scene, Wanted("scale"))  # which may have equidistant lines, too
    scale = find_scale(grey, scene.settings)
    return replace(scale, points=scale.points + corner)


def _detect(image: ArrayLike, wanted: Wanted, region: Region | None) -> Detection:
    scalar("direction", wanted.direction)
    flag("mirrored", wanted.mirrored)
    grey, corner, size = look_at(image, region)
    scene = Scene(grey)
    try:
        found, alone = find_pattern(scene, wanted)
    except ValueError as refusal:
        _refuse_other(scene, wanted, refusal)
        raise
    if not alone:  # a few marks may lie beside a chessboard, which even edges do not surround
        board = None
        with suppress(ValueError):
            board, _ = find_pattern(scene, Wanted("chessboard"))
        if board is not None and _extent(board) > _extent(found):
            raise ValueError(f"image must show {wanted.kind}, got a chessboard")
    return replace(found, points=found.points + corner, image_size=size)


def _refuse_other(scene: Scene, asked: Wanted, refusal: ValueError | None = None) -> None:
    """Name another pattern than the one asked for, if the image shows one."""
    for (kind, lattice), name in _NAMES.items():
        if (kind, lattice) == (asked.kind, asked.lattice) or lattice == "asymmetric":
            continue
        try:
            if kind == "scale":
                find_scale(scene.grey, scene.settings)
            else:
                find_pattern(scene, Wanted(kind, lattice), most=FIRST)
        except ValueError:
            continue
        wanted = _NAMES[asked.kind, asked.lattice]
        raise ValueError(f"image must show {wanted}, got {name}") from refusal


def _extent(found: Detection) -> float:
    """Area of the image that a pattern covers, px²."""
    return cv2.contourArea(cv2.convexHull(found.points.astype(np.float32)))


def _marked_corners(
    eight: NDArray, sides: NDArray, numbers: NDArray, markers: Any, old: bool
) -> tuple[Array, Index]:
    """Corners that a kind of board finds, and their places in it.

    The number of columns is the one with which most markers lie on a plane, and the markers are as
    large as they are seen there.
    """

    def board(columns: int, size: float) -> Any:
        rows = 2 * int(numbers.max()) // columns + 3
        made = cv2.aruco.CharucoBoard((columns, rows), 1.0, size, markers)
        made.setLegacyPattern(old)
        return made

    def flatten(columns: int) -> tuple[Any, NDArray]:
        every = np.array(board(columns, 0.5).getObjPoints())
        placed = every[numbers.ravel(), :, :2].mean(axis=1)
        to_board, flat = cv2.findHomography(sides.mean(axis=1), placed, cv2.RANSAC, 1 / 10)
        return to_board, np.zeros(1) if to_board is None else flat

    columns = max(range(3, 30), key=lambda count: flatten(count)[1].sum())
    to_board, flat = flatten(columns)
    if flat.sum() < FEWEST:
        raise ValueError("image must show a ChArUco board, got markers on none")
    seen = cv2.perspectiveTransform(sides.reshape(1, -1, 2).astype(float), to_board)
    side = np.median(np.linalg.norm(np.diff(seen.reshape(-1, 4, 2), axis=1), axis=2))
    detector = cv2.aruco.CharucoDetector(board(columns, min(float(side), 0.99)))
    points, which, _, _ = detector.detectBoard(eight)
    if which is None:
        points, which = np.empty(0), np.empty(0)
    row, column = np.divmod(which.ravel().astype(np.intp), columns - 1)
    return points.reshape(-1, 2).astype(np.float64), np.column_stack([column, row])
