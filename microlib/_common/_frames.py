"""What a focal stack may come as."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike

import numpy as np
from numpy.typing import NDArray

__all__ = ["Frames", "is_in_memory"]

#: What a stack may come as: an array, one multi-page TIFF, or an iterable of images or image files.
Frames = NDArray | str | PathLike[str] | Iterable[NDArray | str | PathLike[str]]


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
    >>> is_in_memory(np.zeros((3, 4, 5), np.uint8)), is_in_memory(np.zeros((3, 4, 5)))
    (True, False)
    """
    if not isinstance(frames, np.ndarray):
        return False
    return frames.dtype in (np.uint8, np.uint16, np.float32) and frames.flags.c_contiguous
