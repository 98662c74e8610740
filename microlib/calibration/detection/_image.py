"""Grey image of a pattern, sampled at any place and compared with a drawn pattern."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array

#: Places in the cell around a mark, in steps, 16 by 16.
CELL = np.stack(np.meshgrid(*2 * [(np.arange(16) - 7.5) / 16]), axis=-1).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class GreyImage:
    """Image in which the marks are dark.

    Attributes
    ----------
    grey : ndarray of float32, shape (height, width)
        Grey levels.
    smooth : ndarray of float32, shape (height, width)
        Grey levels after a Gaussian blur of 1 px.
    """

    grey: NDArray[np.float32]
    smooth: NDArray[np.float32]

    @classmethod
    def from_levels(cls, grey: NDArray[np.float32]) -> GreyImage:
        """Smooth an image."""
        return cls(grey, np.asarray(cv2.GaussianBlur(grey, (0, 0), 1.0)))

    def negative(self) -> GreyImage:
        """Image in which the bright marks are dark."""
        ends = self.grey.max() + self.grey.min()
        return GreyImage(ends - self.grey, ends - self.smooth)

    def reduced(self, factor: int) -> GreyImage:
        """Image with the mean of each square of `factor` × `factor` pixels."""
        height, width = (n // factor for n in self.grey.shape)
        whole = self.grey[: height * factor, : width * factor]
        return self.from_levels(
            np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))
        )

    def middle(self, factor: int) -> GreyImage:
        """Middle of the image, of which it has 1/`factor` along each side."""
        rows, columns = (
            slice((n - n // factor) // 2, (n + n // factor) // 2) for n in self.grey.shape
        )
        return GreyImage(self.grey[rows, columns], self.smooth[rows, columns])

    @property
    def last_pixel(self) -> NDArray[np.intp]:
        """Coordinates (x, y) of the last pixel."""
        return np.array(self.grey.shape[::-1]) - 1

    def levels(self, places: Array) -> Array:
        """Smoothed grey levels at places (n, k, 2), px; outside the image those of its border."""
        x, y = np.moveaxis(places.astype(np.float32), -1, 0)
        border = cv2.BORDER_REPLICATE
        return np.asarray(cv2.remap(self.smooth, x, y, cv2.INTER_LINEAR, borderMode=border))

    def correlation(self, centers: Array, steps: Array, places: Array, drawn: Array) -> Array:
        """Correlation of the image around each mark with the drawn pattern, (n,).

        It is the least correlation of the four halves of the surroundings. Of a sublattice, such as
        every second mark, a half of the surroundings differs from the drawing; at the edge of a
        board a half has no contrast.

        Parameters
        ----------
        centers : ndarray, shape (n, 2)
            Centers of the marks, px.
        steps : ndarray, shape (n, 2, 2)
            Derivatives of the image points by the coordinates of the pattern, one column each, px.
        places : ndarray, shape (k, 2)
            Coordinates relative to a mark.
        drawn : ndarray, shape (n, k) or (k,)
            Darkness of the drawn pattern at these places.
        """
        darkness = -self.levels(centers[:, None] + places @ steps.transpose(0, 2, 1))
        drawn = np.broadcast_to(drawn, darkness.shape)
        correlations = []
        for half in (*(places > 0).T, *(places < 0).T):
            seen, wanted = (
                each[:, half] - each[:, half].mean(axis=1, keepdims=True)
                for each in (darkness, drawn)
            )
            length = np.sqrt((seen**2).sum(axis=1) * (wanted**2).sum(axis=1))
            product = (seen * wanted).sum(axis=1)
            correlations.append(product / np.maximum(length, np.finfo(float).tiny))
        return np.asarray(np.min(correlations, axis=0))
