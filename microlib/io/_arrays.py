"""Stacks from arrays, xarray.DataArray, zarr and iterables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from os import PathLike
from pathlib import Path
from string import digits
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._common import home_path, reject_masks
from microlib.io._metadata import label_scale, zarr_scale
from microlib.io._pictures import read_picture
from microlib.io._stack import (
    Choice,
    LazyFrames,
    Stack,
    check_axis_of_frames,
    open_stack,
    select_frames,
)

#: Letters of the axes that can be chosen by number, by the names of labeled arrays' dimensions.
_LETTERS = {"c": "C", "channel": "C", "t": "T", "time": "T", "z": "Z"}


def open_array(frames: Any, files: tuple[Path, ...] = ()) -> Stack:
    """Return the frames of an array, or of an object that loads its values when it is indexed."""
    reject_masks("frames", frames)
    shape = tuple(frames.shape)
    if not (len(shape) == 3 or (len(shape) == 4 and shape[-1] in (3, 4))):
        need = "frames must have shape (any, any, any), or (any, any, any, 3) in color"
        raise ValueError(f"{need}, got {shape}")
    check_axis_of_frames(shape)
    return open_stack(_at(frames, range(shape[0])), count=shape[0], files=files)


def _at(frames: Any, indices: Sequence[Any]) -> Callable[[], Iterator[NDArray]]:
    return lambda: (np.asarray(frames[index]) for index in indices)


def open_labeled(frames: Any, choice: Choice) -> Stack:
    """Return an xarray.DataArray's frames; dimensions may be in any order if two are x and y."""
    names = [str(dim).lower() for dim in frames.dims]
    if len(names) < 3:
        raise ValueError(f"frames must have three dimensions or more, got {', '.join(names)}")
    color = len(names) > 3 and frames.shape[-1] in (3, 4) and names[-1] not in (*"xyzt", "time")
    if {"y", "x"} <= set(names) and not color and names[-2:] != ["y", "x"]:
        frames = frames.transpose(..., *(frames.dims[names.index(name)] for name in "yx"))
    *leading, y, x = frames.dims[: len(names) - color]
    # An axis of another name has its number as its letter.
    letters = "".join(_LETTERS.get(str(dim).lower(), str(k)) for k, dim in enumerate(leading))
    indices, axis = select_frames(letters, frames.shape[: len(leading)], choice)
    dims = leading[letters.index(axis) if axis else 0], y, x
    scale = label_scale(frames, dims)
    return open_stack(_at(frames, indices), count=len(indices), axis=axis.strip(digits), **scale)


def open_zarr(path: Path, choice: Choice) -> Stack:
    """Return the frames of a zarr array, or of an image of OME-Zarr 0.4 or 0.5 at full size."""
    import zarr  # optional, and slow to import

    opened: Any = zarr.open(str(path), mode="r")
    if isinstance(opened, zarr.Array):
        return open_array(opened, (path,))
    series = sorted((name for name, _ in opened.groups() if name.isdigit()), key=int)
    if series:  # a group for each image
        if len(series) > 1 and "series" not in choice:
            raise ValueError(f"it holds {len(series)} series of images: choose one")
        opened = opened[series[choice.pop("series", 0)]]
    about: Any = opened.attrs.get("ome", opened.attrs)
    image = about.get("multiscales", [{}])[0]
    axes = [axis["name"] if isinstance(axis, dict) else "" for axis in image.get("axes", [])]
    if [name.upper() for name in axes[-2:]] != ["Y", "X"]:
        raise ValueError(
            "it must hold an array, or OME-Zarr 0.4 or 0.5 whose last axes are y and x"
        )
    frames = opened[image["datasets"][0]["path"]]
    letters = "".join(axes).upper()
    indices, axis = select_frames(letters[:-2], frames.shape[:-2], choice)
    scale = zarr_scale(image, axis, len(indices), path.name)
    return open_stack(_at(frames, indices), count=len(indices), axis=axis, files=(path,), **scale)


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
