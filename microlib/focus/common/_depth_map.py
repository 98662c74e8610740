"""The frames from which both methods compute the depth of every pixel, and that depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

#: Distance from an end of the stack, frame spacings, within which lie the depths that the measures
#: give to a surface outside of it.
END_REACH = 2.0


class Frame(Protocol):
    """A frame in memory, or one of which rows are computed when they are indexed."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    def __getitem__(self, rows: slice, /) -> NDArray: ...


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depth of every pixel of a stack, before it is brought into the form of a result.

    Attributes
    ----------
    depth : ndarray of float32, shape (rows, cols)
        Depth, µm; NaN where unknown.
    uncertainty : ndarray of float32, shape (rows, cols)
        Standard deviation of the depth, µm.
    frame : ndarray of int, shape (rows, cols)
        Number of the frame that shows the pixel sharpest, also where there is no depth.
    at_end : ndarray of bool, shape (rows, cols)
        Whether the true focus may lie outside the stack.
    spacing : float
        Distance of the frames, or of the averaged frames if frames were averaged, µm.
    """

    depth: NDArray[np.float32]
    uncertainty: NDArray[np.float32]
    frame: NDArray[np.integer]
    at_end: NDArray[np.bool_]
    spacing: float
