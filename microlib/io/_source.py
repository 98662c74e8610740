"""What every kind of input becomes before its frames are read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from numpy.typing import NDArray

from microlib._common import Array

#: Raw frames, each with its name in error messages.
NamedFrames = Iterator[tuple[str, NDArray]]

#: The channel, time and series that were asked for; a reader removes the ones it applied.
Choice = dict[str, int]


@dataclass(frozen=True)
class Source:
    """A stack that can be read, and its metadata.

    Attributes
    ----------
    read : callable
        Returns an iterator over the raw frames, grey or RGB, from the first one.
    count : int or None
        Number of frames, if known.
    axis : str
        Letter of the axis of frames in the metadata, such as Z or T; empty if there is none.
    pixel_size : float or None
        Side of a pixel, µm/px.
    positions : ndarray, shape (count,), or None
        Positions of the frames along the optical axis, µm.
    corner : (float, float)
        x and y of the center of the first pixel, px.
    files : tuple of Path
        The files that are read, in order.
    """

    read: Callable[[], NamedFrames]
    count: int | None = None
    axis: str = ""
    pixel_size: float | None = None
    positions: Array | None = None
    corner: tuple[float, float] = (0.0, 0.0)
    files: tuple[Path, ...] = ()


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
        The channel and the time to read; the axis that is left counts the frames.

    Returns
    -------
    list of tuple of int
        The indices, in order.
    str
        Letter of the axis of frames, empty if every axis has the length 1.
    """
    ranges: list[Sequence[int]] = []
    left = ""
    for axis, length in zip(axes, shape, strict=True):
        number = choice.pop({"C": "channel", "T": "time"}.get(axis, ""), None)
        if number is None:
            ranges.append(range(length))
            left += axis if length > 1 else ""
        elif number < length:
            ranges.append([number])
        else:
            raise ValueError(f"it has {length} along axis {axis}, got number {number} (from 0)")
    if len(left) > 1 or left == "C":
        lengths = ", ".join(f"{axis}={n}" for axis, n in zip(axes, shape, strict=True))
        raise ValueError(
            f"it has the axes {lengths} besides rows and columns, a stack has one and no channels "
            "C: choose a channel or a time, or pass an array of shape (frames, rows, cols)"
        )
    return list(product(*ranges)), left


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
