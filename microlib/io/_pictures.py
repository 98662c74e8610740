"""Stacks of one picture a file, and video."""

from __future__ import annotations

import glob
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from natsort import natsorted
from numpy.typing import NDArray
from PIL import ExifTags, Image

from microlib._common import SOFTWARE
from microlib.io._stack import Stack, open_stack, reading
from microlib.io._tiff import TIFF, open_tiff

PICTURES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm"})
#: Videos with an index of their frames, and others, whose number OpenCV computes from times.
_INDEXED = frozenset({".avi", ".mp4", ".m4v", ".mov"})
FILMS = _INDEXED | {".mkv", ".mpg", ".mpeg", ".webm", ".wmv"}
#: A marker of JPEG other than those within the data of a scan.
_JPEG_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")


def check_exists(path: Path) -> None:
    """Raise if a path is neither a file or a folder nor a pattern of files."""
    if not path.exists() and not glob.has_magic(str(path)):
        raise ValueError(f"frames cannot be read from {path}: no such file")


def image_files(*paths: Path) -> list[Path]:
    """Return files, and images in folders or of patterns, without those of earlier results.

    Examples
    --------
    >>> from pathlib import Path
    >>> from microlib.io._pictures import image_files
    >>> image_files(Path("no such folder/*.png"))
    Traceback (most recent call last):
    ValueError: frames must hold images, got none in no such folder/*.png
    """
    files = [file for path in paths for file in _files_of(path)]
    results = [file for file in files if _read_exif(file)[1] == SOFTWARE]
    if results and len(results) < len(files):
        warnings.warn(
            f"{', '.join(file.name for file in results)}: results, left out", stacklevel=2
        )
        files = [file for file in files if file not in results]
    return files


def _files_of(path: Path) -> list[Path]:
    """Return a file, or the images in a folder or of a pattern."""
    if path.is_file():
        return [path]
    if path.is_dir():
        files = [file for file in path.iterdir() if file.suffix.lower() in PICTURES]
    elif path.parent.is_dir():  # which may have brackets in its name
        files = [*path.parent.glob(path.name)]
    else:
        files = [Path(name) for name in glob.glob(str(path))]
    files = natsorted(sorted(file for file in files if file.name[0] != "."), key=str)
    if not files:
        check_exists(path)
        kinds = f": they must end in {', '.join(sorted(PICTURES))}" if path.is_dir() else ""
        raise ValueError(f"frames must hold images, got none in {path}{kinds}")
    return files


def open_pictures(files: Sequence[Path]) -> Stack:
    """Return one frame a file; EXIF orientation is applied unless it changes among the files."""
    turn = len({_read_exif(file)[0] for file in files}) <= 1
    if not turn:
        warnings.warn("photographs of several orientations are not turned", stacklevel=2)

    return open_stack(
        lambda: (read_picture(file, turn) for file in files),
        name=lambda k: f"frames[{k}], {files[k]},",
        count=len(files),
        files=tuple(files),
    )


def _read_exif(file: Path) -> tuple[int, str]:
    """Return the EXIF orientation and the software of a picture."""
    try:
        with Image.open(file) as picture:
            exif = picture.getexif()
            software = picture.info.get("Software") or exif.get(ExifTags.Base.Software, "")
            return exif.get(ExifTags.Base.Orientation, 1), software
    except Exception:  # missing, of another format, damaged or huge: reported when it is read
        return 1, ""


def read_picture(file: Path, turn: bool = True) -> NDArray:
    """Return one picture, grey or RGB; its EXIF orientation is applied if `turn`."""
    if not file.is_file():
        raise ValueError(f"frames cannot be read from {file}: no such file")
    if file.suffix.lower() in TIFF:
        page = open_tiff(file, {}, alone=True)
        if page.count != 1:
            raise ValueError(f"{file}: it must hold one page to be one frame, got {page.count}")
        return page.first
    with reading(f"frames cannot be read from {file}"):
        # Not imread, which fails on names outside the system's encoding.
        data = file.read_bytes()
        cut = data[:2] == b"\xff\xd8" and not _has_jpeg_end(data)  # OpenCV fills it up
        flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH
        flags |= 0 if turn else cv2.IMREAD_IGNORE_ORIENTATION
        try:
            image = None if cut else cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        except cv2.error:  # of nothing at all, or more than 2³⁰ px
            image = None
        if image is None:
            known = file.suffix.lower() in PICTURES
            kinds = "" if known else f"; pictures that can be read: {', '.join(sorted(PICTURES))}"
            raise ValueError(f"damaged, too large or of an unknown format{kinds}")
    # OpenCV puts blue first.
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _has_jpeg_end(data: bytes) -> bool:
    """Return whether the marker of the end follows the segments of a JPEG; a video may follow."""
    at = 2
    while (marker := _JPEG_MARKER.search(data, at)) and marker[0] != b"\xff\xd9":
        at = marker.end() + int.from_bytes(data[marker.end() : marker.end() + 2], "big")
    return marker is not None


def open_film(path: Path) -> Stack:
    """Return the frames of a video; the number in its header is checked when they are read."""
    times: list[float] = []  # of the frames that were read, s
    film = cv2.VideoCapture(str(path))
    if not film.isOpened():
        raise ValueError(f"frames cannot be read from {path}: not a video that OpenCV can read")
    stated = int(film.get(cv2.CAP_PROP_FRAME_COUNT)) if path.suffix.lower() in _INDEXED else 0
    film.release()

    def read() -> Iterator[NDArray]:
        film, count = cv2.VideoCapture(str(path)), 0
        while (answer := film.read())[0]:
            if count == len(times):
                times.append(film.get(cv2.CAP_PROP_POS_MSEC) / 1000)
            yield cv2.cvtColor(answer[1], cv2.COLOR_BGR2RGB)
            count += 1
        if count < max(stated, 1):
            raise ValueError(
                f"frames cannot be read from {path}: its header has {stated} frames, {count} can "
                "be read"
            )

    def time(number: int) -> float | None:
        risen = number == 0 or times[number] > times[number - 1]
        return times[number] - times[0] if risen else None

    return open_stack(
        read,
        name=lambda k: f"frame {k} of {path}",
        time=time,
        count=stated or None,
        files=(path,),
    )
