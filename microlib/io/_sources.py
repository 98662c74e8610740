"""Open a stack: a table of readers by the suffix of a file, and one for each kind of array."""

from __future__ import annotations

import glob
from collections.abc import Callable, Iterable, Iterator, Sequence
from os import PathLike
from pathlib import Path
from string import digits
from typing import Any

import numpy as np

from microlib._common import Frames, home_path, reject_masks
from microlib.io._metadata import label_scale, zarr_scale
from microlib.io._names import in_order
from microlib.io._pictures import (
    FILMS,
    PICTURES,
    check_exists,
    image_files,
    open_film,
    open_gif,
    open_pictures,
    read_picture,
)
from microlib.io._source import (
    Choice,
    NamedFrames,
    Source,
    check_axis_of_frames,
    reading,
    select_frames,
)
from microlib.io._tiff import TIFF, open_tiff

_READERS: dict[str, Callable[[Path], Source]] = {
    **dict.fromkeys(PICTURES, lambda path: open_pictures([path])),
    **dict.fromkeys(FILMS, open_film),
    ".gif": open_gif,
    ".npy": lambda path: open_array(np.load(path, mmap_mode="r"), (path,)),
}
#: Letters of the axes that can be chosen by number, by the names of labeled arrays' dimensions.
_LETTERS = {"c": "C", "channel": "C", "t": "T", "time": "T", "z": "Z"}


def open_source(frames: Frames, choice: Choice) -> Source:
    """Return what `read_frames` reads, before any frame is decoded."""
    if isinstance(frames, (str, PathLike)):
        return _open_path(home_path(frames), choice)
    if hasattr(frames, "dims") and hasattr(frames, "coords"):  # xarray's
        return open_labeled(frames, choice)
    if hasattr(frames, "shape") and hasattr(frames, "__getitem__"):
        return open_array(frames)
    if isinstance(frames, Sequence) and all(isinstance(f, (str, PathLike)) for f in frames):
        return open_pictures([home_path(file) for file in frames])
    if isinstance(frames, Iterable):
        return open_items(frames)
    need = "frames must be an array, a file, a folder or an iterable of images"
    raise ValueError(f"{need}, got {type(frames).__name__}")


def _open_path(path: Path, choice: Choice) -> Source:
    zarr, suffix = _is_zarr(path), path.suffix.lower()
    if not zarr and (path.is_dir() or (not path.exists() and glob.has_magic(str(path)))):
        files = in_order(image_files(path))
        return open_pictures(files) if len(files) > 1 else _open_path(files[0], choice)
    check_exists(path)
    with reading(f"frames cannot be read from {path}"):
        if zarr:
            return open_zarr(path, choice)
        if suffix in _READERS and suffix not in TIFF:
            return _READERS[suffix](path)
        return open_tiff(path, choice)


def _is_zarr(path: Path) -> bool:
    return any((path / name).exists() for name in ("zarr.json", ".zarray", ".zgroup"))


def open_array(frames: Any, files: tuple[Path, ...] = ()) -> Source:
    """Return the frames of an array, or of an object that loads its values when it is indexed."""
    reject_masks("frames", frames)
    shape = tuple(frames.shape)
    if not (len(shape) == 3 or (len(shape) == 4 and shape[-1] in (3, 4))):
        need = "frames must have shape (any, any, any), or (any, any, any, 3) in color"
        raise ValueError(f"{need}, got {shape}")
    check_axis_of_frames(shape)
    return Source(_at(frames, range(shape[0])), count=shape[0], files=files)


def _at(frames: Any, indices: Sequence[Any]) -> Callable[[], NamedFrames]:
    def read() -> NamedFrames:
        for k, index in enumerate(indices):
            yield f"frames[{k}]", np.asarray(frames[index])

    return read


def open_labeled(frames: Any, choice: Choice) -> Source:
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
    return Source(
        _at(frames, indices), len(indices), axis.strip(digits), *label_scale(frames, dims)
    )


def open_zarr(path: Path, choice: Choice) -> Source:
    """Return the frames of a zarr array, or of an image of OME-Zarr 0.4 or 0.5 at full size."""
    import zarr  # optional, and slow to import

    found: Any = zarr.open(str(path), mode="r")
    if isinstance(found, zarr.Array):
        return open_array(found, (path,))
    series = sorted((name for name, _ in found.groups() if name.isdigit()), key=int)
    if series:  # a group for each image
        if len(series) > 1 and "series" not in choice:
            raise ValueError(f"it holds {len(series)} series of images: choose one")
        found = found[series[choice.pop("series", 0)]]
    about: Any = found.attrs.get("ome", found.attrs)
    image = about.get("multiscales", [{}])[0]
    axes = [axis["name"] if isinstance(axis, dict) else "" for axis in image.get("axes", [])]
    if [name.upper() for name in axes[-2:]] != ["Y", "X"]:
        raise ValueError(
            "it must hold an array, or OME-Zarr 0.4 or 0.5 whose last axes are y and x"
        )
    frames = found[image["datasets"][0]["path"]]
    letters = "".join(axes).upper()
    indices, axis = select_frames(letters[:-2], frames.shape[:-2], choice)
    size, positions = zarr_scale(image, axis, len(indices), path.name)
    return Source(_at(frames, indices), len(indices), axis, size, positions, files=(path,))


def open_items(items: Iterable[Any]) -> Source:
    """Return the images of a sequence or an iterator, or of the files that it names."""

    begun = False

    def read() -> NamedFrames:
        nonlocal begun
        if begun and isinstance(items, Iterator):
            raise ValueError("frames are an iterator, which can be read only once")
        begun = True
        for k, item in enumerate(items):
            if isinstance(item, (str, PathLike)):
                yield f"frames[{k}], {item},", read_picture(home_path(item))
            else:
                reject_masks(f"frames[{k}]", item)
                # A camera may hand out the same buffer again and again.
                yield f"frames[{k}]", np.array(item)

    return Source(read, len(items) if isinstance(items, Sequence) else None)
