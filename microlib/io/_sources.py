"""Where the frames of a stack come from: arrays, files, folders, videos; opened and checked."""

from __future__ import annotations

import glob
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from microlib._common import Array, Frames, refuse_masks
from microlib.io._metadata import labels_scale
from microlib.io._tiff import is_tiff, tiff_pages, tiff_stack

_PICTURES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm"})
#: Videos with a list of their frames, and others, whose number OpenCV computes from times.
_LISTED = frozenset({".avi", ".mp4", ".m4v", ".mov"})
_VIDEOS = _LISTED | {".mkv", ".mpg", ".mpeg", ".webm", ".wmv"}

#: Raw frames, each with the name that a message gives it.
Named = Iterator[tuple[str, NDArray]]


@dataclass(frozen=True)
class Source:
    """A stack that is ready to be read.

    Attributes
    ----------
    read : callable
        Begins to read: yields each raw frame, grey or RGB, with its name for messages.
    count : int or None
        Number of frames, if known.
    axis : str
        Letter of the axis of frames in the metadata of a file, such as Z or T; empty if not said.
    pixel_size : float or None
        Side of a pixel, µm/px, if the file tells.
    positions : ndarray, shape (count,), or None
        Positions of the frames along the optical axis, µm, if the file tells.
    origin : (float, float)
        x and y of the middle of the first pixel, µm, where the pixel size is known.
    """

    read: Callable[[], Named]
    count: int | None = None
    axis: str = ""
    pixel_size: float | None = None
    positions: Array | None = None
    origin: tuple[float, float] = (0.0, 0.0)


def open_source(frames: Frames) -> Source:
    """Find out what the frames are, and refuse what is missing, before any of them is read."""
    if isinstance(frames, (str, PathLike)):
        return _path(Path(frames).expanduser())
    if hasattr(frames, "shape") and hasattr(frames, "__getitem__"):
        return _array(frames)
    if isinstance(frames, Sequence):
        if frames and all(isinstance(item, (str, PathLike)) for item in frames):
            return _pictures([Path(item).expanduser() for item in frames])
        return Source(partial(_items, frames), count=len(frames))
    if isinstance(frames, Iterable):
        return Source(partial(_items, frames))
    raise ValueError(
        "frames must be an array, a file, a folder or an iterable of images, "
        f"got {type(frames).__name__}"
    )


def _path(path: Path) -> Source:
    if path.suffix.lower() == ".zarr" and path.exists():
        return _zarr(path)
    if path.is_dir():
        found = [file for file in path.iterdir() if file.suffix.lower() in _PICTURES]
        return _pictures(_sorted(file for file in found if file.name[0] != "."), path)
    if not path.exists() and glob.has_magic(str(path)):
        return _pictures(_sorted(Path(name) for name in glob.glob(str(path))), path)
    if path.suffix.lower() in _VIDEOS:
        return _video(path)
    if path.suffix.lower() in _PICTURES and not is_tiff(path) and path.is_file():
        return _pictures([path])
    return Source(partial(tiff_pages, path), *tiff_stack(path))


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

    if hasattr(frames, "dims") and hasattr(frames, "coords"):  # xarray's
        axis = str(frames.dims[0])[:1].upper()
        return Source(read, shape[0], axis if axis in ("T", "C") else "", *labels_scale(frames))
    return Source(read, count=shape[0])


def _zarr(path: Path) -> Source:
    try:
        import zarr  # optional, and slow to import

        return _array(zarr.open_array(str(path), mode="r"))
    except Exception as error:  # a group of arrays, or damaged
        raise ValueError(
            f"frames must be one zarr array (to read it: pip install zarr), got {path}: {error}"
        ) from error


def _items(items: Iterable[Any]) -> Named:
    for k, item in enumerate(items):
        if isinstance(item, (str, PathLike)):
            yield f"frames[{k}], {item},", picture(Path(item).expanduser())
        else:
            refuse_masks(f"frames[{k}]", item)
            # A camera may hand out the same buffer again and again.
            yield f"frames[{k}]", np.array(item)


def _sorted(files: Iterable[Path]) -> list[Path]:
    """Sort files by their names, and numbers in them by their value."""

    def key(file: Path) -> list[Any]:  # text and numbers in turn
        return [int(p) if k % 2 else p for k, p in enumerate(re.split(r"(\d+)", file.name))]

    return sorted(files, key=key)


def _pictures(files: Sequence[Path], place: Path | None = None) -> Source:
    """Read one picture a frame; those that are missing or of another size are refused at once."""
    if not files:
        raise ValueError(f"frames must hold images, got none in {place}")
    sizes = [_size(file) for file in files]
    for k, size in enumerate(sizes):
        if size and sizes[0] and size != sizes[0]:
            raise ValueError(
                f"frames[{k}], {files[k]}, must be of shape {sizes[0]} like the first frame, "
                f"got shape {size}"
            )

    def read() -> Named:
        for k, file in enumerate(files):
            yield f"frames[{k}], {file},", picture(file)

    return Source(read, count=len(files))


def _size(file: Path) -> tuple[int, int] | None:
    """Return rows and columns as a picture's header says, None if that tells nothing."""
    if not file.is_file():
        raise ValueError(f"frames cannot be read from {file}: no such file")
    try:
        with Image.open(file) as picture:
            return picture.height, picture.width
    except Exception:  # of another format, damaged or huge: told when it is read
        return None


def picture(file: Path) -> NDArray:
    """Read one picture, grey or RGB."""
    if is_tiff(file):
        pages = list(tiff_pages(file))
        if len(pages) != 1:
            raise ValueError(f"{file} must hold one page to be one frame, got {len(pages)}")
        return pages[0][1]
    if not file.is_file():
        raise ValueError(f"frames cannot be read from {file}: no such file")
    # Not imread, which fails on names outside the system's encoding.
    content = file.read_bytes()
    # OpenCV 4 fills up a JPEG that is cut off: the mark of its end must follow its last scan.
    cut = content[:2] == b"\xff\xd8" and content.rfind(b"\xff\xd9") < content.rfind(b"\xff\xda")
    values = np.frombuffer(content, np.uint8)
    try:
        image = None if cut else cv2.imdecode(values, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
    except cv2.error:  # of nothing at all
        image = None
    if image is None:
        raise ValueError(
            f"frames cannot be read from {file}: damaged, of an unknown format, or larger than the "
            "2³⁰ px that OpenCV reads"
        )
    # OpenCV puts blue first.
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _video(path: Path) -> Source:
    """Read the frames of a video, whose list of them is believed until reading tells otherwise."""
    if not path.is_file():
        raise ValueError(f"frames cannot be read from {path}: no such file")
    film = cv2.VideoCapture(str(path))
    told = count = int(film.get(cv2.CAP_PROP_FRAME_COUNT)) if film.isOpened() else 0
    if told < 2 or path.suffix.lower() not in _LISTED:
        count = sum(1 for _ in iter(film.grab, False))
    film.release()
    if count < 1:
        raise ValueError(f"frames cannot be read from {path}: not a video that OpenCV knows")

    def said(number: int) -> str:
        return f"it tells of {max(told, 0)} frames, {number} can be read"

    if count != told:
        warnings.warn(f"{path}: {said(count)}", stacklevel=2)

    def read() -> Named:
        film, k = cv2.VideoCapture(str(path)), 0
        try:
            while (answer := film.read())[0]:
                yield f"frame {k} of {path}", np.ascontiguousarray(answer[1][..., ::-1])
                k += 1
        finally:
            film.release()
        if k < count:
            raise ValueError(f"frames cannot be read from {path}: {said(k)}")
        if k > count:
            warnings.warn(f"{path}: {said(k)}", stacklevel=2)

    return Source(read, count=count)
