"""Public functions of the detection, one for each kind of pattern."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import as_choice, as_image, luminance
from microlib.calibration._detection import Detection
from microlib.calibration.detection._boards import Charuco, Chessboard
from microlib.calibration.detection._circles import Circles
from microlib.calibration.detection._image import GreyImage
from microlib.calibration.detection._micrometer import Micrometer, find_scale
from microlib.calibration.detection._pattern import Pattern, find_pattern
from microlib.calibration.detection._settings import DetectionSettings
from microlib.calibration.detection._squares import Squares

_SETTINGS = DetectionSettings()
#: The patterns in the order in which `detect_pattern` tries them. Those of a group are found by the
#: same search.
_PATTERNS: tuple[tuple[Pattern, ...], ...] = (
    (Chessboard(_SETTINGS),),
    (Charuco(_SETTINGS),),
    (Squares(_SETTINGS), Circles(_SETTINGS)),
)


def detect_pattern(image: ArrayLike, pattern: str = "auto") -> tuple[str, Detection]:
    """Detect a calibration pattern whose kind is not known; return its name and its points.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue, which are converted to luminance.
    pattern : {"auto", "chessboard", "charuco", "squares", "circles"}
        Kind of the pattern, by default the first of these that is found.

    Returns
    -------
    name : str
        Kind of the pattern.
    detection : Detection
        Result of the function for this kind.

    Raises
    ------
    ValueError
        If `image` is no image or shows no such pattern. The message names the reason for each kind.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.calibration import detect_pattern
    >>> board = np.kron(np.indices((6, 7)).sum(axis=0) % 2, np.ones((20, 20)))
    >>> name, found = detect_pattern(np.pad(255 * board, 20, constant_values=128))
    >>> name, len(found.points)
    ('chessboard', 30)
    """
    names = [known.name for group in _PATTERNS for known in group]
    as_choice("pattern", pattern, ("auto", *names))
    grey, faults = GreyImage.from_levels(_grey(image)), []
    for group in _PATTERNS:
        asked = [known for known in group if pattern in ("auto", known.name)]
        try:
            if asked:
                return find_pattern(grey, asked)
        except ValueError as fault:
            faults.append(str(fault))
    raise ValueError("; ".join(faults))


def detect_charuco(image: ArrayLike) -> Detection:
    """Detect the inner corners of a ChArUco board, a chessboard with markers in its fields.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue, which are converted to luminance. The
        board may have any number of fields and markers of any dictionary, and may be inverted. A
        part of the board is enough.

    Returns
    -------
    Detection
        `points` are the inner corners. `grid` starts at the first detected column and row.

    Raises
    ------
    ValueError
        If `image` is no image or shows no chessboard with markers.

    Notes
    -----
    The corners are detected as those of a chessboard, but the image is compared with a drawn board
    along the edges of the fields only, so that the markers have no effect. The markers are not
    identified.

    Examples
    --------
    >>> import cv2
    >>> from microlib.calibration import detect_charuco
    >>> dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    >>> board = cv2.aruco.CharucoBoard((7, 5), 40, 30, dictionary)
    >>> found = detect_charuco(board.generateImage((500, 400), marginSize=20))
    >>> len(found.points)
    24
    """
    return detect_pattern(image, "charuco")[1]


def detect_circles(image: ArrayLike) -> Detection:
    """Detect the circles of a square grid; return their centers with their grid coordinates.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue, which are converted to luminance. The
        circles are darker than their background or, if no such grid is found, brighter.

    Returns
    -------
    Detection
        `points` are the images of the centers of circles that lie completely in the image. `grid`
        starts at the first detected column and row.

    Raises
    ------
    ValueError
        If `image` is no image or shows no grid of at least four complete circles, or if the circles
        differ in size, lie on another lattice, or deviate from every smooth image of the lattice.

    Notes
    -----
    The thesis computes the center "by least squares" (§5.2). Here an ellipse with a blurred edge is
    fitted to the grey levels around the whole outline by least squares. Under perspective and
    distortion, the center of the ellipse is not the image of the center of the circle. This bias is
    computed with a map from the grid to the image that is fitted to the points, and subtracted.

    OpenCV's asymmetric grid is a square lattice, turned by 45°. Its pitch is the distance of the
    nearest circles.

    An image with only the grid is thresholded. In other images, circles are searched among the
    closed contours of many grey levels, dark and bright. Marks are searched in a smaller copy of an
    image of more than 2.5 megapixels, where they must be 5 px wide, and are fitted at full size.

    Examples
    --------
    >>> from microlib.calibration import detect_circles
    >>> from microlib.microscope import Microscope
    >>> from microlib.synthetic import render_circles
    >>> scope = Microscope(
    ...     200000, 126000, 79380, tx=-300, ty=-300, pixel_pitch=9.9, image_size=(160, 120))
    >>> found = detect_circles(render_circles(scope))
    >>> error = found.points - scope.project(280.0 * found.positions)
    >>> len(found.points), bool(abs(error).max() < 0.01)
    (9, True)
    """
    return detect_pattern(image, "circles")[1]


def detect_squares(
    image: ArrayLike,
    *,
    pattern: str = "squares",
) -> Detection:
    """Detect the squares of a regular grid; return their corners with their grid coordinates.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue, which are converted to luminance. The
        squares are darker than their background or, if no such grid is found, brighter.
    pattern : {"squares", "chessboard"}
        Squares with gaps between them, or the fields of a chessboard. For a chessboard the result
        contains the inner corners, and the pitch is the side of a field.

    Returns
    -------
    Detection
        Four `points` for each square that lies completely in the image. `grid` counts sides and
        gaps: square (m, n) has its corners from (2m, 2n) to (2m + 1, 2n + 1). `side` is the
        measured side, with which `positions` are computed.

    Raises
    ------
    ValueError
        If `image` is not an image or shows no grid of at least four complete squares, if the marks
        are rectangles, or if their positions deviate from every smooth image of a grid.

    Notes
    -----
    The thesis finds edges with a Sobel operator, links them, and intersects the lines fitted to
    them (§5.2). Here the four lines of a square are fitted together to the grey levels. The model
    is a product of four blurred half-planes, which is exact for a right angle under a Gaussian
    point-spread function.

    An image that shows only the grid is thresholded. In other images, dark or bright squares are
    searched among the closed contours of many grey levels. The corners of a chessboard are saddle
    points of the smoothed image. From each corner to the next corner along an edge, the dark and
    the bright sides are exchanged. The lattice of corners is grown by this rule. Corners around
    which the image does not correlate with a drawn board are left out, and two crossing edges are
    fitted to the grey levels around each of the others.

    Examples
    --------
    >>> from microlib.calibration import detect_squares
    >>> from microlib.microscope import Microscope
    >>> from microlib.synthetic import render_squares
    >>> scope = Microscope(
    ...     200000, 126000, 79380, tx=-450, ty=-330, pixel_pitch=9.9, image_size=(160, 120))
    >>> found = detect_squares(render_squares(scope))
    >>> error = found.points - scope.project(200.0 * found.grid)
    >>> len(found.points), bool(abs(error).max() < 0.01), round(found.side, 3)
    (16, True, 0.5)
    """
    pattern = as_choice("pattern", pattern, ("squares", "chessboard"))
    return detect_pattern(image, pattern)[1]


def detect_micrometer(image: ArrayLike) -> Micrometer:
    """Detect the lines of a stage micrometer or ruler; return them with their distance in pixels.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue. The lines may be darker or brighter than
        their background, have any direction, and differ in length. Parts of the scale may have only
        every fifth or tenth line.

    Returns
    -------
    Micrometer

    Raises
    ------
    ValueError
        If `image` is no image, or shows no scale of at least three equidistant lines away from its
        edges, or their distance is uncertain by more than 10 %.

    Notes
    -----
    The direction is that of the sharpest mean profile of the image. The lines are the peaks of the
    profile of the rows with the most contrast, and each line is at the centroid of its peak. Lines
    at an edge of the image are left out, as the edge moves their centroids. The spacing is the
    slope of a straight line through these positions over whole numbers. A cubic that fits them
    significantly better shows distortion or a tilt, and widens the interval. A grid of lines is
    measured across the clearer of its directions.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.calibration import detect_micrometer
    >>> x = np.arange(200.0)
    >>> lines = sum(np.exp(-((x - 13.3 - 17.2 * k) ** 2) / 4) for k in range(11))
    >>> noise = np.random.default_rng(0).normal(0, 2, (60, 200))
    >>> scale = detect_micrometer(200 - 120 * lines + noise)
    >>> len(scale.points), round(scale.spacing.value, 2), round(scale.um_per_pixel(10.0).value, 3)
    (11, 17.2, 0.581)
    """
    return find_scale(_grey(image), _SETTINGS)


def _grey(image: ArrayLike) -> NDArray[np.float32]:
    """Checked grey levels of an image, or the luminance of a color image."""
    return np.ascontiguousarray(as_image("image", luminance("image", image), smallest=16))
