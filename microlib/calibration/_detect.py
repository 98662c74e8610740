"""The detectors: they find the pattern that is asked for, or name the one that is shown."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike

from microlib._common import flag, one_of, scalar
from microlib.calibration._detection import Detection
from microlib.calibration._lattice import STEPS
from microlib.calibration._marks import crop, to_grey
from microlib.calibration._micrometer import Micrometer, find_scale
from microlib.calibration._patterns import FIRST, Scene, WrongPattern, find_pattern

#: Patterns that are told from each other, and how they are called.
_NAMES = {
    ("chessboard", "square"): "a chessboard",
    ("circles", "square"): "circles on a square lattice",
    ("circles", "hexagonal"): "circles on a hexagonal lattice",
    ("squares", "square"): "squares",
}


def detect_circles(
    image: ArrayLike,
    *,
    direction: float = 0.0,
    mirrored: bool = False,
    lattice: str = "square",
    region: tuple[int, int, int, int] | None = None,
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
    return _detect(image, "circles", lattice, direction, mirrored, region)


def detect_squares(
    image: ArrayLike,
    *,
    direction: float = 0.0,
    mirrored: bool = False,
    pattern: str = "squares",
    region: tuple[int, int, int, int] | None = None,
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
    return _detect(image, pattern, "square", direction, mirrored, region)


def detect_micrometer(
    image: ArrayLike, *, region: tuple[int, int, int, int] | None = None
) -> Micrometer:
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
    grey, corner = crop(to_grey(image), region)
    scene = Scene(grey)
    try:
        scale = find_scale(grey, scene.settings)
    except ValueError as refusal:
        seen = _pattern_seen(scene, ("scale", ""))
        if seen is None:
            raise
        raise ValueError(f"image must show a scale of equidistant lines, got {seen}") from refusal
    seen = _pattern_seen(scene, ("scale", ""))
    if seen is not None:
        raise ValueError(f"image must show a scale of equidistant lines, got {seen}")
    return replace(scale, points=scale.points + corner)


def _detect(
    image: ArrayLike,
    kind: str,
    lattice: str,
    direction: float,
    mirrored: bool,
    region: tuple[int, int, int, int] | None,
) -> Detection:
    direction = scalar("direction", direction, within=(-1e9, 1e9))
    mirrored = flag("mirrored", mirrored)
    whole = to_grey(image)
    grey, corner = crop(whole, region)
    scene = Scene(grey)
    try:
        found, alone = find_pattern(scene, kind, lattice, direction, mirrored)
    except WrongPattern:
        raise
    except ValueError as refusal:
        seen = _pattern_seen(scene, (kind, lattice))
        if seen is None:
            raise
        name = _NAMES.get((kind, lattice), "an asymmetric grid of circles")
        raise ValueError(f"image must show {name}, got {seen}") from refusal
    if not alone:  # a few marks may lie beside a chessboard, which even edges do not surround
        board = None
        with suppress(ValueError):
            board, _ = find_pattern(scene, "chessboard", "square")
        if board is not None and _extent(board) > _extent(found):
            raise WrongPattern(kind, "a chessboard")
    return replace(found, points=found.points + corner, image_size=whole.shape[::-1])


def _pattern_seen(scene: Scene, asked: tuple[str, str]) -> str | None:
    """What another pattern than the one asked for is called, if the image shows one."""
    for (kind, lattice), name in _NAMES.items():
        if (kind, lattice) != asked:
            try:
                find_pattern(scene, kind, lattice, most=FIRST)
                return name
            except WrongPattern as other:
                if other.seen != asked[0]:
                    return other.seen
            except ValueError:
                pass
    if asked[0] != "scale":
        with suppress(ValueError):
            find_scale(scene.grey, scene.settings)
            return "the lines of a scale"
    return None


def _extent(found: Detection) -> float:
    """Area of the image that a pattern covers, px²."""
    return cv2.contourArea(cv2.convexHull(found.points.astype(np.float32)))
