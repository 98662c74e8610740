"""Stacks from arrays and iterables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._common import home_path, reject_masks
from microlib.io._pictures import read_picture
from microlib.io._stack import LazyFrames, Stack, check_axis_of_frames, open_stack


def open_array(frames: Any) -> Stack:
    """Return the frames of an array, or of an object that loads its values when it is indexed."""
    reject_masks("frames", frames)
    if hasattr(frames, "dims") and hasattr(frames, "coords"):  # xarray's, in any order
        raise ValueError(
            "frames must be an array, got a labeled one: pass its values with the axes z, y, x, "
            "and its positions and pixel size"
        )
    shape = tuple(frames.shape)
    if not (len(shape) == 3 or (len(shape) == 4 and shape[-1] in (3, 4))):
        need = "frames must have shape (any, any, any), or (any, any, any, 3) in color"
        raise ValueError(f"{need}, got {shape}")
    check_axis_of_frames(shape)
    return open_stack(lambda: (np.asarray(frames[k]) for k in range(shape[0])), count=shape[0])


def open_items(items: Iterable[Any]) -> Stack:
    """Return the images of a sequence or an iterator, or of the files that it names."""
    count = len(items) if isinstance(items, Sequence) else None

    def images() -> Iterator[NDArray]:
        for k, item in enumerate(items):
            if isinstance(item, (str, PathLike)):
                yield read_picture(home_path(item))
            else:
                reject_masks(f"frames[{k}]", item)
                # A camera may hand out the same buffer again and again.
                yield np.array(item) if count is None else np.asarray(item)

    if not isinstance(items, Iterator):
        return open_stack(images, count=count)
    return _open_iterator(images())


def _open_iterator(images: Iterator[NDArray]) -> Stack:
    """Return a stack that can be read once, which begins with the first image again."""
    stack = open_stack(lambda: images)
    unread = [chain([stack.first], images)]

    def read() -> Iterator[NDArray]:
        if not unread:
            raise ValueError("frames are an iterator, which can be read only once")
        return unread.pop()

    return replace(stack, frames=LazyFrames(read))
