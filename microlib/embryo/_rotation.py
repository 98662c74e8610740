"""Rotation of an image by quarter turns, which brings the probe to the upper edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, FlatResult

#: Edges that a probe may come from, and quarter turns counterclockwise that bring each to the top.
DIRECTIONS = {"top": 0, "bottom": 2, "left": 3, "right": 1}


@dataclass(frozen=True)
class Rotation(FlatResult):
    """Rotation of an image by quarter turns.

    Attributes
    ----------
    size : tuple of int
        Width and height of the image, in px.
    direction : str
        Edge of the image that the probe comes from.
    """

    size: tuple[int, int]
    direction: str

    def apply(self, image: NDArray) -> NDArray:
        """Return the rotated image."""
        return np.rot90(image, DIRECTIONS[self.direction])

    def to_image(self, points: Array) -> Array:
        """Return the points of the image that are points (x, y) of the rotated image, in px."""
        x, y = points.T
        width, height = self.size
        columns, rows = {
            "top": (x, y),
            "bottom": (width - 1 - x, height - 1 - y),
            "left": (y, height - 1 - x),
            "right": (width - 1 - y, x),
        }[self.direction]
        return np.stack([columns, rows], axis=1)
