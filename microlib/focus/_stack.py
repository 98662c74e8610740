"""A stack as it comes from the microscope: read, cut, registered; then its depth, in color."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, Frames, Image
from microlib.focus._registered import Registered
from microlib.focus._registration import register
from microlib.focus._selection import as_type, select
from microlib.io import read_frames

if TYPE_CHECKING:
    from microlib.focus._depth import FocusResult

__all__ = ["Progress", "Stack", "open_stack"]

#: What is told how many frames have been read, and of how many; an exception from it ends all.
Progress = Callable[[int, int], object]
#: Depth from frames and their positions, all other settings given.
Depth = Callable[[Frames, ArrayLike], "FocusResult"]

#: Axes of metadata that are no focus.
_NO_FOCUS = {"T": "times", "C": "channels"}
#: Least number of frames, and share of all, on either side of a pixel's best one that must show it.
_REACH, _REACH_SHARE = 3, 0.1


class _Reader(Protocol):
    """What `microlib.io.read_frames` returns."""

    count: int | None
    shape: tuple[int, int]
    dtype: np.dtype
    color: bool

    def __iter__(self) -> Iterator[Image]: ...

    def again(self, *, color: bool = False) -> Iterator[Image]: ...


@dataclass(frozen=True)
class Stack:
    """Frames that have been looked at, not yet read.

    Attributes
    ----------
    frames : array_like, path, or iterable
        What `microlib.io.read_frames` is to read.
    positions : array_like, shape (n,)
        Position of each frame, µm.
    color : bool
        Whether the frames have colors.
    """

    frames: Frames
    positions: ArrayLike
    color: bool
    _reader: _Reader
    _progress: Progress | None
    _untold: Frames

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frames."""
        return self._reader.shape

    @property
    def untold(self) -> Frames:
        """The frames, of which it is not told that they are read: arrays as they are."""
        return self._untold

    def check_count(self, positions: Array) -> None:
        """Refuse another number of positions than of frames, if that is known."""
        if self._reader.count not in (None, len(positions)):
            raise ValueError(
                "frames and positions must be as many, "
                f"got {self._reader.count} and {len(positions)}"
            )

    def focus(self, positions: Array, depth: Depth, *, registered: bool) -> FocusResult:
        """Return the depth of the frames, registered if asked for, and their sharpest colors."""
        if registered:
            return self._registered(positions, depth)
        found = depth(self._told(self._reader.again(), passes=2), positions)
        colors = self._told(self._reader.again(color=True), passes=2, done=1)
        return replace(found, all_in_focus=select(colors, found.index))

    def _registered(self, z: Array, depth: Depth) -> FocusResult:
        passes = 3 if self.color else 2
        source = self._told(self._reader.again(), passes)
        found = register(source, z, lambda stack, at: depth(stack, at).depth)
        images = found.images(self._told(self._reader.again(), passes, done=1))
        result = _cut(depth(images, z[found.kept]), found)
        fused = as_type(result.all_in_focus, self._reader.dtype)
        if self.color:
            colors = found.colors(self._told(self._reader.again(color=True), passes, done=2))
            fused = as_type(select(colors, result.index), self._reader.dtype)
        numbers = np.append(found.kept, -1)[result.index].astype(np.int32)
        return replace(
            result,
            all_in_focus=fused,
            index=numbers,
            poses=found.poses(len(z)),
            gain=found.gain(len(z)),
            offset=found.offset(len(z)),
        )

    def _told(self, reader: Iterable[Image], passes: int, done: int = 0) -> Iterator[Image]:
        """Yield the frames and say how many there have been."""
        return _counted(reader, self._progress, self._reader.count, passes, done)


def _counted(
    reader: Iterable[Image], progress: Progress | None, count: int | None, passes: int, done: int
) -> Iterator[Image]:
    for k, frame in enumerate(reader):
        yield frame
        if progress is not None and count is not None:
            progress(done * count + k + 1, passes * count)
        del frame


def open_stack(
    frames: Frames,
    positions: ArrayLike | None,
    *,
    region: tuple[int, int, int, int] | None,
    reduce: int,
    progress: Progress | None,
    again: bool,
) -> Stack:
    """Look at a stack: what it is, and that nothing is missing, before anything slow begins.

    Parameters
    ----------
    frames, positions, region, reduce, progress
        As for `depth_from_focus`.
    again : bool
        Whether it must be readable more than once. An iterator is held in memory then, as it is if
        its frames have colors.

    Raises
    ------
    ValueError
        If the frames are of different times or channels, there are none or no positions, or as
        `microlib.io.read_frames`.
    """
    if progress is not None and not callable(progress):
        raise ValueError(f"progress must be callable, got {progress!r}")
    reader = read_frames(frames, region=region, reduce=reduce)
    if reader.axis in _NO_FOCUS:
        raise ValueError(
            f"frames must differ in focus, got a file of {reader.count} {_NO_FOCUS[reader.axis]} "
            f"(axis {reader.axis}); if they do, pass the array, as tifffile.imread gives it"
        )
    if positions is None:
        positions = reader.positions
        if positions is None:
            raise ValueError("positions must be given, got None and frames that do not tell theirs")
    if reader.count == 0:
        raise ValueError("frames must hold at least three frames, got none")
    if again or reader.color:
        reader = reader.kept()
    untold = frames if region is None and reduce == 1 and reader.rereadable else reader
    plain = untold is frames and progress is None and not again
    given = frames if plain else _counted(reader, progress, reader.count, 1, 0)
    return Stack(given, positions, reader.color, reader, progress, untold)


def _cut(result: FocusResult, found: Registered) -> FocusResult:
    """Take the depth from pixels whose sharpest frames did not show them."""
    reach = max(_REACH, round(_REACH_SHARE * len(found.frames)))
    unseen = found.unseen(result.index, reach)
    arrays = {
        "depth": np.where(unseen, np.float32(np.nan), result.depth),
        "uncertainty": np.where(unseen, np.float32(np.nan), result.uncertainty),
        "confidence": np.where(unseen, np.float32(0), result.confidence),
        "index": np.where(unseen, np.int32(-1), result.index),
    }
    return replace(result, **arrays)
