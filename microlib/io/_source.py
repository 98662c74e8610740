"""A stack that is ready to be read, and which of its axes counts the frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from numpy.typing import NDArray

from microlib._common import Array

#: Raw frames, each with the name that a message gives it.
Named = Iterator[tuple[str, NDArray]]

#: Numbers of the channel, the time and the series that were asked for, by those names.
Choice = Mapping[str, int]


@dataclass(frozen=True)
class Source:
    """A stack that is ready to be read.

    Attributes
    ----------
    read : callable
        Begins to read: yields each raw frame, grey or RGB, with its name for messages.
    count : int or None
        Number of frames, if known.
    axis : str
        Letter of the axis of frames in the metadata, such as Z or T; empty if there is none.
    pixel_size : float or None
        Side of a pixel, µm/px, from metadata.
    positions : ndarray, shape (count,), or None
        Positions of the frames along the optical axis, µm, from metadata.
    origin : (float, float)
        x and y of the middle of the first pixel, µm, where the pixel size is known.
    files : tuple of Path
        The files that are read, in order.
    """

    read: Callable[[], Named]
    count: int | None = None
    axis: str = ""
    pixel_size: float | None = None
    positions: Array | None = None
    origin: tuple[float, float] = (0.0, 0.0)
    files: tuple[Path, ...] = ()


def frame_indices(
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
        One number of an axis; what is left is the axis of frames.

    Returns
    -------
    list of tuple of int
        The indices, in order.
    str
        Letter of the axis of frames, empty if every axis has the length 1.
    """
    lengths = list(zip(axes, shape, strict=True))
    chosen = {letter: choice[n] for n, letter in (("channel", "C"), ("time", "T")) if n in choice}
    for letter, number in chosen.items():
        if number >= dict(lengths).get(letter, 0):
            raise ValueError(
                f"it has {dict(lengths).get(letter, 'no')} {letter}, not number {number}"
            )
    left = [axis for axis, n in lengths if n > 1 and axis not in chosen]
    if len(left) > 1 or "C" in left:
        names = ", ".join(f"{axis}={n}" for axis, n in lengths)
        raise ValueError(
            f"it has the axes {names} besides rows and columns, a stack has one and no channels C: "
            "choose a channel or a time, or pass an array of shape (frames, rows, cols)"
        )
    ranges = [[chosen[axis]] if axis in chosen else range(n) for axis, n in lengths]
    return list(product(*ranges)), "".join(left)


@contextmanager
def reading(what: object) -> Iterator[None]:
    """Raise a ValueError for whatever the bytes of damaged headers and codecs lead to."""
    try:
        yield
    except Exception as error:
        raise ValueError(f"{what}: {error}") from error
