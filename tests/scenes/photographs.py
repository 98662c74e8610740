"""Photographs of other things: as textures, and as images of which no modulus may be read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage import data
from skimage.color import rgb2gray

#: Photographs and drawings that come with scikit-image; the others would need the network.
PICTURES = sorted(
    path
    for path in Path(data.__file__).parent.glob("*.[pj][np]g")
    if path.name not in ("chessboard_RGB.png", "motorcycle_right.png")  # another of each is there
)


def grey_levels(picture: NDArray) -> NDArray:
    """Return grey levels, 0 to 255, of a picture that may have colors."""
    return 255 * rgb2gray(picture[..., :3]) if picture.ndim == 3 else picture.astype(float)


def photograph(name: str) -> NDArray:
    """Return one of scikit-image's photographs in grey levels."""
    return grey_levels(getattr(data, name)())


def middle(image: NDArray, side: int) -> NDArray:
    """Return the square in the middle of an image."""
    top, left = ((n - side) // 2 for n in image.shape)
    return image[top : top + side, left : left + side]


def pictures() -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Yield scikit-image's pictures by name, in grey, at most 800 px on the longer side."""
    for path in PICTURES:
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        scale = min(1.0, 800 / max(grey.shape))
        yield path.name, cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def texture(rng: np.random.Generator) -> NDArray[np.uint8]:
    """Draw noise of a random coarseness and contrast, with or without stripes down the image."""
    rows, columns = rng.integers(80, 500, 2)
    noise = cv2.GaussianBlur(rng.normal(size=(rows, columns)), (0, 0), rng.uniform(0.3, 12))
    grey = 150 + rng.uniform(5, 60) * noise / noise.std()
    if rng.random() < 0.5:
        for _ in range(rng.integers(1, 4)):
            left, width = rng.integers(0, columns - 20), rng.integers(4, 30)
            grey[: rng.integers(20, rows), left : left + width] *= rng.uniform(0.1, 0.8)
    return np.clip(grey, 0, 250).astype(np.uint8)
