"""Where the frames of a stack come from: arrays, files, folders, videos; opened and checked."""

from __future__ import annotations

import glob
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Frames, refuse_masks
from microlib.io._files import decode
from microlib.io._headers import picture_size
from microlib.io._tiff import is_tiff, tiff_pages, tiff_stack

__all__ = ["Source", "open_source"]

_PICTURES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm"})
_VIDEOS = frozenset({".avi", ".mp4", ".m4v", ".mov", ".mkv", ".mpg", ".mpeg", ".webm", ".wmv"})
#: Characters that make a pattern of a path.
_PATTERN = re.compile(r"[*?\[]")

#: Raw frames, each with the name that a message gives it.
Named = Iterator[tuple[str, NDArray]]


@dataclass(frozen=True)
class Source:
    """A stack that is ready to be read.

    Attributes
    ----------
    read : callable
        Begins to read: yields each raw frame, grey or RGB, with its name for messages.
    again : bool
        Whether it can be read more than once.
    count : int or None
        Number of frames, if known.
    axis : str
        Letter of the axis of frames in the metadata of a file, such as Z or T; empty if not said.
    pixel_size : float or None
        Side of a pixel, µm/px, if the file tells.
    positions : ndarray, shape (count,), or None
        Positions of the frames along the optical axis, µm, if the file tells.
    shape : tuple of int, or None
        Shape of a frame, if it is known without reading one.
    pixel : ndarray of shape (1, 1) or (1, 1, channels), or None
        A pixel of a frame whose shape is known: it tells the type.
    """

    read: Callable[[], Named]
    again: bool = True
    count: int | None = None
    axis: str = ""
    pixel_size: float | None = None
    positions: Array | None = None
    shape: tuple[int, ...] | None = None
    pixel: NDArray | None = None


def open_source(frames: Frames) -> Source:
    """Find out what the frames are, and refuse what is missing, before any of them is read."""
    if isinstance(frames, (str, PathLike)):
        return _path(Path(frames).expanduser())
    if hasattr(frames, "shape") and hasattr(frames, "__getitem__"):
        return _array(frames)
    if type(frames).__name__ == "ZarrTiffStore" and find_spec("zarr"):
        return _zarr(frames)
    if isinstance(frames, Sequence):
        if frames and all(isinstance(item, (str, PathLike)) for item in frames):
            return _pictures([Path(item).expanduser() for item in frames])
        return Source(partial(_items, frames), count=len(frames))
    if isinstance(frames, Iterable):
        return Source(partial(_items, frames), again=iter(frames) is not frames)
    raise ValueError(
        "frames must be an array, a file, a folder or an iterable of images, "
        f"got {type(frames).__name__}"
    )


def _path(path: Path) -> Source:
    if path.suffix.lower() == ".zarr" and path.exists():
        if not find_spec("zarr"):
            raise ValueError(f"frames must be readable, got {path}: pip install zarr to read it")
        return _zarr(str(path))
    if path.is_dir():
        found = [file for file in path.iterdir() if file.suffix.lower() in _PICTURES]
        return _pictures(_sorted(file for file in found if file.name[0] != "."), path)
    if not path.exists() and _PATTERN.search(str(path)):
        return _pictures(_sorted(Path(name) for name in glob.glob(str(path))), path)
    if path.suffix.lower() in _VIDEOS:
        return _video(path)
    if path.suffix.lower() in _PICTURES and not is_tiff(path) and path.is_file():
        return _pictures([path])
    stack = tiff_stack(path)
    return Source(
        partial(tiff_pages, path),
        count=stack.count,
        axis=stack.axis,
        pixel_size=stack.scale.pixel_size,
        positions=stack.scale.positions,
    )


def _array(frames: Any) -> Source:
    """Read an array, or what is like one but loads its values when it is indexed."""
    refuse_masks("frames", frames)
    shape = tuple(frames.shape)
    if not (len(shape) == 3 or (len(shape) == 4 and shape[-1] in (3, 4))):
        raise ValueError(
            f"frames must have shape (any, any, any), or (any, any, any, 3) in color, got {shape}"
        )

    def read() -> Named:
        for k in range(shape[0]):
            yield f"frames[{k}]", np.asarray(frames[k])

    if isinstance(frames, np.ndarray) or min(shape) == 0 or not hasattr(frames, "dtype"):
        return Source(read, count=shape[0])
    # A frame may be large, and is to be read when it is wanted.
    pixel = np.asarray(frames[0, :1, :1])
    return Source(read, count=shape[0], shape=shape[1:], pixel=pixel)


def _zarr(store: Any) -> Source:
    zarr = import_module("zarr")  # the reader's own, and slow to import
    opened = zarr.open(store, mode="r")
    if not hasattr(opened, "shape"):
        names = ", ".join(sorted(opened.keys())[:5])
        raise ValueError(f"frames must be one array, got a zarr group of {names}; pass one of them")
    return _array(opened)


def _items(items: Iterable[Any]) -> Named:
    for k, item in enumerate(items):
        if isinstance(item, (str, PathLike)):
            yield f"frames[{k}], {item},", _picture(Path(item).expanduser())
        else:
            refuse_masks(f"frames[{k}]", item)
            # A camera may hand out the same buffer again and again.
            yield f"frames[{k}]", np.array(item)


def _sorted(files: Iterable[Path]) -> list[Path]:
    """Sort files by their names, and numbers in them by their value."""

    def key(file: Path) -> list[tuple[int, int, str]]:
        parts = re.split(r"(\d+)", file.name)
        return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts]

    return sorted(files, key=key)


def _pictures(files: Sequence[Path], place: Path | None = None) -> Source:
    """Read one picture a frame; those that are missing or of another size are refused at once."""
    if not files:
        raise ValueError(f"frames must hold images, got none in {place}")
    first: tuple[int, int] | None = None
    for k, file in enumerate(files):
        if not file.is_file():
            raise ValueError(f"frames cannot be read from {file}: no such file")
        size = picture_size(file)
        first = first or size
        if size and size != first:
            raise ValueError(
                f"frames[{k}], {file}, must be of shape {first} like the first frame, "
                f"got shape {size}"
            )

    def read() -> Named:
        for k, file in enumerate(files):
            yield f"frames[{k}], {file},", _picture(file)

    return Source(read, count=len(files))


def _picture(file: Path) -> NDArray:
    """Read one picture, grey or RGB."""
    if is_tiff(file):
        pages = list(tiff_pages(file))
        if len(pages) != 1:
            raise ValueError(f"{file} must hold one page to be one frame, got {len(pages)}")
        return pages[0][1]
    if not file.is_file():
        raise ValueError(f"frames cannot be read from {file}: no such file")
    image = decode("frames", file, cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError(
            f"frames cannot be read from {file}: damaged, or not an image that OpenCV knows"
        )
    # OpenCV puts blue first.
    return image if image.ndim == 2 else np.ascontiguousarray(image[..., 2::-1])


def _video(path: Path) -> Source:
    """Read the frames of a video, as many as it says."""
    if not path.is_file():
        raise ValueError(f"frames cannot be read from {path}: no such file")
    film = cv2.VideoCapture(str(path))
    opened, count = film.isOpened(), int(film.get(cv2.CAP_PROP_FRAME_COUNT))
    film.release()
    if not opened or count < 1:
        raise ValueError(f"frames cannot be read from {path}: not a video that OpenCV knows")

    def read() -> Named:
        film = cv2.VideoCapture(str(path))
        try:
            for k in range(count):
                good, image = film.read()
                if not good:
                    raise ValueError(
                        f"frames cannot be read from {path}: it tells of {count} frames, "
                        f"{k} can be read"
                    )
                yield f"frame {k} of {path}", np.ascontiguousarray(image[..., ::-1])
        finally:
            film.release()

    return Source(read, count=count)
