"""The stack of frames: the one record from a file or an array to the result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image, Result

#: The axis, channel, time and series that were asked for; a reader removes those it applied.
Choice = dict[str, Any]


@dataclass(frozen=True, eq=False, repr=False)
class Stack(Result, Iterable[Image]):
    """Frames in their order, with their metadata; iteration yields the frames.

    Attributes
    ----------
    frames : iterable of ndarray, shape (rows, cols) or (rows, cols, 3)
        The frames: a list, or an object that reads them one at a time whenever it is iterated.
    first : ndarray
        The first frame, which is decoded when the stack is opened.
    name : callable
        Returns the name of a frame in error messages from its number.
    time : callable
        Returns the time of a frame since the first one, s, from its number, as soon as the frame
        was read; None if it is not known.
    count : int or None
        Number of frames; None if it is known only after they were read.
    axis : str
        Letter of the axis of frames in a file's metadata, such as Z or T; empty if there is none,
        or if its `axis` was given to `read_frames`.
    positions : ndarray, shape (count,), or None
        Position of each frame along the optical axis, µm.
    pixel_size : float or None
        Side of a pixel in the object plane, µm/px. None if it is not known, and for frames of one
        file each.
    files : tuple of Path
        The files that are read, in order.
    """

    frames: Iterable[Image]
    first: Image
    name: Callable[[int], str] = field(default_factory=lambda: "frames[{}]".format)
    time: Callable[[int], float | None] = field(default_factory=lambda: lambda number: None)
    count: int | None = None
    axis: str = ""
    positions: Array | None = None
    pixel_size: float | None = None
    files: tuple[Path, ...] = ()

    def __iter__(self) -> Iterator[Image]:
        return iter(self.frames)

    def __repr__(self) -> str:
        count = "unknown number of" if self.count is None else self.count
        size = f"{self.shape[0]}×{self.shape[1]} px, {'color' if self.color else 'grey'}"
        return f"Stack({count} frames of {size}, {self.dtype})"

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frames."""
        rows, columns = self.first.shape[:2]
        return rows, columns

    @property
    def dtype(self) -> np.dtype:
        """Type of the grey levels."""
        return self.first.dtype

    @property
    def color(self) -> bool:
        """Whether the frames are in color."""
        return self.first.ndim == 3


@dataclass(frozen=True)
class LazyFrames(Iterable[NDArray]):
    """Frames that `read` yields one at a time, from the first one, whenever they are iterated."""

    read: Callable[[], Iterator[NDArray]]

    def __iter__(self) -> Iterator[NDArray]:
        return self.read()


def open_stack(read: Callable[[], Iterator[NDArray]], **known: Any) -> Stack:
    """Return a stack that is read when it is needed, from a function that yields its frames.

    `known` are the attributes of the stack. The first frame is read at once.
    """
    first = next(read(), None)
    if first is None:
        raise ValueError("frames must hold at least one image, got none")
    return Stack(LazyFrames(read), first, **known)


def select_frames(
    axes: str, shape: Sequence[int], choice: Choice
) -> tuple[list[tuple[int, ...]], str]:
    """Return the index of each frame along the axes before rows and columns.

    Parameters
    ----------
    axes : str
        A letter for each of these axes: Z, T, C or others.
    shape : sequence of int
        Their lengths.
    choice : dict
        Axis, channel and time that were asked for, which are removed from it. One axis longer than
        1 may be left, and counts the frames. If the axis is given, it must be that one.

    Returns
    -------
    list of tuple of int
        The indices, in order.
    str
        Letter of the axis of frames, empty if the choice names it or every axis has the length 1.
    """
    ranges: list[Sequence[int]] = []
    left, named = "", choice.pop("axis", None)
    for axis, length in zip(axes, shape, strict=True):
        number = choice.pop({"C": "channel", "T": "time"}.get(axis, ""), None)
        if number is None:
            ranges.append(range(length))
            left += axis if length > 1 else ""
        elif number < length:
            ranges.append([number])
        else:
            raise ValueError(f"it has {length} along axis {axis}, got number {number} (from 0)")
    if (left not in ("", named)) if named else (len(left) > 1 or left == "C"):
        several = [f"{axis}={n}" for axis, n in zip(axes, shape, strict=True) if n > 1]
        if named and len(several) == 1:
            raise ValueError(
                f"it has the axis {several[0]} and no axis {named}: leave out axis (--axis)"
            )
        lengths = ", ".join(several)
        raise ValueError(
            f"it has the axes {lengths} besides rows and columns, a stack has one: choose a "
            'channel or a time, or axis="C" (--axis C) if the frames come along C'
        )
    return list(product(*ranges)), "" if named else left


def check_axis_of_frames(shape: Sequence[int]) -> None:
    """Raise for frames so narrow that the last axis is more likely that of the frames."""
    if 0 < 4 * shape[2] < min(shape[:2]):
        raise ValueError(
            f"frames must come along the first axis, got shape {tuple(shape)}: numpy.moveaxis "
            "changes the order of axes; a list may have frames so narrow"
        )


@contextmanager
def reading(what: object) -> Iterator[None]:
    """Raise a ValueError for any exception of a decoder, which damaged bytes can cause."""
    try:
        yield
    except Exception as error:
        raise ValueError(f"{what}: {error}") from error
