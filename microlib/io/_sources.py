"""Open a stack by its type, or by the suffix of its file."""

from __future__ import annotations

import glob
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image

from microlib._common import SOFTWARE, Frames, home_path, reject_masks
from microlib.io._metadata import label_scale
from microlib.io._names import in_order
from microlib.io._source import NamedFrames, Source, check_axis_of_frames, reading
from microlib.io._tiff import TIFF, open_tiff

PICTURES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm"})
#: Videos with an index of their frames, and others, whose number OpenCV computes from times.
_INDEXED = frozenset({".avi", ".mp4", ".m4v", ".mov"})
FILMS = _INDEXED | {".mkv", ".mpg", ".mpeg", ".webm", ".wmv"}


def open_source(frames: Frames) -> Source:
    """Return what `read_frames` reads, before any frame is decoded."""
    if isinstance(frames, (str, PathLike)):
        return _open_path(home_path(frames))
    if hasattr(frames, "dims") and hasattr(frames, "coords"):  # xarray's
        return open_labeled(frames)
    if hasattr(frames, "shape") and hasattr(frames, "__getitem__"):
        return open_array(frames)
    if isinstance(frames, Sequence) and all(isinstance(f, (str, PathLike)) for f in frames):
        return open_pictures([home_path(file) for file in frames])
    if isinstance(frames, Iterable):
        return open_items(frames)
    need = "frames must be an array, a file, a folder or an iterable of images"
    raise ValueError(f"{need}, got {type(frames).__name__}")


def _open_path(path: Path) -> Source:
    zarr, suffix = _is_zarr(path), path.suffix.lower()
    if not zarr and (path.is_dir() or (not path.exists() and glob.has_magic(str(path)))):
        files = image_files(path)
        return open_pictures(in_order(files)) if len(files) > 1 else _open_path(files[0])
    if not path.exists():
        raise ValueError(f"frames cannot be read from {path}: no such file")
    with reading(f"frames cannot be read from {path}"):
        if zarr:
            return open_zarr(path)
        if suffix in FILMS:
            return open_film(path)
        return open_pictures([path]) if suffix in PICTURES - TIFF else open_tiff(path)


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
    return Source(_each(frames), count=shape[0], files=files)


def _each(frames: Any) -> Callable[[], NamedFrames]:
    def read() -> NamedFrames:
        for k in range(frames.shape[0]):
            yield f"frames[{k}]", np.asarray(frames[k])

    return read


def open_labeled(frames: Any) -> Source:
    """Return an xarray.DataArray's frames; dimensions may be in any order if two are x and y."""
    names = [str(dim).lower() for dim in frames.dims]
    color = len(names) > 3 and frames.shape[-1] in (3, 4) and names[-1] not in (*"xyzt", "time")
    if len(names) - color != 3 or {"c", "channel"} & set(names[:3]):
        raise ValueError(
            "frames must have three dimensions, or four in color, and no channels, got "
            f"{', '.join(names)}: isel chooses a channel or a time"
        )
    if {"y", "x"} <= set(names) and not color and names[-2:] != ["y", "x"]:
        frames = frames.transpose(..., *(frames.dims[names.index(name)] for name in "yx"))
    dims = frames.dims[:3]
    axis = "T" if str(dims[0]).lower() in ("t", "time") else ""
    return Source(_each(frames), frames.shape[0], axis, *label_scale(frames, dims))


def open_zarr(path: Path) -> Source:
    """Return the frames of a zarr array."""
    import zarr  # optional, and slow to import

    found: Any = zarr.open(str(path), mode="r")
    if not isinstance(found, zarr.Array):
        raise ValueError(f"it is a group: give one of its arrays, such as {path / '0'}")
    return open_array(found, (path,))


def open_items(items: Iterable[Any]) -> Source:
    """Return the images of a sequence or an iterator."""
    begun = False

    def read() -> NamedFrames:
        nonlocal begun
        if begun and isinstance(items, Iterator):
            raise ValueError("frames are an iterator, which can be read only once")
        begun = True
        for k, item in enumerate(items):
            reject_masks(f"frames[{k}]", item)
            # A camera may hand out the same buffer again and again.
            yield f"frames[{k}]", np.array(item)

    return Source(read, len(items) if isinstance(items, Sequence) else None)


def image_files(path: Path) -> list[Path]:
    """Return the images in a folder or of a pattern, without pictures and maps of earlier results.

    Examples
    --------
    >>> from pathlib import Path
    >>> from microlib.io._sources import image_files
    >>> image_files(Path("no such folder/*.png"))
    Traceback (most recent call last):
    ValueError: frames must hold images, got none in no such folder/*.png
    """
    if path.is_dir():
        found = [file for file in path.iterdir() if file.suffix.lower() in PICTURES]
    elif path.parent.is_dir():  # which may have brackets in its name
        found = [*path.parent.glob(path.name)]
    else:
        found = [Path(name) for name in glob.glob(str(path))]
    found = sorted(file for file in found if file.name[0] != ".")
    own = [file for file in found if _read_software(file) == SOFTWARE]
    if own and len(own) < len(found):
        warnings.warn(f"{', '.join(file.name for file in own)}: results, left out", stacklevel=2)
        found = [file for file in found if file not in own]
    if not found:
        raise ValueError(f"frames must hold images, got none in {path}")
    return found


def open_pictures(files: Sequence[Path]) -> Source:
    """Return one frame a file."""

    def read() -> NamedFrames:
        for k, file in enumerate(files):
            yield f"frames[{k}], {file},", read_picture(file)

    return Source(read, len(files), files=tuple(files))


def _read_software(file: Path) -> str | None:
    """Return the name of the program that wrote a picture."""
    try:
        with Image.open(file) as picture:
            return picture.info.get("Software") or picture.getexif().get(ExifTags.Base.Software)
    except Exception:  # missing, of another format, damaged or huge: reported when it is read
        return None


def read_picture(file: Path) -> NDArray:
    """Return one picture, grey or RGB, as stored."""
    with reading(f"frames cannot be read from {file}"):
        if not file.is_file():
            raise ValueError("no such file")
        if file.suffix.lower() in TIFF:
            source = open_tiff(file, alone=True)
            if source.count != 1:
                raise ValueError(f"it must hold one page to be one frame, got {source.count}")
            return next(source.read())[1]
        # Not imread, which fails on names outside the system's encoding.
        data = file.read_bytes()
        # OpenCV 4 fills up a JPEG that is cut off: the marker of its end must follow its last scan.
        cut = data[:2] == b"\xff\xd8" and data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda")
        # The sensor of orientation flips under a camera that looks down; the pixels do not.
        flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
        try:
            image = None if cut else cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        except cv2.error:  # of nothing at all, or more than 2³⁰ px
            image = None
        if image is None:
            raise ValueError("damaged, too large or of an unknown format")
    # OpenCV puts blue first.
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def open_film(path: Path) -> Source:
    """Return the frames of a video, whose number in the header is checked when they are read."""
    film = cv2.VideoCapture(str(path))
    if not film.isOpened():
        raise ValueError("not a video that OpenCV can read")
    stated = int(film.get(cv2.CAP_PROP_FRAME_COUNT))
    film.release()
    indexed = stated > 0 and path.suffix.lower() in _INDEXED

    def read() -> NamedFrames:
        film, count = cv2.VideoCapture(str(path)), 0
        while (answer := film.read())[0]:
            yield f"frame {count} of {path}", np.ascontiguousarray(answer[1][..., ::-1])
            count += 1
        numbers = f"{path}: its header has {stated} frames, {count} can be read"
        if count == 0 or (indexed and count < stated):
            raise ValueError(f"frames cannot be read from {numbers}")
        if count != stated:
            warnings.warn(numbers, stacklevel=2)

    return Source(read, stated if indexed else None, files=(path,))
