"""Rotation of an image that brings the probe to the upper edge."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, FlatResult

#: Edges that a probe may come from, and quarter turns counterclockwise that bring each to the top.
DIRECTIONS = {"top": 0, "bottom": 2, "left": 3, "right": 1}


@dataclass(frozen=True)
class Rotation(FlatResult):
    """Rotation of an image by quarter turns and a tilt.

    Attributes
    ----------
    size : tuple of int
        Width and height of the image, in px.
    direction : str
        Edge of the image that the probe comes from.
    tilt : float
        Angle of a further clockwise rotation about the middle of the image, in radians; 0 if the
        probe is within 4° of the vertical.
    frame : tuple of int
        Part of the tilted image that is kept: x and y of its first pixel, relative to the first
        pixel before the tilt, width and height, in px. All zero without a tilt.
    """

    size: tuple[int, int]
    direction: str
    tilt: float = 0.0
    frame: tuple[int, int, int, int] = (0, 0, 0, 0)

    def upright(self, slope: float, entry: Array) -> Rotation:
        """Return the rotation after which a leaning probe is vertical.

        Parameters
        ----------
        slope : float
            Change of the probe's x for each px down.
        entry : ndarray, shape (n, 2)
            Points (x, y) of the rotated image below which the whole width of the probe is in the
            image. The newly rotated image begins there.
        """
        tilted = replace(self, tilt=float(np.arctan(slope)))
        width, height = self.size
        corners = np.array([[x, y] for x in (0, width) for y in (0, height)]) - 0.5
        x, y = tilted.from_image(corners).T
        first = int(np.ceil(tilted.from_image(self.to_image(entry))[:, 1].max())) + 1
        left, right, last = int(np.floor(x.min())), int(np.ceil(x.max())), int(np.ceil(y.max()))
        return replace(tilted, frame=(left, first, right - left, last - first))

    def apply(self, image: NDArray) -> NDArray:
        """Return the rotated image; a tilt replicates its borders."""
        if self.tilt == 0:
            return np.rot90(image, DIRECTIONS[self.direction])
        size, flags, border = self.frame[2:], cv2.INTER_CUBIC, cv2.BORDER_REPLICATE
        return np.asarray(cv2.warpAffine(image, self._matrix, size, flags=flags, borderMode=border))

    def to_image(self, points: Array) -> Array:
        """Return the points of the image that are points (x, y) of the rotated image, in px."""
        # The inverse of a rotation is its transpose.
        return np.asarray((points - self._matrix[:, 2]) @ self._matrix[:, :2])

    def from_image(self, points: Array) -> Array:
        """Return the points of the rotated image that are points (x, y) of the image, in px."""
        return np.asarray(points @ self._matrix[:, :2].T + self._matrix[:, 2])

    @property
    def _matrix(self) -> Array:
        """Affine map from the image to the rotated image, (2, 3)."""
        size = np.array(self.size, float)
        turns = DIRECTIONS[self.direction]
        angle = np.rad2deg(np.pi / 2 * turns - self.tilt)
        matrix = cv2.getRotationMatrix2D(((size - 1) / 2).tolist(), angle, 1.0)
        # Quarter turns exchange width and height, and with them the middle of the image.
        matrix[:, 2] += (size[::-1] - size) / 2 * (turns % 2) - self.frame[:2]
        return np.asarray(matrix)
