"""Read the frames of a stack more than once, or parts of them, whatever they come from."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from os import PathLike
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from microlib._common import Frames, Image
from microlib.focus._window import Window
from microlib.io import read_frames


class Replay:
    """The frames of a stack, checked, as often as they are asked for.

    What comes from a camera comes once: the frames of anything but an array, a file or a sequence
    are kept in a temporary file while they are read for the first time, which must be to the end.
    Parts of frames come from the array or from that file, if they are asked for.

    Parameters
    ----------
    frames : array_like of shape (n, rows, cols), path, or iterable
        As for `microlib.io.read_frames`.
    count : int
        How many frames there should be.
    in_parts : bool
        Whether many parts will be asked for.
    """

    def __init__(self, frames: Frames, count: int, *, in_parts: bool = False) -> None:
        self._frames = frames
        self._count = count
        self._sliced = hasattr(frames, "shape") and hasattr(frames, "__getitem__")
        self._in_parts = in_parts
        self._kept: BinaryIO | None = None
        self._shape: tuple[int, ...] | None = None
        self._dtype = np.dtype(np.uint8)

    def __enter__(self) -> Replay:
        again = isinstance(self._frames, (np.ndarray, str, PathLike, Sequence))
        if not (self._sliced if self._in_parts else again):
            self._kept = tempfile.TemporaryFile()
        return self

    def __exit__(self, *_: object) -> None:
        if self._kept is not None:
            self._kept.close()

    def __iter__(self) -> Iterator[Image]:
        if self._kept is None or self._shape is None:
            return self._read()
        return self._read_again(self._kept, self._shape)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frames."""
        if self._shape is None and self._sliced:
            return self._frames.shape[1], self._frames.shape[2]  # type: ignore[union-attr]
        if self._shape is None and self._kept is not None:
            for _ in self:
                pass
        elif self._shape is None:
            self._shape = next(self._read()).shape
        return self._shape[0], self._shape[1]  # type: ignore[index]

    def parts(self, windows: Sequence[Window]) -> list[list[Image]]:
        """Return for each window what all frames show of it."""
        if self._sliced:
            return [list(self._checked(read_frames(_Cut(self._frames, w)))) for w in windows]
        found: list[list[Image]] = [[] for _ in windows]
        for frame in self._mapped():
            for window, part in zip(windows, found, strict=True):
                rows, cols = slice(window.top, window.bottom), slice(window.left, window.right)
                part.append(np.ascontiguousarray(frame[rows, cols]))
        return found

    def _mapped(self) -> Iterator[Image]:
        """Yield the frames, from the file as arrays that are read where they are looked at."""
        rows, cols = self.shape
        if self._kept is None:
            yield from self
            return
        for k in range(self._count):
            at = k * rows * cols * self._dtype.itemsize
            yield np.memmap(self._kept, self._dtype, "r", at, (rows, cols))

    def _read(self) -> Iterator[Image]:
        for frame in self._checked(read_frames(self._frames)):
            if self._kept is not None:
                frame.tofile(self._kept)
            shape, self._dtype = frame.shape, frame.dtype
            yield frame
            del frame  # before the next one is made
        self._shape = shape
        if self._kept is not None:
            self._kept.flush()

    def _checked(self, frames: Iterator[Image]) -> Iterator[Image]:
        """Yield frames that are as many as they should."""
        number = 0
        for frame in frames:
            number += 1
            if number > self._count:
                break
            yield frame
            del frame  # before the next one is made
        if number == 0:
            raise ValueError("frames must hold at least three frames, got none")
        if number != self._count:
            got = str(number) if number < self._count else f"more than {self._count}"
            raise ValueError(f"frames and positions must be as many, got {got} and {self._count}")

    def _read_again(self, file: BinaryIO, shape: tuple[int, ...]) -> Iterator[Image]:
        file.seek(0)
        for _ in range(self._count):
            yield np.fromfile(file, self._dtype, int(np.prod(shape))).reshape(shape)


class _Cut:
    """A window of all frames of an array, of which nothing else is loaded."""

    def __init__(self, frames: Any, window: Window) -> None:
        self._frames, self._window = frames, window
        self.shape = (frames.shape[0], *window.size, *frames.shape[3:])

    def __getitem__(self, key: int) -> NDArray:
        at = self._window
        return np.asarray(self._frames[key, at.top : at.bottom, at.left : at.right])
