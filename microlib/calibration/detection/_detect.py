"""The detectors: each finds the pattern that it is asked for."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import as_image, luminance, one_of
from microlib.calibration._detection import Detection
from microlib.calibration.detection._lattice import STEPS
from microlib.calibration.detection._micrometer import Micrometer, find_scale
from microlib.calibration.detection._patterns import Scene, find_pattern

#: Patterns by name, in the order in which they are looked for, with their marks and lattice.
_PATTERNS = {
    "chessboard": ("chessboard", "square"),
    "charuco": ("charuco", "square"),
    "squares": ("squares", "square"),
    "circles, square lattice": ("circles", "square"),
    "circles, hexagonal lattice": ("circles", "hexagonal"),
}


def detect_pattern(image: ArrayLike, marks: str = "auto") -> tuple[str, Detection]:
    """Name of the calibration pattern that an image shows, and its points.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue, which become luminance.
    marks : {"auto", "chessboard", "charuco", "squares", "circles"}
        What the pattern is made of; by default the first of these that is found. Circles may lie on
        a square or a hexagonal lattice.

    Returns
    -------
    name : str
        The marks; for circles with their lattice.
    found : Detection
        As the function for these marks returns it.

    Raises
    ------
    ValueError
        If `image` is no image or shows no such pattern; the message has the reason for each.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.calibration import detect_pattern
    >>> board = np.kron(np.indices((6, 7)).sum(axis=0) % 2, np.ones((20, 20)))
    >>> name, found = detect_pattern(np.pad(255 * board, 20, constant_values=128))
    >>> name, len(found.points)
    ('chessboard', 30)
    """
    one_of("marks", marks, ("auto", "chessboard", "charuco", "squares", "circles"))
    scene = Scene(_grey(image))
    faults: dict[str, None] = {}
    for name, (kind, lattice) in _PATTERNS.items():
        if marks in ("auto", kind):
            try:
                return name, find_pattern(scene, kind, lattice)
            except ValueError as fault:
                faults[str(fault)] = None
    raise ValueError("; ".join(faults))


def detect_circles(
    image: ArrayLike,
    *,
    lattice: str = "square",
) -> Detection:
    """Centers of the circles of a regular grid, with their places in the grid.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue, which become luminance. The circles are
        darker than their ground or, if no such grid is found, brighter.
    lattice : {"square", "hexagonal", "asymmetric"}
        What the circles lie on. The second step of a hexagonal lattice is at 60° to the first.
        An asymmetric grid has every second row shifted by half a step; its x and y count the half
        steps and the rows, as OpenCV's does. Another lattice than the named one is rejected.

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
    return find_pattern(Scene(_grey(image)), "circles", lattice)


def detect_squares(
    image: ArrayLike,
    *,
    pattern: str = "squares",
) -> Detection:
    """Corners of the squares of a regular grid, with their places in the grid.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue, which become luminance. The squares are
        darker than their ground or, if no such grid is found, brighter.
    pattern : {"squares", "chessboard"}
        Squares with gaps between them, or the fields of a chessboard, which touch at their corners:
        of it the inner corners are found, one `points` each, and a pitch is the side of a field.

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
    corners of a chessboard are saddle points of the smoothed image. From each corner to the next
    along an edge, dark and bright change places: by this rule a lattice is grown. Corners around
    which the image does not correlate with a drawn board are left out. Then two crossing edges are
    fitted to the grey levels around each.

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
    return find_pattern(Scene(_grey(image)), pattern)


def detect_charuco(image: ArrayLike) -> Detection:
    """Inner corners of a ChArUco board, a chessboard with markers in its bright fields.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue. A part of the board is enough. It may have
        any number of fields, and markers of any dictionary, also printed inverted.

    Returns
    -------
    Detection
        A point for each corner that was found; a pitch is the side of a field.

    Raises
    ------
    ValueError
        If `image` is no image, or shows fewer than four corners of such a board.

    Notes
    -----
    The corners are found as those of a chessboard, and held against the image along the edges of
    the dark fields alone, so that the markers play no part. They are not identified: as in other
    patterns, `grid` begins at the first column and row that were found. A plain chessboard is
    accepted, too, with the corners that `detect_squares` finds.

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
    return find_pattern(Scene(_grey(image)), "charuco")


def detect_micrometer(image: ArrayLike) -> Micrometer:
    """Lines of a stage micrometer or a ruler, and their distance in pixels.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue. The lines may be darker or brighter than
        their ground and run in any direction; they need not be equally long.

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
    scene = Scene(_grey(image))
    return find_scale(scene.grey, scene.settings)


def _grey(image: ArrayLike) -> NDArray[np.float32]:
    """Checked grey levels of an image, or the luminance of one in color."""
    return np.ascontiguousarray(as_image("image", luminance("image", image), smallest=16))
