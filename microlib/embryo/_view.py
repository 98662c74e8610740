"""A part of an image, turned so that the probe comes from above."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, as_region

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
        tilted = replace(self, tilt=float(np.arctan(slope)))
        x0, y0, width, height = self.region
        corners = np.array([[x, y] for x in (x0, x0 + width) for y in (y0, y0 + height)]) - 0.5
        x, y = tilted.from_image(corners).T
        first = int(np.ceil(tilted.from_image(self.to_image(entry))[:, 1].max())) + 1
        left, right, last = int(np.floor(x.min())), int(np.ceil(x.max())), int(np.ceil(y.max()))
        return replace(tilted, frame=(left, first, right - left, last - first))

    def of(self, image: NDArray) -> NDArray:
        """Return the part of an image, turned; a tilt continues the image beyond its edges."""
        x, y, width, height = self.region
        part = image[y : y + height, x : x + width]
        if self.tilt == 0:
            return np.rot90(part, DIRECTIONS[self.direction])
        part, border = np.ascontiguousarray(part), cv2.BORDER_REPLICATE
        size, flags = self.frame[2:], cv2.INTER_CUBIC
        return np.asarray(cv2.warpAffine(part, self._matrix, size, flags=flags, borderMode=border))

    def put_back(self, part: NDArray, image: NDArray) -> NDArray:
        """Return a copy of `image` with what `part` changes in its turned part."""
        x, y, width, height = self.region
        whole_image = image.copy()
        inside = whole_image[y : y + height, x : x + width]
        if self.tilt == 0:
            inside[:] = np.rot90(part, -DIRECTIONS[self.direction])
        else:
            changed = (part != self.of(image)).astype(np.float32)
            size, flags = (width, height), cv2.INTER_LINEAR + cv2.WARP_INVERSE_MAP
            where, filled = (
                np.asarray(cv2.warpAffine(each, self._matrix, size, flags=flags))
                for each in (changed, part)
            )
            inside[where > 0] = filled[where > 0]
        return whole_image

    def to_image(self, points: Array) -> Array:
        """Return points (x, y) of the turned part, y down, as points of the image, in px."""
        matrix = self._matrix
        # The inverse of a turn.
        return np.asarray((points - matrix[:, 2]) @ matrix[:, :2] + self.region[:2])

    def from_image(self, points: Array) -> Array:
        """Return points (x, y) of the image as points of the turned part, in px."""
        matrix = self._matrix
        return np.asarray((points - np.array(self.region[:2])) @ matrix[:, :2].T + matrix[:, 2])

    @property
    def _matrix(self) -> Array:
        """Affine map from the part to what is kept of it, turned, (2, 3)."""
        size = np.array(self.region[2:], float)
        turns = DIRECTIONS[self.direction]
        angle = 90.0 * turns - np.rad2deg(self.tilt)
        matrix = cv2.getRotationMatrix2D(((size - 1) / 2).tolist(), angle, 1.0)
        # The middle of the part becomes that of the part after the quarter turns.
        matrix[:, 2] += (size[::-1] - size) / 2 * (turns % 2) - self.frame[:2]
        return np.asarray(matrix)


def part_of(
    shape: tuple[int, ...], region: tuple[int, int, int, int] | None, smallest: int
) -> tuple[int, int, int, int]:
    """Return the part of an image of `shape` to look at, or refuse one that is not inside."""
    rows, columns = shape[:2]
    if region is None:
        return 0, 0, columns, rows
    return as_region("region", region, shape, least=smallest)
