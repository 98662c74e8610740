"""Frames of a microgripper over a blurred background, with known motion."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import (
    Array,
    Result,
    as_array,
    as_generator,
    as_image_shape,
    as_integer,
    as_scalar,
)
from microlib.synthetic._textures import eight_bits, mixed_texture

#: Samples of the drawing per pixel, which are interpolated linearly. Half or twice as many move the
#: gripper by less than 0.001 px.
_DENSITY = 4

#: Outline of one jaw in units of the gap, from the arm at the left, beyond the frame, to the tip.
_JAW = np.array([[-60, 0.9], [-2.4, 0.9], [-1.2, 0.5], [0.9, 0.5], [0.9, 1.3], [-60, 2.6]])

#: Positions of the etched holes in units of the gap, along the center line of the arm. Outline and
#: holes are invented: the scene needs straight edges and marks along them.
_HOLES = [(x, 1.1 + 0.65 * (0.9 - x) / 60.9) for x in np.arange(-12.0, -2.7, 0.8)]

#: Mean and standard deviation (grey levels) and scale (px) of the texture of the jaws and of the
#: background, which is invented, darker and out of focus.
_GRAIN = {"mean": 165.0, "std": 18.0, "scales": 1.5}
_GROUND = {"mean": 70, "std": 4, "scales": 12}


@dataclass(frozen=True, eq=False, repr=False)
class GripperScene(Result):
    """A microgripper over a smooth background, drawn at any sub-pixel position.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns of a frame.
    home : ndarray, shape (2,)
        (x, y) of the center of the opening at zero shift, px.
    opening : float
        Gap between the jaws in px.
    drawing, cover : ndarray
        Grey levels of the gripper and its opacity, `_DENSITY` samples per pixel.
    ground : ndarray, shape (H, W)
        Grey levels of the background.
    """

    shape: tuple[int, int]
    home: Array
    opening: float
    drawing: NDArray[np.float32]
    cover: NDArray[np.float32]
    ground: NDArray[np.float32]

    def box(self, size: int, shift: ArrayLike = (0.0, 0.0)) -> tuple[int, int, int, int]:
        """Return (x, y, width, height) of a window of `size` px about the shifted opening."""
        size = as_integer("size", size, least=1)
        shift = as_array("shift", shift, shape=(2,))
        x, y = np.rint(self.home - (size - 1) / 2 + shift).astype(int)
        return int(x), int(y), size, size

    def frame(
        self, shift: ArrayLike, rng: np.random.Generator | int, *, noise: float = 2.0
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
        scene = drawing + (1.0 - cover) * self.ground
        sigma = as_scalar("noise", noise, least=0)
        noisy = scene + sigma * as_generator("rng", rng).standard_normal(self.shape, np.float32)
        return eight_bits(noisy)


def gripper_scene(
    rng: np.random.Generator | int,
    *,
    pixel_size: float,
    gap: float = 100.0,
    shape: tuple[int, int] = (240, 320),
    reach: int = 80,
) -> GripperScene:
    """Draw a microgripper with two textured jaws and etched holes.

    Parameters
    ----------
    rng : numpy.random.Generator or int
        Random generator of texture and background, or its seed.
    pixel_size : float
        Effective pixel size in the object plane, µm.
    gap : float, optional
        Opening between the jaws in µm (100 for the gripper of §5.1).
    shape : tuple of int, optional
        Rows and columns of a frame.
    reach : int, optional
        Largest shift of the gripper along either axis, px.

    Returns
    -------
    GripperScene
        The scene, whose `frame` draws the gripper at any shift.

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
    opening = as_scalar("gap", gap, above=0) / as_scalar("pixel_size", pixel_size, above=0)
    reach = as_integer("reach", reach, least=1)
    rows, columns = as_image_shape("shape", shape, least=50)  # room for both jaws
    if opening > rows / 3:
        raise ValueError(
            f"gap must be under a third of the frame's {rows} px, got {opening:.0f} px"
        )
    rng = as_generator("rng", rng)
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
    # The camera's point spread function: no edge is sharper than a pixel.
    soft = cv2.GaussianBlur(cover, (0, 0), 0.8 * _DENSITY).astype(np.float32)
    return GripperScene(
        shape=(rows, columns),
        home=middle,
        opening=opening,
        drawing=soft * fine.astype(np.float32),
        cover=soft,
        ground=mixed_texture((rows, columns), rng, **_GROUND),
    )
