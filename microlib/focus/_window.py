"""A part of an image that knows where it lies, so that it can be computed like the whole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Window"]

#: Where a part of an image may begin and end, px: it is also looked at in every second, fourth and
#: eighth pixel, and OpenCV takes eight of every fourth pixel together.
_GRID = 32


@dataclass(frozen=True)
class Window:
    """A rectangle of an image.

    Attributes
    ----------
    top, left, bottom, right : int
        First row and column, and those after the last, px.
    shape : tuple of int
        Rows and columns of the image.
    """

    top: int
    left: int
    bottom: int
    right: int
    shape: tuple[int, int]

    @classmethod
    def whole(cls, shape: tuple[int, ...]) -> Window:
        """Return an image as a part of itself."""
        return cls(0, 0, shape[0], shape[1], (shape[0], shape[1]))

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the part."""
        return self.bottom - self.top, self.right - self.left

    def grown(self, margin: int, within: Window | None = None) -> Window:
        """Return the window with at least a margin around it, as far as there are pixels.

        Examples
        --------
        >>> Window(100, 0, 200, 100, (500, 130)).grown(30)
        Window(top=64, left=0, bottom=256, right=130, shape=(500, 130))
        """
        outer = within or Window.whole(self.shape)
        return Window(
            max((self.top - margin) // _GRID * _GRID, outer.top),
            max((self.left - margin) // _GRID * _GRID, outer.left),
            min(-(-(self.bottom + margin) // _GRID) * _GRID, outer.bottom),
            min(-(-(self.right + margin) // _GRID) * _GRID, outer.right),
            self.shape,
        )

    def inside(self, outer: Window, step: int = 1) -> tuple[slice, slice]:
        """Return where the window lies in an array of every `step`-th pixel of another."""
        rows = (self.top - outer.top) // step, -(-(self.bottom - outer.top) // step)
        cols = (self.left - outer.left) // step, -(-(self.right - outer.left) // step)
        return slice(*rows), slice(*cols)

    def border(self, step: int = 1) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return how far every `step`-th row and column is from the image's border, in such steps.

        Examples
        --------
        >>> Window(2, 0, 5, 2, (6, 2)).border()[0].tolist()
        [2, 2, 1]
        """
        found = []
        for first, last, count in zip(
            (self.top, self.left), (self.bottom, self.right), self.shape, strict=True
        ):
            at = np.arange(first // step, -(-last // step))
            found.append(np.minimum(at, -(-count // step) - 1 - at))
        return found[0], found[1]
