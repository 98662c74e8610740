"""Where the frames of a stack lie beside each other, and how bright each is."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image

__all__ = ["Frame", "Geometry", "reduced"]


@dataclass(frozen=True)
class Frame:
    """How a frame differs from the reference frame.

    A point x of the reference, as a complex number in px from the center of the image, lies at
    ``turn * x + shift`` of this frame, whose grey level there is exp(``log_gain`` · basis) times
    the reference's, plus ``offset``.

    Attributes
    ----------
    turn, shift : complex
        Scale and rotation; displacement, px.
    log_gain : ndarray, shape (6,)
        Coefficients of `basis`, of coordinates that are 1 at half the longer side.
    offset : float
        Grey levels.
    """

    turn: complex
    shift: complex
    log_gain: Array
    offset: float

    @classmethod
    def same(cls) -> Frame:
        """Return a frame that is as the reference."""
        return cls(1 + 0j, 0j, np.zeros(6), 0.0)

    def moved(self, motion: Array) -> Frame:
        """Return the frame after a small motion (growth, rotation in radians, shift in px)."""
        growth, rotation, dx, dy = (float(value) for value in motion)
        turn = self.turn * np.exp(complex(growth, rotation))
        return Frame(turn, self.shift + self.turn * complex(dx, dy), self.log_gain, self.offset)

    def brighter(self, log_gain: Array, offset: float) -> Frame:
        """Return the frame with another gain on top of its own, and another offset."""
        gain = np.exp(self.log_gain[0])
        total = self.offset + gain * offset
        return Frame(self.turn, self.shift, self.log_gain + log_gain, float(total))


@dataclass(frozen=True)
class Geometry:
    """The pixels of frames that are reduced by a whole factor.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns of the full frames.
    factor : int
        Side of the block of pixels that became one.
    """

    shape: tuple[int, int]
    factor: int

    @property
    def small(self) -> tuple[int, int]:
        """Rows and columns of the reduced frames."""
        return self.shape[0] // self.factor, self.shape[1] // self.factor

    def axes(self) -> tuple[NDArray, NDArray]:
        """Return x of the columns and y of the rows, full px from the center of the full frame."""
        y, x = (
            np.float32(self.factor) * np.arange(n, dtype=np.float32)
            + np.float32((self.factor - full) / 2)
            for n, full in zip(self.small, self.shape, strict=True)
        )
        return x, y

    def coordinates(self) -> tuple[NDArray, NDArray]:
        """Return x and y of every pixel, as `axes`."""
        grid = np.meshgrid(*self.axes())
        return grid[0], grid[1]

    def gain(self, frame: Frame) -> NDArray:
        """Return the gain of a frame for each of the reference's pixels."""
        x, y = (axis / np.float32(max(self.shape) / 2) for axis in self.axes())
        one, dx, dy, xx, xy, yy = frame.log_gain.astype(np.float32)
        y = y[:, None]
        log_gain = (xx * x + (dx + xy * y)) * x + ((yy * y + dy) * y + one)
        return np.asarray(np.exp(log_gain, out=log_gain))

    def matrix(self, frame: Frame) -> Array:
        """Return the map from reduced px of the reference to reduced px of the frame, 2×3."""
        # Both ends in px from the first pixel instead of from the center.
        y, x = ((full - self.factor) / (2 * self.factor) for full in self.shape)
        center = complex(x, y)
        shift = center - frame.turn * center + frame.shift / self.factor
        a = frame.turn
        return np.array([[a.real, -a.imag, shift.real], [a.imag, a.real, shift.imag]])

    def warped(self, image: Image, frame: Frame, *, flags: int) -> NDArray:
        """Return an image of the frame's pixels where the reference's lie, its edge continued."""
        rows, cols = image.shape[:2]
        return np.asarray(
            cv2.warpAffine(
                image,
                self.matrix(frame),
                (cols, rows),
                flags=flags | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_REPLICATE,
            )
        )

    def inside(self, frame: Frame) -> NDArray[np.bool_]:
        """Tell which of the reference's pixels the frame shows."""
        a = self.matrix(frame)
        rows, cols = self.small
        # A rounded 0.9999999 is inside.
        slack = 1e-3
        u, v = np.arange(cols), np.arange(rows)[:, None]
        x = a[0, 0] * u + a[0, 1] * v + a[0, 2]
        y = a[1, 0] * u + a[1, 1] * v + a[1, 2]
        return (x >= -slack) & (y >= -slack) & (x <= cols - 1 + slack) & (y <= rows - 1 + slack)


def reduced(image: NDArray, factor: int) -> NDArray:
    """Return the means of square blocks of pixels; what does not fill a block is left out.

    Examples
    --------
    >>> reduced(np.arange(10, dtype=np.float32).reshape(2, 5), 2)
    array([[3., 5.]], dtype=float32)
    """
    grey = image.astype(np.float32, copy=False)
    if factor == 1:
        return grey
    rows, cols = (n // factor * factor for n in image.shape)
    size = (cols // factor, rows // factor)
    return np.asarray(cv2.resize(grey[:rows, :cols], size, interpolation=cv2.INTER_AREA))
