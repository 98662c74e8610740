"""Where the frames of a stack come from: arrays, files, folders, videos; opened and checked."""

from __future__ import annotations

import glob
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path
from string import digits
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, ImageSequence

from microlib._common import SOFTWARE, ArgumentError, Frames, home_path, reject_masks
from microlib.io._metadata import labels_scale, zarr_scale
from microlib.io._names import in_order
from microlib.io._source import Choice, Named, Source, frame_indices, reading
from microlib.io._tiff import is_tiff, tiff_frames, tiff_source

_PICTURES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm"})
#: Videos with a list of their frames, and others, whose number OpenCV computes from times.
_LISTED = frozenset({".avi", ".mp4", ".m4v", ".mov"})
_OTHERS = frozenset({".mkv", ".mpg", ".mpeg", ".webm", ".wmv"})


def open_source(frames: Frames, choice: Choice) -> Source:
    """Find out what the frames are, and refuse what is missing, before any of them is read."""
    if isinstance(frames, (str, PathLike)):
        return _path(home_path(frames), choice)
    if hasattr(frames, "dims") and hasattr(frames, "coords"):  # xarray's
        return _labeled(frames, choice)
    refuse_choice(choice)
    if hasattr(frames, "shape") and hasattr(frames, "__getitem__"):
        return _array(frames)
    if isinstance(frames, Sequence):
        if frames and all(isinstance(item, (str, PathLike)) for item in frames):
            return _pictures([home_path(item) for item in frames])
        return Source(partial(_items, frames), count=len(frames))
    if isinstance(frames, Iterable):
        return Source(partial(_items, frames))
    need = "frames must be an array, a file, a folder or an iterable of images"
    raise ValueError(f"{need}, got {type(frames).__name__}")


def refuse_choice(choice: Iterable[str]) -> None:
    """Refuse to choose a channel, a time or a series where no axis has a name."""
    for name in choice:
        need = "must not be given: only TIFF, OME-Zarr and labeled arrays name their axes"
        raise ArgumentError(name, need)


def _path(path: Path, choice: Choice) -> Source:
    if any((path / name).exists() for name in ("zarr.json", ".zarray", ".zgroup")):
        return _zarr(path, choice)
    kind = path.suffix.lower()
    several = path.is_dir() or (not path.exists() and glob.has_magic(str(path)))
    videos = _LISTED | _OTHERS
    if not several and (is_tiff(path) or kind not in _PICTURES | videos | {".gif", ".npy"}):
        return tiff_source(path, choice)
    refuse_choice(choice)
    if several:
        return _pictures(in_order(image_files(path)))
    with reading(f"frames cannot be read from {path}"):
        if kind in videos:
            return _video(path)
        if kind == ".npy":
            return replace(_array(np.load(path, mmap_mode="r")), files=(path,))
        if kind == ".gif":
            with Image.open(path) as film:
                return Source(partial(_gif, path), getattr(film, "n_frames", 1), files=(path,))
    return _pictures([path])


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
        found = [file for file in path.iterdir() if file.suffix.lower() in _PICTURES]
    elif path.parent.is_dir():  # which may have brackets in its name
        found = [*path.parent.glob(path.name)]
    else:
        found = [Path(name) for name in glob.glob(str(path))]
    found = sorted(file for file in found if file.name[0] != ".")
    own = [file for file in found if _header(file)[2] == SOFTWARE]
    if own and len(own) < len(found):
        warnings.warn(f"{', '.join(file.name for file in own)}: results, left out", stacklevel=2)
        found = [file for file in found if file not in own]
    if not found:
        raise ValueError(f"frames must hold images, got none in {path}")
    return found


def _array(frames: Any) -> Source:
    """Read an array, or what is like one but loads its values when it is indexed."""
    reject_masks("frames", frames)
    shape = tuple(frames.shape)
    if not (len(shape) == 3 or (len(shape) == 4 and shape[-1] in (3, 4))):
        need = "frames must have shape (any, any, any), or (any, any, any, 3) in color"
        raise ValueError(f"{need}, got {shape}")
    if 0 < 4 * shape[2] < min(shape[:2]):
        raise ValueError(
            f"frames must come along the first axis, got shape {shape}: numpy.moveaxis changes the "
            "order of axes; a list may have frames so narrow"
        )
    return Source(_at(frames, range(shape[0])), count=shape[0])


def _at(frames: Any, indices: Sequence[Any]) -> Callable[[], Named]:
    def read() -> Named:
        for k, index in enumerate(indices):
            yield f"frames[{k}]", np.asarray(frames[index])

    return read


def _labeled(frames: Any, choice: Choice) -> Source:
    """Read an xarray.DataArray, whose dimensions may be in any order if two are named y and x."""
    refuse_choice([name for name in choice if name == "series"])
    names = [str(dim).lower() for dim in frames.dims]
    if len(names) < 3:
        raise ValueError(f"frames must have three dimensions or more, got {', '.join(names)}")
    color = len(names) > 3 and frames.shape[-1] in (3, 4) and names[-1] not in (*"xyzt", "time")
    if {"y", "x"} <= set(names) and not color and names[-2:] != ["y", "x"]:
        frames = frames.transpose(..., *(frames.dims[names.index(name)] for name in "yx"))
    *leading, y, x = frames.dims[: len(names) - color]
    # Only channels and times matter; other letters tell the axes apart.
    known = {"c": "C", "channel": "C", "t": "T", "time": "T", "z": "Z"}
    letters = "".join(known.get(str(dim).lower(), str(k)) for k, dim in enumerate(leading))
    indices, axis = frame_indices(letters, frames.shape[: len(leading)], choice)
    dims = leading[letters.index(axis) if axis else 0], y, x
    scale = labels_scale(frames, dims)
    return Source(_at(frames, indices), len(indices), axis.strip(digits), *scale)


def _zarr(path: Path, choice: Choice) -> Source:
    """Read a zarr array, or an image of OME-Zarr 0.4 or 0.5 at its full size."""
    with reading(f"frames cannot be read from {path} (to read zarr: pip install zarr)"):
        import zarr  # optional, and slow to import

        found: Any = zarr.open(str(path), mode="r")
        if isinstance(found, zarr.Array):
            refuse_choice(choice)
            return replace(_array(found), files=(path,))
        series = sorted((name for name, _ in found.groups() if name.isdigit()), key=int)
        if series:  # a group for each image
            if len(series) > 1 and "series" not in choice:
                raise ValueError(f"it holds {len(series)} series of images: choose one")
            found = found[series[choice.get("series", 0)]]
        image = found.attrs.get("ome", found.attrs)["multiscales"][0]
        frames = found[image["datasets"][0]["path"]]
        letters = "".join(axis["name"].upper() for axis in image["axes"])
        indices, axis = frame_indices(letters[:-2], frames.shape[:-2], choice)
        size, positions = zarr_scale(image, axis, len(indices), path.name)
        return Source(_at(frames, indices), len(indices), axis, size, positions, files=(path,))


def _items(items: Iterable[Any]) -> Named:
    for k, item in enumerate(items):
        if isinstance(item, (str, PathLike)):
            yield f"frames[{k}], {item},", _picture(home_path(item))
        else:
            reject_masks(f"frames[{k}]", item)
            # A camera may hand out the same buffer again and again.
            yield f"frames[{k}]", np.array(item)


def _pictures(files: Sequence[Path]) -> Source:
    """Read one picture a frame; those that are missing or of another size are refused at once."""
    sizes, orientations, _ = zip(*map(_header, files), strict=True)
    for k, size in enumerate(sizes):
        if size and sizes[0] and size != sizes[0]:
            need = f"frames[{k}], {files[k]}, must be of shape {sizes[0]} like the first frame"
            raise ValueError(f"{need}, got shape {size}")
    turn = len(set(orientations)) == 1
    if not turn:
        warnings.warn("photographs of several orientations are not turned", stacklevel=2)

    def read() -> Named:
        for k, file in enumerate(files):
            yield f"frames[{k}], {file},", _picture(file, turn)

    return Source(read, len(files), files=tuple(files))


def _header(file: Path) -> tuple[tuple[int, int] | None, int, str]:
    """Return rows and columns, EXIF orientation and software of a picture, if Pillow can."""
    if not file.is_file():
        raise ValueError(f"frames cannot be read from {file}: no such file")
    try:
        with Image.open(file) as picture:
            exif = picture.getexif()
            software = picture.info.get("Software") or exif.get(ExifTags.Base.Software, "")
            return picture.size[::-1], exif.get(ExifTags.Base.Orientation, 1), software
    except Exception:  # of another format, damaged or huge: reported when it is read
        return None, 1, ""


def _picture(file: Path, turn: bool = True) -> NDArray:
    """Read one picture, grey or RGB, turned as its camera says if `turn`."""
    if is_tiff(file):
        pages = list(tiff_frames(file, {}, alone=True))
        if len(pages) != 1:
            raise ValueError(f"{file} must hold one page to be one frame, got {len(pages)}")
        return pages[0][1]
    flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH
    flags |= 0 if turn else cv2.IMREAD_IGNORE_ORIENTATION
    if not file.is_file():
        raise ValueError(f"frames cannot be read from {file}: no such file")
    # Not imread, which fails on names outside the system's encoding.
    data = file.read_bytes()
    # OpenCV 4 fills up a JPEG that is cut off: the mark of its end must follow its last scan.
    cut = data[:2] == b"\xff\xd8" and data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda")
    try:
        image = None if cut else cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:  # of nothing at all, or more than 2³⁰ px
        image = None
    if image is None:
        reason = "damaged, too large or of an unknown format"
        raise ValueError(f"frames cannot be read from {file}: {reason}")
    # OpenCV puts blue first.
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _gif(path: Path) -> Named:
    with reading(f"frames cannot be read from {path}"), Image.open(path) as film:
        for k, frame in enumerate(ImageSequence.Iterator(film)):
            yield f"frame {k} of {path}", np.asarray(frame.convert("RGB"))


def _video(path: Path) -> Source:
    """Read the frames of a video, whose number in the header is believed until they were read."""
    film = cv2.VideoCapture(str(path))
    if not film.isOpened():
        raise ValueError("not a video that OpenCV knows" if path.is_file() else "no such file")
    stated = int(film.get(cv2.CAP_PROP_FRAME_COUNT))
    film.release()
    listed = stated > 0 and path.suffix.lower() in _LISTED

    def read() -> Named:
        film, k = cv2.VideoCapture(str(path)), 0
        try:
            while (answer := film.read())[0]:
                yield f"frame {k} of {path}", np.ascontiguousarray(answer[1][..., ::-1])
                k += 1
        finally:
            film.release()
        numbers = f"{path}: its header has {stated} frames, {k} can be read"
        if k == 0 or (listed and k < stated):
            raise ValueError(f"frames cannot be read from {numbers}")
        if k != stated:
            warnings.warn(numbers, stacklevel=2)

    return Source(read, stated if listed else None, files=(path,))
