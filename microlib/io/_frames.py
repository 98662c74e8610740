"""Read the frames of a focal stack one at a time, from memory or from files."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Frames, Region, as_array, as_region, flag, whole
from microlib.io._source import Named, Source
from microlib.io._sources import open_source, refuse_choice


def read_frames(
    frames: Frames,
    *,
    color: bool = False,
    region: Region | None = None,
    reduce: int = 1,
    channel: int | None = None,
    time: int | None = None,
    series: int | None = None,
) -> FrameReader:
    """Return the frames of a stack one after the other, checked, without holding more than one.

    Parameters
    ----------
    frames : array_like, path, or iterable
        An array of shape (n, rows, cols), or (n, rows, cols, 3) in color, or anything with a
        `shape` like that whose frames are loaded as it is indexed, such as a zarr array; an
        xarray.DataArray, whose dimensions may be in any order if two are named x and y, and whose
        coordinates are positions and pixel size, in µm or in the unit that ``attrs["units"]``
        names (0, 1, 2, … without a unit only number the pixels); a folder or a pattern
        (``"scan/*.jpg"``) of images, in the order of the numbers in their names; a multi-page TIFF
        or OME-TIFF; OME-Zarr 0.4 or 0.5; a NumPy file; a GIF or a video; or an iterable, such as a
        list or a generator, of images or of paths to image files; or what this function returned.
        A photograph is turned as its camera says, unless that changes within a stack. ``~`` is the
        home folder.
    color : bool
        Whether color is wanted. If not, it becomes luminance, 0.299 R + 0.587 G + 0.114 B.
    region : tuple of four ints, optional
        Part of the frames, (x, y, width, height) in px; of what a reader gives, if it is one.
    reduce : int
        Side of the square blocks of pixels that become one, their mean.
    channel, time, series : int, optional
        Number, from zero, of the channel, the time and the series of images to read, of a TIFF,
        OME-Zarr or xarray.DataArray with more axes than one besides rows and columns.

    Returns
    -------
    FrameReader
        An iterator over the frames: ndarrays of shape (rows, cols), or (rows, cols, 3) in red,
        green and blue, of 8 or 16 bits or float32; other number types become float32. Frames of
        an array are views of it, all others are the reader's own. Values are as stored: a TIFF in
        which zero is white is not inverted. The reader's attributes `count`, `shape`, `dtype`,
        `color`, `axis`, `pixel_size` (µm/px), `positions` (µm) and `files` are what is known of
        the frames before they are read. A reader of a reader goes on where that one is, and both
        share the frames that are left.

    Raises
    ------
    ValueError
        If the frames are none of these; if a file is missing, is no image, or is of another size
        than the first; if the order of files is ambiguous, or one frame has two files; if a TIFF is
        cut off, has more pages or fewer than it says, or has axes to choose from: at once. While
        the frames are read, if one is neither grey nor color, not finite, beyond ±10¹⁰, damaged, or
        differs from the first in size or type, or if a film ends before its number of frames. The
        message names the frame, and the page or axes of a TIFF. The frames before are good; the
        reader gives none after it and fails again.

    Warns
    -----
    UserWarning
        If a video has another number of frames than its header says; if numbers are missing in the
        names of files; if pixels are not square, or two positions in the metadata disagree; if
        results of this library are left out of a folder.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.io import read_frames
    >>> reader = read_frames(np.zeros((2, 4, 5), np.uint8))
    >>> reader.count, reader.shape, [frame.dtype.name for frame in reader]
    (2, (4, 5), ['uint8', 'uint8'])
    """
    in_color, by = flag("color", color), whole("reduce", reduce, least=1)
    part = None if region is None else as_region("region", region)
    wanted = {"channel": channel, "time": time, "series": series}
    choice = {key: whole(key, n, least=0) for key, n in wanted.items() if n is not None}
    if isinstance(frames, FrameReader):
        refuse_choice(choice)
        return frames.part(in_color, part, by)
    source = open_source(frames, choice)
    return FrameReader(source, Ahead(source.read()), in_color, part, by)


class FrameReader(Iterator[NDArray]):
    """The frames of a stack, one after the other.

    Attributes
    ----------
    count : int or None
        Number of frames; None for an iterator, which does not tell.
    shape : tuple of int
        Rows and columns.
    dtype : numpy.dtype
        Type of the grey levels.
    color : bool
        Whether the source has colors.
    axis : str
        Letter of the axis of frames in a file's metadata, such as Z or T; empty if there is none.
    pixel_size : float or None
        Side of a pixel, µm/px.
    positions : ndarray, shape (count,), or None
        Position of each frame along the optical axis, µm.
    corner : (float, float)
        x and y of the middle of the first pixel, in pixels, from where x and y of the frames are 0.
    files : tuple of Path
        The files that are read, in order.
    """

    def __init__(
        self, source: Source, raw: Ahead, color: bool, region: Region | None, reduce: int
    ) -> None:
        self._source, self._raw = source, raw
        self._in_color, self._region, self._reduce = color, region, reduce
        self._first = ("grey", np.dtype(np.uint8), (0, 0))
        if (first := raw.peek()) is not None:
            self._first = _kind(self._prepared(*first), first[1])
        kind, self.dtype, self.shape = self._first
        self.color, self.axis, self.files = kind == "color", source.axis, source.files
        self.count = None if source.count is None else source.count - raw.taken
        self.positions = None if source.positions is None else source.positions[raw.taken :]
        size, (left, top) = source.pixel_size, (0, 0) if region is None else region[:2]
        self.pixel_size = None if size is None else size * reduce
        # From the middle of the first pixel of the source, in its pixels.
        x, y = (at + (reduce - 1) / 2 for at in (left, top))
        if size is not None:
            x, y = x + source.origin[0] / size, y + source.origin[1] / size
        self.corner = (x / reduce, y / reduce)

    @property
    def origin(self) -> tuple[float, float]:
        """x and y of the middle of the first pixel, µm; 0 where the pixel size is not known."""
        size = self.pixel_size or 0.0
        return size * self.corner[0], size * self.corner[1]

    def __next__(self) -> NDArray:
        if (named := self._raw.peek()) is None:
            raise StopIteration
        frame = self._prepared(*named)
        if (came := _kind(frame, named[1])) != self._first:
            must, got = ("{} {} of shape {}".format(*kind) for kind in (self._first, came))
            raise ValueError(f"{named[0]} must be {must} like the first frame, got {got}")
        self._raw.take()
        return frame

    def part(self, color: bool, region: Region | None, reduce: int) -> FrameReader:
        """Return a reader of the frames that are left, with options as of `read_frames`."""
        part, by = self._region, self._reduce
        if region is not None:
            x, y, width, height = as_region("region", region, self.shape)
            left, top = (part or (0, 0))[:2]
            part = (left + by * x, top + by * y, by * width, by * height)
        return FrameReader(self._source, self._raw, color, part, by * reduce)

    def _prepared(self, name: str, frame: NDArray) -> NDArray:
        """Return the part that is wanted, in a type and colors that are."""
        if frame.ndim != 2 and not _has_color(frame):
            raise ValueError(f"{name} must be a grey or color image, got shape {frame.shape}")
        if min(frame.shape) == 0:
            raise ValueError(f"{name} must have pixels, got shape {frame.shape}")
        if self._region is not None:
            x, y, width, height = as_region("region", self._region, frame.shape)
            frame = frame[y : y + height, x : x + width]
        if frame.dtype.kind == "u" and frame.dtype.itemsize <= 2:
            frame = np.ascontiguousarray(frame, dtype=frame.dtype.newbyteorder("="))
        elif frame.dtype.kind in "uif":
            # Products of sharpness, from which depths are found, stay in single precision's range.
            frame = as_array(name, frame, dtype=np.float32)
        else:
            raise ValueError(f"{name} must hold real numbers, got {frame.dtype}")
        if frame.ndim == 3:
            frame = np.ascontiguousarray(frame[..., :3])
            frame = frame if self._in_color else cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)
        by = self._reduce
        if by == 1:
            return np.ascontiguousarray(frame)
        rows, cols = frame.shape[0] // by, frame.shape[1] // by
        if min(rows, cols) == 0:
            raise ValueError(
                f"{name} must have sides of at least the {by} px of a block, got {frame.shape}"
            )
        # What is left beside the last block is cut off.
        blocks = frame[: rows * by, : cols * by]
        return np.asarray(cv2.resize(blocks, (cols, rows), interpolation=cv2.INTER_AREA))


class Ahead:
    """Raw frames, of which the next one can be looked at; a failure stays one."""

    def __init__(self, named: Named) -> None:
        self._named, self.taken = named, 0
        self._next: tuple[str, NDArray] | None = None
        self._failure: Exception | None = None

    def peek(self) -> tuple[str, NDArray] | None:
        """Return the next frame and its name, or None after the last."""
        if self._failure is not None:
            raise self._failure
        try:
            self._next = self._next or next(self._named, None)
        except Exception as error:
            self._failure = error
            raise
        return self._next

    def take(self) -> None:
        """Go on to the frame after that."""
        self._next, self.taken = None, self.taken + 1


def _kind(frame: NDArray, raw: NDArray) -> tuple[str, np.dtype, tuple[int, int]]:
    """Return what all frames of a stack share."""
    rows, columns = frame.shape[:2]
    return "color" if _has_color(raw) else "grey", frame.dtype, (rows, columns)


def _has_color(frame: NDArray) -> bool:
    return frame.ndim == 3 and frame.shape[-1] in (3, 4)
