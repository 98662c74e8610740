"""What a focal stack may come as."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Frames", "is_in_memory"]


class LazyArray(Protocol):
    """An array whose values are loaded as it is indexed, such as one of zarr or dask."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    def __getitem__(self, key: int, /) -> Any: ...


#: What a stack may come as: an array, a file, a folder or pattern of files, or an iterable of
#: images or image files.
Frames = NDArray | LazyArray | str | PathLike[str] | Iterable[NDArray | str | PathLike[str]]


def is_in_memory(frames: Frames) -> bool:
    """Return whether reading the frames gives views of an array, so that holding all is free.

    Parameters
    ----------
    frames : array_like of shape (n, rows, cols), path, or iterable
        As for `microlib.io.read_frames`.

    Returns
    -------
    bool

    Examples
    --------
    >>> import numpy as np
    >>> from microlib._common._frames import is_in_memory
    >>> is_in_memory(np.zeros((3, 4, 5), np.uint8)), is_in_memory(np.zeros((3, 4, 5)))
    (True, False)
    """
    if not isinstance(frames, np.ndarray):
        return False
    return frames.dtype in (np.uint8, np.uint16, np.float32) and frames.flags.c_contiguous
