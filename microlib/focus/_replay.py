"""Read the frames of a stack more than once, whatever they come from, and hold none."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from os import PathLike
from typing import BinaryIO

import numpy as np

from microlib._common import Frames, Image
from microlib.io import read_frames


class Replay:
    """The frames of a stack, checked, as often as they are asked for.

    What comes from a camera comes once: the frames of anything but an array, a file or a sequence
    are kept in a temporary file while they are read for the first time, which must be to the end.

    Parameters
    ----------
    frames : array_like of shape (n, rows, cols), path, or iterable
        As for `microlib.io.read_frames`.
    count : int
        How many frames there should be.
    """

    def __init__(self, frames: Frames, count: int) -> None:
        self._frames = frames
        self._count = count
        self._kept: BinaryIO | None = None
        self._shape: tuple[int, ...] | None = None
        self._dtype = np.dtype(np.uint8)

    def __enter__(self) -> Replay:
        if not isinstance(self._frames, (np.ndarray, str, PathLike, Sequence)):
            self._kept = tempfile.TemporaryFile()
        return self

    def __exit__(self, *_: object) -> None:
        if self._kept is not None:
            self._kept.close()

    def __iter__(self) -> Iterator[Image]:
        if self._kept is None or self._shape is None:
            return self._read()
        return self._read_again(self._kept, self._shape)

    def _read(self) -> Iterator[Image]:
        number = 0
        for frame in read_frames(self._frames):
            number += 1
            if number > self._count:
                break
            if self._kept is not None:
                frame.tofile(self._kept)
            shape, self._dtype = frame.shape, frame.dtype
            yield frame
            del frame  # before the next one is made
        if number == 0:
            raise ValueError("frames must hold at least three frames, got none")
        if number != self._count:
            got = str(number) if number < self._count else f"more than {self._count}"
            raise ValueError(f"frames and positions must be as many, got {got} and {self._count}")
        self._shape = shape

    def _read_again(self, file: BinaryIO, shape: tuple[int, ...]) -> Iterator[Image]:
        file.seek(0)
        for _ in range(self._count):
            yield np.fromfile(file, self._dtype, int(np.prod(shape))).reshape(shape)
