"""Open a stack: a table of readers by the suffix of a file, and one for each kind of array."""

from __future__ import annotations

import glob
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import (
    ArgumentError,
    Frames,
    Region,
    as_array,
    as_choice,
    as_integer,
    as_region,
    home_path,
)
from microlib.io._arrays import open_array, open_items
from microlib.io._names import in_order
from microlib.io._pictures import (
    FILMS,
    PICTURES,
    check_exists,
    image_files,
    open_film,
    open_pictures,
)
from microlib.io._stack import Choice, LazyFrames, Stack
from microlib.io._tiff import TIFF, open_tiff

#: The reader of a file by its suffix. A reader removes from the choice what it applied.
READERS: dict[str, Callable[[Path, Choice], Stack]] = {
    **dict.fromkeys(PICTURES, lambda path, choice: open_pictures([path])),
    **dict.fromkeys(FILMS, lambda path, choice: open_film(path)),
    **dict.fromkeys((*TIFF, ".btf", ".lsm", ".stk"), open_tiff),
}


def read_frames(
    frames: Frames,
    *,
    color: bool | None = None,
    region: Region | None = None,
    reduce: int = 1,
    axis: str | None = None,
    channel: int | None = None,
    time: int | None = None,
    series: int | None = None,
) -> Stack:
    """Return a stack of frames, which are read and checked one at a time when they are needed.

    Parameters
    ----------
    frames : array_like, path, or iterable
        One of these:

        - an array of shape (n, rows, cols), or (n, rows, cols, 3) in color, or an object of such a
          `shape` that loads a frame when it is indexed, for example a zarr array;
        - a folder or a pattern (``"scan/*.jpg"``) of images, in the natural order of their names;
          EXIF orientation is applied unless it changes within the stack; a folder with one file is
          that file;
        - a multi-page TIFF or OME-TIFF, or a video;
        - an iterable, such as a list or a generator, of images or of paths to image files;
        - a `Stack`, which this function returned.

        ``~`` is the home folder.
    color : bool, optional
        Whether to keep colors. Otherwise colors are converted to luminance, 0.299 R + 0.587 G +
        0.114 B. By default they are kept if `frames` is a `Stack` in color.
    region : tuple of four ints, optional
        Part of the frames, (x, y, width, height) in px.
    reduce : int
        Side of the square blocks of pixels that are averaged to one.
    axis : {"C", "T", "Z"}, optional
        Letter that the file gives to the axis of the frames. Give "T" or "C" for a focal stack that
        a TIFF stores along times or channels, and "C" for a film along channels.
    channel, time, series : int, optional
        Index, from zero, of the channel, the time or the series to read. Needed for a TIFF that has
        more than one axis besides rows and columns. If the metadata of a TIFF declare a single
        channel or time, its index is 0. Frames without this axis accept no index.

    Returns
    -------
    Stack
        An iterable of the frames: ndarrays of shape (rows, cols), or (rows, cols, 3) in red, green
        and blue, of 8 or 16 bits or float32; other number types become float32. Frames of an array
        are views of it. Values are as stored: a TIFF in which zero is white is not inverted. The
        first frame is decoded at once. All frames can be read again, except those of an iterator.
        If `frames` is a `Stack`, the options act on the frames of that stack.

    Raises
    ------
    ValueError
        At once, if the frames are none of these or there is none; if a file is missing, is no
        image or has an unknown suffix; if the names of files give two orders or count along two
        axes, or one frame has two files; if a TIFF has axes to choose from, or fewer pages than its
        metadata describe. While the frames are read, if one is damaged or cut off, neither grey nor
        color, not finite, or of another size or type than the first, or if a film ends before the
        number of frames in its header. The message names the frame. Frames that were read before
        the error are valid.

    Warns
    -----
    UserWarning
        If the names of files differ in more than numbers, in several numbers of which none counts
        the files, or in one number that is not evenly spaced; if pixels are not square, or
        positions and spacing in the metadata disagree; if photographs have several orientations; if
        three or four images that `tifffile` wrote are marked as the colors of one; if results of
        this library in a folder are left out.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.io import read_frames
    >>> stack = read_frames(np.zeros((2, 4, 5), np.uint8))
    >>> stack
    Stack(2 frames of 4×5 px, grey, uint8)
    >>> [frame.dtype.name for frame in stack]
    ['uint8', 'uint8']
    """
    by = as_integer("reduce", reduce, least=1)
    part = None if region is None else as_region("region", region)
    wanted = {"channel": channel, "time": time, "series": series}
    choice: Choice = {
        key: as_integer(key, n, least=0) for key, n in wanted.items() if n is not None
    }
    if axis is not None:
        choice["axis"] = as_choice("axis", axis, ("C", "T", "Z"))
    stack = frames if isinstance(frames, Stack) else _open(frames, choice)
    if choice:  # which the reader has not applied
        name, number = choice.popitem()
        raise ArgumentError(name, f"must be left out for frames without that axis, got {number}")
    in_color = isinstance(frames, Stack) if color is None else color

    def prepare(frame: NDArray, number: int) -> NDArray:
        return _reduced(_converted(frame, stack.name(number), part, in_color), by)

    def read() -> Iterator[NDArray]:
        kind = _kind(stack.first)
        for k, frame in enumerate(stack):
            if (got := _kind(frame)) != kind:
                like = stack.name(0).removesuffix(",")
                raise ValueError(f"{stack.name(k)} must be {kind} like {like}, got {got}")
            yield prepare(frame, k)

    return replace(
        stack,
        frames=LazyFrames(read),
        first=prepare(stack.first, 0),
        pixel_size=None if stack.pixel_size is None else stack.pixel_size * by,
    )


def _open(frames: Frames, choice: Choice) -> Stack:
    """Return the frames as they are stored."""
    if isinstance(frames, (str, PathLike)):
        return _open_path(home_path(frames), choice)
    if hasattr(frames, "shape") and hasattr(frames, "__getitem__"):
        return open_array(frames)
    if isinstance(frames, Sequence) and all(isinstance(f, (str, PathLike)) for f in frames):
        return open_pictures([home_path(file) for file in frames])
    if isinstance(frames, Iterable):
        return open_items(frames)
    need = "frames must be an array, a file, a folder or an iterable of images"
    raise ValueError(f"{need}, got {type(frames).__name__}")


def _open_path(path: Path, choice: Choice) -> Stack:
    if path.is_dir() or (not path.exists() and glob.has_magic(str(path))):
        files = in_order(image_files(path))
        return open_pictures(files) if len(files) > 1 else _open_path(files[0], choice)
    check_exists(path)
    suffix = path.suffix.lower()
    if suffix not in READERS:
        kinds = ", ".join(sorted(READERS))
        raise ValueError(f"{path} has an unknown suffix: microlib reads {kinds}")
    return READERS[suffix](path, choice)


def _kind(frame: NDArray) -> str:
    """Return what all frames of a stack have in common."""
    return f"{frame.dtype} of shape {frame.shape}"


def _converted(frame: NDArray, name: str, region: Region | None, in_color: bool) -> NDArray:
    """Check a frame; return its region in the colors and the type that are returned."""
    if frame.ndim != 2 and not (frame.ndim == 3 and frame.shape[2] in (3, 4)):
        raise ValueError(f"{name} must be a grey or color image, got shape {frame.shape}")
    if frame.size == 0:
        raise ValueError(f"{name} must have pixels, got shape {frame.shape}")
    if region is not None:
        x, y, width, height = as_region("region", region, frame.shape)
        frame = frame[y : y + height, x : x + width]
    if frame.dtype.kind == "u" and frame.dtype.itemsize <= 2:
        frame = frame.astype(frame.dtype.newbyteorder("="), copy=False)
    else:
        frame = as_array(name, frame, dtype=np.float32)
    if frame.ndim == 3:
        frame = np.ascontiguousarray(frame[..., :3])
        frame = frame if in_color else cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)
    return frame


def _reduced(frame: NDArray, by: int) -> NDArray:
    """Return the means of square blocks of pixels; the pixels beside the last are left out."""
    side = min(frame.shape[:2])
    if side < by:
        raise ArgumentError("reduce", f"must be at most {side}, the smaller side, got {by}")
    rows, cols = (n // by for n in frame.shape[:2])
    blocks = np.ascontiguousarray(frame[: rows * by, : cols * by])
    return blocks if by == 1 else cv2.resize(blocks, (cols, rows), interpolation=cv2.INTER_AREA)
