"""A part of an image, turned so that the probe comes from above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, whole

__all__ = ["DIRECTIONS", "View", "part_of"]

#: Edges that a probe may come from, and quarter turns counterclockwise that bring each to the top.
DIRECTIONS = {"top": 0, "bottom": 2, "left": 3, "right": 1}


@dataclass(frozen=True)
class View:
    """How an image was cut and turned.

    Attributes
    ----------
    region : tuple of int
        The part: x and y of its first pixel, width and height, in px.
    direction : str
        Edge of the part that the probe comes from.
    """

    region: tuple[int, int, int, int]
    direction: str

    def of(self, image: NDArray) -> NDArray:
        """Return the part of an image, turned."""
        x, y, width, height = self.region
        return np.rot90(image[y : y + height, x : x + width], DIRECTIONS[self.direction])

    def put_back(self, part: NDArray, image: NDArray) -> NDArray:
        """Return a copy of `image` with its part replaced by a turned one."""
        x, y, width, height = self.region
        whole_image = image.copy()
        whole_image[y : y + height, x : x + width] = np.rot90(part, -DIRECTIONS[self.direction])
        return whole_image

    def to_image(self, points: Array) -> Array:
        """Return points (x, y) of the turned part, y down, as points of the image, in px."""
        x0, y0, width, height = self.region
        x, y = np.asarray(points, dtype=np.float64).T
        turned = {
            "top": (x, y),
            "right": (width - 1 - y, x),
            "bottom": (width - 1 - x, height - 1 - y),
            "left": (y, height - 1 - x),
        }[self.direction]
        return np.stack([x0 + turned[0], y0 + turned[1]], axis=1)


def part_of(
    shape: tuple[int, ...], region: tuple[int, int, int, int] | None, smallest: int
) -> tuple[int, int, int, int]:
    """Return the part of an image of `shape` to look at, or refuse one that is not inside."""
    rows, columns = shape[:2]
    if region is None:
        return 0, 0, columns, rows
    if not isinstance(region, (tuple, list)) or len(region) != 4:
        raise ValueError(f"region must be (x, y, width, height), got {region!r}")
    x, y = (whole("region", value, least=0) for value in region[:2])
    width, height = (whole("region", value, least=smallest) for value in region[2:])
    if x + width > columns or y + height > rows:
        raise ValueError(
            f"region must lie inside the image of {columns}×{rows} px, got {width}×{height} px at "
            f"({x}, {y})"
        )
    return x, y, width, height
