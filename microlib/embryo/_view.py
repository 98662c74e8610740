"""A part of an image, turned so that the probe comes from above."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
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
    tilt : float
        Angle by which the part is turned clockwise after that, about its middle, in radians.
    frame : tuple of int
        Of the part turned by `tilt` what is kept: x and y of the first pixel from the place that
        the part's own had before, width and height, in px; all zero without a tilt.
    """

    region: tuple[int, int, int, int]
    direction: str
    tilt: float = 0.0
    frame: tuple[int, int, int, int] = (0, 0, 0, 0)

    def upright(self, slope: float, entry: Array) -> View:
        """Return the view in which a probe is upright that leans.

        Parameters
        ----------
        slope : float
            Change of the probe's x for each px down.
        entry : ndarray, shape (n, 2)
            Points (x, y) of this view below which the whole width of the probe is inside the image.
            The new view begins there.
        """
        width, height = self._size
        tilted = replace(self, tilt=float(np.arctan(slope)), frame=(0, 0, width, height))
        corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) - 0.5
        x, y = tilted._turned(corners).T
        first = int(np.ceil(tilted._turned(entry)[:, 1].max())) + 1
        left, right, last = int(np.floor(x.min())), int(np.ceil(x.max())), int(np.ceil(y.max()))
        return replace(tilted, frame=(left, first, right - left, last - first))

    def of(self, image: NDArray) -> NDArray:
        """Return the part of an image, turned; a tilt continues the image beyond its edges."""
        x, y, width, height = self.region
        part = np.rot90(image[y : y + height, x : x + width], DIRECTIONS[self.direction])
        if self.tilt == 0:
            return part
        return np.asarray(
            cv2.warpAffine(
                np.ascontiguousarray(part),
                self._matrix,
                self.frame[2:],
                flags=cv2.INTER_CUBIC,
                borderMode=cv2.BORDER_REPLICATE,
            )
        )

    def put_back(self, part: NDArray, image: NDArray) -> NDArray:
        """Return a copy of `image` with what `part` changes in its turned part."""
        x, y, width, height = self.region
        whole_image = image.copy()
        if self.tilt != 0:
            before = replace(self, tilt=0.0).of(image)
            size, flags = before.shape[::-1], cv2.INTER_LINEAR + cv2.WARP_INVERSE_MAP
            changed = (part != self.of(image)).astype(np.float32)
            inside = np.asarray(cv2.warpAffine(changed, self._matrix, size, flags=flags)) > 0
            filled = cv2.warpAffine(part, self._matrix, size, flags=flags)
            part = np.where(inside, filled, before)
        whole_image[y : y + height, x : x + width] = np.rot90(part, -DIRECTIONS[self.direction])
        return whole_image

    def to_image(self, points: Array) -> Array:
        """Return points (x, y) of the turned part, y down, as points of the image, in px."""
        x0, y0, width, height = self.region
        upright = np.asarray(points, dtype=np.float64)
        if self.tilt != 0:
            matrix = self._matrix
            upright = (upright - matrix[:, 2]) @ matrix[:, :2]  # the inverse of a turn
        x, y = upright.T
        turned = {
            "top": (x, y),
            "right": (width - 1 - y, x),
            "bottom": (width - 1 - x, height - 1 - y),
            "left": (y, height - 1 - x),
        }[self.direction]
        return np.stack([x0 + turned[0], y0 + turned[1]], axis=1)

    @property
    def _size(self) -> tuple[int, int]:
        """Width and height of the part after the quarter turns."""
        width, height = self.region[2:]
        return (width, height) if DIRECTIONS[self.direction] % 2 == 0 else (height, width)

    @property
    def _matrix(self) -> Array:
        """Affine map from the part after the quarter turns to what is kept, (2, 3)."""
        cos, sin = np.cos(self.tilt), np.sin(self.tilt)
        turn = np.array([[cos, -sin], [sin, cos]])
        middle = (np.array(self._size) - 1) / 2
        shift = middle - turn @ middle - self.frame[:2]
        return np.concatenate([turn, shift[:, np.newaxis]], axis=1)

    def _turned(self, points: Array) -> Array:
        matrix = self._matrix
        return np.asarray(points @ matrix[:, :2].T + matrix[:, 2])


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
