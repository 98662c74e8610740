"""Read the frames of a focal stack one at a time, from memory or from files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import ArgumentError, Frames, Region, as_array, as_region, whole
from microlib.io._source import NamedFrames
from microlib.io._sources import open_source


def read_frames(
    frames: Frames,
    *,
    color: bool | None = None,
    region: Region | None = None,
    reduce: int = 1,
    channel: int | None = None,
    time: int | None = None,
    series: int | None = None,
) -> FrameReader:
    """Return a reader of the frames of a stack, which checks each frame and holds one frame at a
    time.

    Parameters
    ----------
    frames : array_like, path, or iterable
        One of these:

        - an array of shape (n, rows, cols), or (n, rows, cols, 3) in color, or an object of such a
          `shape` that loads a frame when it is indexed, for example a zarr array;
        - an xarray.DataArray, whose dimensions may be in any order if two are named x and y, and
          whose coordinates are positions and pixel size, in µm or in the unit ``attrs["units"]``
          (coordinates 0, 1, 2, … without a unit are numbers of pixels);
        - a folder or a pattern (``"scan/*.jpg"``) of images, in the order of the numbers in their
          names; EXIF orientation is applied unless it changes within the stack; a folder with one
          file is that file;
        - a multi-page TIFF or OME-TIFF, OME-Zarr 0.4 or 0.5, a NumPy file, a GIF or a video;
        - an iterable, such as a list or a generator, of images or of paths to image files;
        - a reader that this function returned.

        ``~`` is the home folder.
    color : bool, optional
        Whether to keep colors. Otherwise colors are converted to luminance, 0.299 R + 0.587 G +
        0.114 B. By default they are kept if `frames` is a reader that keeps them.
    region : tuple of four ints, optional
        Part of the frames, (x, y, width, height) in px.
    reduce : int
        Side of the square blocks of pixels that are averaged to one.
    channel, time, series : int, optional
        Index, from zero, of the channel, the time or the series to read. Needed for a TIFF, an
        OME-Zarr or an xarray.DataArray that has more than one axis besides rows and columns.

    Returns
    -------
    FrameReader
        An iterable of the frames: ndarrays of shape (rows, cols), or (rows, cols, 3) in red, green
        and blue, of 8 or 16 bits or float32; other number types become float32. Frames of an array
        are views of it. Values are as stored: a TIFF in which zero is white is not inverted. The
        attributes `count`, `shape`, `dtype`, `color`, `axis`, `pixel_size` (µm/px), `positions`
        (µm) and `files` are known before the frames are read, because the first frame is decoded at
        once. The frames can be read again, except those of an iterator. If `frames` is a reader,
        the options act on the frames of that reader.

    Raises
    ------
    ValueError
        At once, if the frames are none of these, if a file is missing or is no image, if the order
        of files is ambiguous, their names differ in more than numbers or one frame has two files,
        or if a TIFF has axes to choose from, or more or fewer pages than its metadata describe.
        While the frames are read, if one is damaged or cut off, neither grey nor color, not finite,
        or of another size or type than the first, if a film ends before the number of frames in its
        header, or if a file changes meanwhile. The message names the frame, and the page or axes of
        a TIFF. Frames that were read before the error are valid, unless a file changed.

    Warns
    -----
    UserWarning
        If a video has another number of frames than its header says; if numbers are missing in the
        names of files, or these have no numbers; if pixels are not square, or positions and spacing
        in the metadata disagree; if photographs have several orientations; if results of this
        library in a folder are left out.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.io import read_frames
    >>> reader = read_frames(np.zeros((2, 4, 5), np.uint8))
    >>> reader.count, reader.shape, [frame.dtype.name for frame in reader]
    (2, (4, 5), ['uint8', 'uint8'])
    """
    by = whole("reduce", reduce, least=1)
    part = None if region is None else as_region("region", region)
    wanted = {"channel": channel, "time": time, "series": series}
    choice = {key: whole(key, n, least=0) for key, n in wanted.items() if n is not None}
    source = frames if isinstance(frames, FrameReader) else open_source(frames, choice)
    if choice:  # which the source has not applied
        name, number = choice.popitem()
        raise ArgumentError(name, f"must be left out for frames without that axis, got {number}")
    keep = isinstance(source, FrameReader) and source.keep_color if color is None else color
    return FrameReader(source, keep, part, by)


class FrameReader(Iterable[NDArray]):
    """The frames of a stack in their order.

    Attributes
    ----------
    count : int or None
        Number of frames; None if it is known only after they were read.
    shape : tuple of int
        Rows and columns.
    dtype : numpy.dtype
        Type of the grey levels.
    color : bool
        Whether the source has colors.
    keep_color : bool
        Whether frames are returned with them.
    axis : str
        Letter of the axis of frames in a file's metadata, such as Z or T; empty if there is none.
    pixel_size : float or None
        Side of a pixel, µm/px.
    positions : ndarray, shape (count,), or None
        Position of each frame along the optical axis, µm.
    corner : (float, float)
        x and y of the center of the first pixel, px, from where x and y of the frames are 0.
    files : tuple of Path
        The files that are read, in order.
    """

    def __init__(self, source: Any, keep_color: bool, region: Region | None, reduce: int) -> None:
        # The source is a Source or another reader, which has the same attributes.
        self._source, self.keep_color = source, keep_color
        self._region, self._reduce = region, reduce
        raw = source.read()
        name, first = next(raw, ("", np.empty((0, 0), np.uint8)))
        # The first frame, which is decoded already, belongs to the first reading.
        self._begun: NamedFrames | None = chain([(name, first)] if name else [], raw)
        self._kind, self.color = _kind(first), first.ndim == 3
        frame = self._prepare(name, first) if name else first
        self.shape, self.dtype = frame.shape[:2], frame.dtype
        self.count, self.axis, self.files = source.count, source.axis, source.files
        self.positions, self._stamps = source.positions, _stamps(source.files)
        self.pixel_size = None if source.pixel_size is None else source.pixel_size * reduce
        x, y = np.add(source.corner, (0, 0) if region is None else region[:2]).tolist()
        to_center = (reduce - 1) / 2  # of the first block
        self.corner = ((x + to_center) / reduce, (y + to_center) / reduce)

    @property
    def origin(self) -> tuple[float, float]:
        """x and y of the center of the first pixel, µm; 0 where the pixel size is not known."""
        size = self.pixel_size or 0.0
        return size * self.corner[0], size * self.corner[1]

    def __iter__(self) -> Iterator[NDArray]:
        return (frame for _, frame in self.read())

    def read(self) -> NamedFrames:
        """Yield each frame with its name in error messages."""
        raw, self._begun = self._begun or self._source.read(), None
        for name, frame in raw:
            if (got := _kind(frame)) != self._kind:
                raise ValueError(f"{name} must be {self._kind} like the first frame, got {got}")
            yield name, self._prepare(name, frame)
        for file, before, after in zip(self.files, self._stamps, _stamps(self.files), strict=True):
            if after != before:
                raise ValueError(f"frames must not change while they are read, got {file}")

    def _prepare(self, name: str, frame: NDArray) -> NDArray:
        """Return the region, reduced, in the colors and the type that are returned."""
        if frame.ndim != 2 and not (frame.ndim == 3 and frame.shape[2] in (3, 4)):
            raise ValueError(f"{name} must be a grey or color image, got shape {frame.shape}")
        if frame.size == 0:
            raise ValueError(f"{name} must have pixels, got shape {frame.shape}")
        if self._region is not None:
            x, y, width, height = as_region("region", self._region, frame.shape)
            frame = frame[y : y + height, x : x + width]
        if frame.dtype.kind == "u" and frame.dtype.itemsize <= 2:
            frame = frame.astype(frame.dtype.newbyteorder("="), copy=False)
        else:
            frame = as_array(name, frame, dtype=np.float32)
        if frame.ndim == 3:
            frame = np.ascontiguousarray(frame[..., :3])
            frame = frame if self.keep_color else cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)
        by, side = self._reduce, min(frame.shape[:2])
        if side < by:
            raise ArgumentError("reduce", f"must be at most {side}, the smaller side, got {by}")
        rows, cols = (n // by for n in frame.shape[:2])
        # Pixels beside the last block are left out.
        blocks = np.ascontiguousarray(frame[: rows * by, : cols * by])
        if by == 1:
            return blocks
        return np.asarray(cv2.resize(blocks, (cols, rows), interpolation=cv2.INTER_AREA))


def _stamps(files: Sequence[Path]) -> list[tuple[int, int] | None]:
    """Return time and size of each file, None if it is missing, which reading it reports."""
    stats = [file.stat() if file.exists() else None for file in files]
    return [stat and (stat.st_mtime_ns, stat.st_size) for stat in stats]


def _kind(frame: NDArray) -> str:
    return f"{frame.dtype} of shape {frame.shape}"
