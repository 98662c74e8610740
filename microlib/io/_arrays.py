"""Stacks from arrays, xarray.DataArray, zarr and iterables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._common import home_path, reject_masks
from microlib.io._metadata import label_scale
from microlib.io._pictures import read_picture
from microlib.io._stack import LazyFrames, Stack, check_axis_of_frames, open_stack, reading

#: Letters of the axes of frames, by the names of labeled arrays' dimensions.
_LETTERS = {"c": "C", "channel": "C", "t": "T", "time": "T", "z": "Z"}


def open_array(frames: Any, files: tuple[Path, ...] = ()) -> Stack:
    """Return the frames of an array, or of an object that loads its values when it is indexed."""
    reject_masks("frames", frames)
    shape = tuple(frames.shape)
    if not (len(shape) == 3 or (len(shape) == 4 and shape[-1] in (3, 4))):
        need = "frames must have shape (any, any, any), or (any, any, any, 3) in color"
        raise ValueError(f"{need}, got {shape}")
    check_axis_of_frames(shape)
    return open_stack(
        lambda: (np.asarray(frames[k]) for k in range(shape[0])), count=shape[0], files=files
    )


def open_labeled(frames: Any) -> Stack:
    """Return an xarray.DataArray's frames; three dimensions may be in any order if two are x, y."""
    names = {str(dim).lower(): dim for dim in frames.dims}
    if len(names) == 3 and {"y", "x"} < names.keys():
        frames = frames.transpose(..., names["y"], names["x"])
    stack = open_array(frames)
    axis = _LETTERS.get(str(frames.dims[0]).lower(), "")
    return replace(stack, axis=axis, **label_scale(frames))


def open_zarr(path: Path) -> Stack:
    """Return the frames of a zarr array."""
    import zarr  # optional, and slow to import

    with reading(f"frames cannot be read from {path}"):
        opened = zarr.open(str(path), mode="r")
        if not isinstance(opened, zarr.Array):
            names = ", ".join(sorted(opened.array_keys()))
            raise ValueError(
                f"it must be an array, got a group of arrays {names}: give one of them"
            )
    return open_array(opened, (path,))


def open_items(items: Iterable[Any]) -> Stack:
    """Return the images of a sequence or an iterator, or of the files that it names."""

    def images() -> Iterator[NDArray]:
        for k, item in enumerate(items):
            if isinstance(item, (str, PathLike)):
                yield read_picture(home_path(item))
            else:
                reject_masks(f"frames[{k}]", item)
                # A camera may hand out the same buffer again and again.
                yield np.array(item)

    if not isinstance(items, Iterator):
        return open_stack(images, count=len(items) if isinstance(items, Sequence) else None)
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
