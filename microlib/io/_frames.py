"""Read the frames of a focal stack one at a time, from memory or from files."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import LARGEST_GREY, Frames, Region, as_array, as_region, flag, whole
from microlib.io._sources import Named, Source, open_source


def read_frames(
    frames: Frames, *, color: bool = False, region: Region | None = None, reduce: int = 1
) -> FrameReader:
    """Return the frames of a stack one after the other, checked, without holding more than one.

    Parameters
    ----------
    frames : array_like, path, or iterable
        An array of shape (n, rows, cols), or (n, rows, cols, 3) in color, or anything with a
        `shape` like that whose frames are loaded as it is indexed, such as a zarr array; an
        xarray.DataArray, whose coordinates are positions and pixel size, in µm or in the unit that
        ``attrs["units"]`` names (0, 1, 2, … without a unit only number the pixels); a folder
        or a pattern (``"scan/*.jpg"``) of images, taken in the order of their names and of the
        numbers in them; a multi-page TIFF or OME-TIFF; a video; or an iterable, such as a list or
        a generator, of images or of paths to image files. A TIFF has one axis of frames: depth Z,
        time T, or one without a name. A photograph is turned as its camera says. ``~`` is the home
        folder.
    color : bool
        Whether color is wanted. If not, it becomes luminance, 0.299 R + 0.587 G + 0.114 B.
    region : tuple of four ints, optional
        Part of the frames, (x, y, width, height) in px.
    reduce : int
        Side of the square blocks of pixels that become one, their mean.

    Returns
    -------
    FrameReader
        An iterator over the frames: ndarrays of shape (rows, cols), or (rows, cols, 3) in red,
        green and blue, of 8 or 16 bits or float32; other number types become float32. Frames of
        an array are views of it, all others are the reader's own. Values are as stored: a TIFF in
        which zero is white is not inverted. The reader's attributes `count`, `shape`, `dtype`,
        `color`, `axis`, `pixel_size` (µm/px) and `positions` (µm) say what the files tell of
        them, None where they do not.

    Raises
    ------
    ValueError
        If the frames are none of these, a file is missing, is of another size than the first or no
        image, or a TIFF is cut off, has channels, depth and time, or more pages or fewer than it
        says: at once. While the frames are read, if one is neither grey nor color, not finite,
        beyond ±10¹⁰, damaged, or differs from the first in size or type. The message names the
        frame, and the page or axes of a TIFF.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.io import read_frames
    >>> reader = read_frames(np.zeros((2, 4, 5), np.uint8))
    >>> reader.count, reader.shape, [frame.dtype.name for frame in reader]
    (2, (4, 5), ['uint8', 'uint8'])
    """
    if isinstance(frames, FrameReader):
        return frames
    part = None if region is None else as_region("region", region)
    return FrameReader(
        open_source(frames), flag("color", color), part, whole("reduce", reduce, least=1)
    )


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
        Letter of the axis of frames in a file's metadata, such as Z or T; empty if not said.
    pixel_size : float or None
        Side of a pixel, µm/px.
    positions : ndarray, shape (count,), or None
        Position of each frame along the optical axis, µm.
    origin : (float, float)
        x and y of the middle of the first pixel, µm, where the pixel size is known.
    """

    def __init__(self, source: Source, color: bool, region: Region | None, reduce: int) -> None:
        self._in_color, self._region, self._reduce = color, region, reduce
        self.count, self.axis, self.positions = source.count, source.axis, source.positions
        size = source.pixel_size
        self.pixel_size = None if size is None else size * reduce
        corner = (0, 0) if region is None else region[:2]
        x, y = ((size or 0.0) * (at + (reduce - 1) / 2) for at in corner)
        self.origin = (source.origin[0] + x, source.origin[1] + y)
        self._first = ("grey", np.dtype(np.uint8), (0, 0))
        self._frames: Iterator[NDArray] = iter(())
        named = source.read()
        if (first := next(named, None)) is not None:
            frame = self._prepared(*first)
            self._first = _kind(frame, first[1])
            self._frames = chain([frame], self._checked(named))
        kind, self.dtype, self.shape = self._first
        self.color = kind == "color"

    def __next__(self) -> NDArray:
        return next(self._frames)

    def _checked(self, named: Named) -> Iterator[NDArray]:
        for name, raw in named:
            frame = self._prepared(name, raw)
            if (came := _kind(frame, raw)) != self._first:
                must, got = (
                    f"{kind} {dtype} of shape {size}" for kind, dtype, size in (self._first, came)
                )
                raise ValueError(f"{name} must be {must} like the first frame, got {got}")
            yield frame
            del raw, frame

    def _prepared(self, name: str, frame: NDArray) -> NDArray:
        """Return the part that is wanted, in a type and colors that are."""
        if frame.ndim not in (2, 3) or (frame.ndim == 3 and not _has_color(frame)):
            raise ValueError(f"{name} must be a grey or color image, got shape {frame.shape}")
        if min(frame.shape) == 0:
            raise ValueError(f"{name} must have pixels, got shape {frame.shape}")
        if self._region is not None:
            x, y, width, height = as_region("region", self._region, frame.shape)
            frame = frame[y : y + height, x : x + width]
        frame = _numbers(name, frame)
        if frame.ndim == 3:
            frame = np.ascontiguousarray(frame[..., :3])
            if not self._in_color:
                frame = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)
        if self._reduce > 1:
            frame = reduced(name, frame, self._reduce)
        return frame


def _kind(frame: NDArray, raw: NDArray) -> tuple[str, np.dtype, tuple[int, int]]:
    """Return what all frames of a stack share."""
    rows, columns = frame.shape[:2]
    return "color" if _has_color(raw) else "grey", frame.dtype, (rows, columns)


def _has_color(frame: NDArray) -> bool:
    return frame.ndim == 3 and frame.shape[-1] in (3, 4)


def _numbers(name: str, frame: NDArray) -> NDArray:
    if frame.dtype.kind not in "uif":
        raise ValueError(f"{name} must hold real numbers, got {frame.dtype}")
    if frame.dtype.kind == "u" and frame.dtype.itemsize <= 2:
        return np.ascontiguousarray(frame, dtype=frame.dtype.newbyteorder("="))
    # The products of sharpness that depths are found by stay in single precision's range.
    return np.ascontiguousarray(as_array(name, frame, dtype=np.float32, largest=LARGEST_GREY))


def reduced(name: str, image: NDArray, by: int) -> NDArray:
    """Return the means of square blocks of pixels; what is left beside the last is cut off."""
    rows, cols = image.shape[0] // by, image.shape[1] // by
    if min(rows, cols) == 0:
        raise ValueError(
            f"{name} must have sides of at least the {by} px of a block, got {image.shape}"
        )
    blocks = image[: rows * by, : cols * by]
    return np.asarray(cv2.resize(blocks, (cols, rows), interpolation=cv2.INTER_AREA))
