"""Frames with a known motion: warped textures, and a microgripper over a blurred ground."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from microlib._common import (
    Array,
    Result,
    as_array,
    between,
    generator,
    image_shape,
    one_of,
    positive,
    scalar,
    whole,
)
from microlib.synthetic._textures import MOST_LEVEL, MOST_SCALE, eight_bits, mixed_texture

#: Samples of the gripper's drawing per pixel, which are interpolated linearly: half or twice as
#: many move the drawn gripper by less than 0.001 px.
_DENSITY = 4

#: Standard deviation of the grey values of a tracked texture: eight bits about a mean of 128 hold
#: 2.8 of it.
_CONTRAST = 45.0

#: Order of the splines that move a texture: they are wrong by 0.4 grey levels (root mean square) on
#: one blurred by 1 px, cubic ones by 0.8 and linear ones by 4.5; the camera's noise is 2.
_ORDER = 5

#: Outline of one jaw in units of the gap, from the arm at the left, beyond the frame, to the tip.
_JAW = np.array([[-60, 0.9], [-2.4, 0.9], [-1.2, 0.5], [0.9, 0.5], [0.9, 1.3], [-60, 2.6]])

#: Where the etched holes are, in units of the gap: along the middle line of the arm, which runs
#: from the tip to the far end of the outline. Like the outline they are invented: a scene needs
#: edges along which it looks alike, and marks across them.
_HOLES = [(x, 1.1 + 0.65 * (0.9 - x) / 60.9) for x in np.arange(-12.0, -2.7, 0.8)]

#: Mean and standard deviation (grey levels) and scale (px) of the grain of the jaws, and of the
#: ground behind them; invented, too: the ground is darker and smooth as what is out of focus.
_GRAIN = {"mean": 165.0, "std": 18.0, "scales": 1.5}
_GROUND = {"mean": 70, "std": 4, "scales": 12}

#: Largest side of a template, and farthest that it may move, px.
_MOST_SIDE = 4096

#: Farthest that the gripper may move, px: a drawing of a gigabyte.
_MOST_REACH = 2048


def camera_frame(
    image: ArrayLike, rng: np.random.Generator | int, *, noise: float, gain: float = 1.0
) -> NDArray[np.uint8]:
    """Return grey values as a camera gives them, with noise and in eight bits.

    Parameters
    ----------
    image : array_like, shape (H, W)
        Grey values.
    rng : numpy.random.Generator or int
        Source of the noise, or its seed.
    noise : float
        Standard deviation of the normal noise, grey levels.
    gain : float, optional
        Factor on the grey values, before the noise.

    Returns
    -------
    ndarray of uint8, shape (H, W)
        Grey values, rounded and clipped to 0…255.

    Raises
    ------
    ValueError
        If the image is not two-dimensional and finite, or the noise is negative.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.synthetic import camera_frame
    >>> camera_frame([[10.4, 300.0]], np.random.default_rng(0), noise=0.0)
    array([[ 10, 255]], dtype=uint8)
    """
    grey = as_array("image", image, shape=(None, None), largest=MOST_LEVEL**2)
    sigma = scalar("noise", noise, least=0, most=MOST_LEVEL)
    rng = generator("rng", rng)
    gain = scalar("gain", gain, within=(-MOST_LEVEL, MOST_LEVEL))
    return eight_bits(gain * grey + sigma * rng.standard_normal(grey.shape, np.float32))


@dataclass(frozen=True, eq=False, repr=False)
class WarpedPair(Result):
    """Two frames of a texture and where the template of the first is in the second.

    Attributes
    ----------
    first, second : ndarray, shape (H, W)
        Frames.
    box : tuple of int
        (x, y, width, height) of the template in `first`, px.
    corners : ndarray, shape (4, 2)
        Its corners in `second`, (x, y) in px.
    """

    first: NDArray[np.uint8]
    second: NDArray[np.uint8]
    box: tuple[int, int, int, int]
    corners: Array


def warped_pair(
    rng: np.random.Generator | int,
    distance: float,
    *,
    warp: str = "shift",
    size: int = 50,
    sigma: float = 1.0,
    noise: float = 2.0,
    gain: float = 1.05,
) -> WarpedPair:
    """Warp a texture so that the template's corners move by `distance` px (root mean square).

    Parameters
    ----------
    rng : numpy.random.Generator or int
        Source of the texture, the warp and the noise, or its seed.
    distance : float
        Root mean square displacement of the four corners in px.
    warp : {"shift", "affine", "homography"}
        A shift in a random direction, or corners displaced independently (normal) through the
        nearest affine map or the homography.
    size : int, optional
        Width and height of the template in px.
    sigma, noise, gain : float, optional
        Of the texture in px (`mixed_texture`), of the camera in grey levels, of the second frame.

    Returns
    -------
    WarpedPair
        Both frames, and where the template is in each.

    Raises
    ------
    ValueError
        If a parameter is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.synthetic import warped_pair
    >>> pair = warped_pair(np.random.default_rng(0), 5.0)
    >>> x, y, width, height = pair.box
    >>> moved = pair.corners - [[x, y], [x + 49, y], [x + 49, y + 49], [x, y + 49]]
    >>> np.hypot(*moved.T).round(9)
    array([5., 5., 5., 5.])
    """
    one_of("warp", warp, ("shift", "affine", "homography"))
    size = whole("size", size, least=2, most=_MOST_SIDE)
    sigma = scalar("sigma", sigma, above=0, most=MOST_SCALE)
    distance = scalar("distance", distance, least=0, most=_MOST_SIDE)
    rng = generator("rng", rng)
    side = 3 * size  # the template in the middle, with its own size around it
    texture = mixed_texture((side, side), rng, std=_CONTRAST, scales=sigma)
    unit = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    source = unit * (size - 1) + size
    if warp == "shift":
        angle = rng.uniform(0, 2 * np.pi)
        moved = np.tile([np.cos(angle), np.sin(angle)], (4, 1))
    else:
        moved = rng.standard_normal((4, 2))
    if warp == "affine":
        design = np.column_stack([unit, np.ones(4)])
        moved = design @ np.linalg.lstsq(design, moved, rcond=None)[0]
    moved *= distance / np.sqrt(np.mean(np.sum(moved**2, axis=1)))
    homography = _homography(source, source + moved)
    rows, columns = np.mgrid[:side, :side]
    points = np.linalg.inv(homography) @ np.stack(
        [columns.ravel(), rows.ravel(), np.ones(rows.size)]
    )
    warped = ndimage.map_coordinates(
        texture, points[1::-1] / points[2], order=_ORDER, mode="grid-wrap"
    ).reshape(side, side)
    return WarpedPair(
        first=camera_frame(texture, rng, noise=noise),
        second=camera_frame(warped, rng, noise=noise, gain=gain),
        box=(size, size, size, size),
        corners=source + moved,
    )


def _homography(source: Array, target: Array) -> Array:
    """Return the homography through four point pairs."""
    rows = []
    for (x, y), (u, v) in zip(source, target, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y])
        rows.append([0, 0, 0, x, y, 1, -v * x, -v * y])
    return np.append(np.linalg.solve(np.array(rows), target.ravel()), 1.0).reshape(3, 3)


def texture_sequence(
    positions: ArrayLike,
    rng: np.random.Generator | int,
    *,
    size: int = 50,
    sigma: float = 1.0,
    noise: float = 2.0,
) -> list[NDArray[np.uint8]]:
    """Return frames of a textured square moving over another texture, both as fine as `sigma` px.

    Parameters
    ----------
    positions : array_like, shape (N, 2)
        (x, y) of the square's first pixel in each frame, px; they set the size of the frames.
    rng : numpy.random.Generator or int
        Source of both textures and the noise, or its seed.
    size : int, optional
        Width and height of the square in px.
    sigma, noise : float, optional
        Of the textures in px, of the camera in grey levels.

    Returns
    -------
    list of ndarray of uint8
        One frame a position, all of one size.

    Raises
    ------
    ValueError
        If the positions are not N×2, finite and at least zero.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.synthetic import texture_sequence
    >>> frames = texture_sequence([[5.0, 5.0], [7.5, 5.0]], np.random.default_rng(0), size=20)
    >>> [frame.shape for frame in frames]
    [(45, 48), (45, 48)]
    """
    positions = as_array("positions", positions, shape=(None, 2))
    positive("positions", positions, zero=True)
    between("positions", positions, 0.0, _MOST_SIDE, closed=True)
    size = whole("size", size, least=2, most=_MOST_SIDE)
    sigma = scalar("sigma", sigma, above=0, most=MOST_SCALE)
    rng = generator("rng", rng)
    width, height = (np.ceil(positions.max(axis=0)) + 2 * size).astype(int)
    ground = mixed_texture((height, width), rng, std=_CONTRAST, scales=sigma)
    square = mixed_texture((size, size), rng, std=_CONTRAST, scales=sigma)
    margin = 8  # what the spline assumes beyond decays by 0.43 a sample
    spline = ndimage.spline_filter(np.pad(square, margin, mode="wrap"), order=_ORDER)
    frames = []
    for x, y in positions:
        image = ground.copy()
        column, row = int(np.floor(x)), int(np.floor(y))
        columns, rows = np.arange(size + 1) + column - x, np.arange(size + 1) + row - y
        grid = np.meshgrid(rows + margin, columns + margin, indexing="ij")
        moved = ndimage.map_coordinates(spline, grid, order=_ORDER, prefilter=False)
        cover = np.outer(_coverage(rows, size), _coverage(columns, size))
        part = image[row : row + size + 1, column : column + size + 1]
        part += cover * (moved - part)
        frames.append(camera_frame(image, rng, noise=noise))
    return frames


def _coverage(samples: Array, size: int) -> Array:
    """Return the share of each unit pixel that lies on [−½, size − ½]."""
    return np.clip(np.minimum(samples + 1.0, size - samples), 0.0, 1.0)


@dataclass(frozen=True, eq=False, repr=False)
class GripperScene(Result):
    """A microgripper over a smooth ground, drawn at any sub-pixel position.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns of a frame.
    home : ndarray, shape (2,)
        (x, y) of the middle of the opening at zero shift, px.
    opening : float
        Gap between the jaws in px.
    drawing, cover : ndarray
        Grey values of the gripper and its opacity, `_DENSITY` samples a pixel.
    ground : ndarray, shape (H, W)
        Grey values behind it.
    """

    shape: tuple[int, int]
    home: Array
    opening: float
    drawing: NDArray[np.float32]
    cover: NDArray[np.float32]
    ground: NDArray[np.float32]

    def box(self, size: int, shift: ArrayLike = (0.0, 0.0)) -> tuple[int, int, int, int]:
        """Return (x, y, width, height) of a window of `size` px about the shifted opening."""
        size = whole("size", size, least=1)
        shift = as_array("shift", shift, shape=(2,), largest=_MOST_REACH)
        x, y = np.rint(self.home - (size - 1) / 2 + shift).astype(int)
        return int(x), int(y), size, size

    def frame(
        self,
        shift: ArrayLike,
        rng: np.random.Generator | int,
        *,
        noise: float = 2.0,
        gain: float = 1.0,
    ) -> NDArray[np.uint8]:
        """Return the frame with the gripper moved by `shift` = (x, y) px from home."""
        shift = as_array("shift", shift, shape=(2,))
        margin = (np.array(self.drawing.shape[::-1]) / _DENSITY - self.shape[::-1]) / 2
        if (np.abs(shift) > margin - 1).any():
            raise ValueError(f"shift must lie within ±{margin.min() - 1:g} px, got {shift}")
        first = _DENSITY * (margin - shift)
        sampling = np.array([[_DENSITY, 0, first[0]], [0, _DENSITY, first[1]]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size = self.shape[::-1]
        drawing = cv2.warpAffine(self.drawing, sampling, size, flags=flags)
        cover = cv2.warpAffine(self.cover, sampling, size, flags=flags)
        return camera_frame(drawing + (1.0 - cover) * self.ground, rng, noise=noise, gain=gain)


def gripper_scene(
    rng: np.random.Generator | int,
    *,
    pixel_size: float,
    gap: float = 100.0,
    shape: tuple[int, int] = (240, 320),
    reach: int = 80,
) -> GripperScene:
    """Draw a microgripper with two grained jaws and etched holes.

    Parameters
    ----------
    rng : numpy.random.Generator or int
        Source of the grain and of the ground, or its seed.
    pixel_size : float
        Effective pixel size in the object plane, µm.
    gap : float, optional
        Opening between the jaws in µm (100 for the gripper of §5.1).
    shape : tuple of int, optional
        Rows and columns of a frame.
    reach : int, optional
        How far the gripper may move from home along either axis, px.

    Returns
    -------
    GripperScene
        Its `frame` draws the gripper at any shift.

    Raises
    ------
    ValueError
        If a length is not positive or the opening does not fit the frame.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.synthetic import gripper_scene
    >>> rng = np.random.default_rng(0)
    >>> scene = gripper_scene(rng, pixel_size=6.23)
    >>> scene.frame((10.5, -3.25), rng).shape, round(scene.opening, 2)
    ((240, 320), 16.05)
    """
    opening = scalar("gap", gap, above=0) / scalar("pixel_size", pixel_size, above=0)
    reach = whole("reach", reach, least=1, most=_MOST_REACH)
    rows, columns = image_shape("shape", shape, least=50)  # room for both jaws
    if opening > rows / 3:
        raise ValueError(
            f"gap must be under a third of the frame's {rows} px, got {opening:.0f} px"
        )
    rng = generator("rng", rng)
    margin = reach + 2  # a pixel for the interpolation, and one that `frame` keeps
    height, width = _DENSITY * (rows + 2 * margin), _DENSITY * (columns + 2 * margin)
    middle = np.array([(columns - 1) / 2, (rows - 1) / 2])
    cover = np.zeros((height, width), np.float32)
    scale = opening * _DENSITY
    x0, y0 = _DENSITY * (middle + margin)
    for side in (-1, 1):
        outline = np.column_stack([x0 + scale * _JAW[:, 0], y0 + side * scale * _JAW[:, 1]])
        fixed = np.rint(outline * 2**4).astype(np.int32)
        cv2.fillPoly(cover, [fixed], 1.0, cv2.LINE_8, 4)
        radius = int(np.rint(2**4 * scale / 10))
        for x, y in _HOLES:
            spot = np.array([x0 + scale * x, y0 + side * scale * y])
            fixed = np.rint(spot * 2**4).astype(int)
            cv2.circle(cover, fixed, radius, 0.35, -1, cv2.LINE_8, 4)
    grain = mixed_texture((height // _DENSITY, width // _DENSITY), rng, **_GRAIN)
    fine = cv2.resize(grain, (width, height), interpolation=cv2.INTER_CUBIC)
    # The camera's point spread: no edge is sharper than a pixel.
    soft = cv2.GaussianBlur(cover, (0, 0), 0.8 * _DENSITY).astype(np.float32)
    return GripperScene(
        shape=(rows, columns),
        home=middle,
        opening=opening,
        drawing=soft * fine.astype(np.float32),
        cover=soft,
        ground=mixed_texture((rows, columns), rng, **_GROUND),
    )
