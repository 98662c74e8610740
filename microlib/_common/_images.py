"""Checks of images, of their regions and of their sizes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common._checks import ArgumentError, as_array, as_integer, as_tuple
from microlib._common._types import Region


def as_image(name: str, value: ArrayLike, *, smallest: int = 1) -> NDArray:
    """Return a grey image as a finite 2-D float32 array, each side at least `smallest` px."""
    image = as_array(name, value, dtype=np.float32)
    if image.ndim != 2:
        raise ArgumentError(name, f"must be a grey image of two dimensions, got {image.ndim}")
    if min(image.shape) < smallest:
        raise ArgumentError(name, f"must be at least {smallest} px on each side, got {image.shape}")
    return image


def luminance(name: str, value: ArrayLike) -> NDArray:
    """Return a grey image as it is, or the luminance of a color image as float32."""
    import cv2  # here, as formulas do without it

    image = value if type(value) is np.ndarray else as_array(name, value)
    if image.ndim == 3 and image.shape[2] in (3, 4):
        color = np.ascontiguousarray(as_array(name, image, dtype=np.float32)[..., :3])
        image = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    return image


def as_picture(name: str, value: ArrayLike) -> NDArray[np.float32]:
    """Return a grey image (rows, cols), or one in color (rows, cols, 3 or 4), as float32."""
    image = as_array(name, value, dtype=np.float32)
    if image.ndim != 2 and (image.ndim != 3 or image.shape[2] not in (3, 4)):
        raise ArgumentError(name, f"must be one image, grey or in color, got shape {image.shape}")
    return image


def as_region(
    name: str, value: object, shape: tuple[int, ...] | None = None, *, least: int = 1
) -> Region:
    """Return (x, y, width, height) of a part, each side at least `least` px, of an image."""
    four = as_tuple(f"{name} (x, y, width, height)", value, 4)
    sides = zip(("x", "y", "width", "height"), four, (0, 0, least, least), strict=True)
    x, y, width, height = (as_integer(f"{name} {side}", n, least=low) for side, n, low in sides)
    if shape is not None and (y + height > shape[0] or x + width > shape[1]):
        size = f"{shape[1]}×{shape[0]} px"
        got = f"x + width = {x + width} and y + height = {y + height} of (x, y, width, height)"
        raise ArgumentError(name, f"must lie in the image of {size}, got {got}")
    return x, y, width, height


def as_image_shape(name: str, value: object, *, least: int = 1) -> tuple[int, int]:
    """Return (rows, columns), each at least `least`."""
    rows, columns = (as_integer(name, n, least=least) for n in as_tuple(name, value, 2))
    return rows, columns
