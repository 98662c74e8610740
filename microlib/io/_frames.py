"""Read the frames of a focal stack one at a time, from memory or from files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from os import PathLike
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Frames, refuse_masks
from microlib.io._files import decode
from microlib.io._tiff import is_tiff, tiff_pages


def read_frames(frames: Frames) -> Iterator[NDArray]:
    """Yield grey frames of one size, checked, without holding more than one.

    Parameters
    ----------
    frames : array_like of shape (n, rows, cols), path, or iterable
        An array; a multi-page TIFF or OME-TIFF; or an iterable, such as a list or a generator, of
        images or of paths to image files. A TIFF has one axis of frames: depth Z, time T, or one
        without a name.

    Yields
    ------
    ndarray, shape (rows, cols)
        8-bit, 16-bit or float32 frames; other number types become float32. Frames of an array are
        views of it, all others are the reader's own. Grey values are as stored: a TIFF in which
        zero is white is not inverted.

    Raises
    ------
    ValueError
        If a frame is not grey, not finite, or differs from the first in size or type; or if a
        file cannot be read, is cut off or damaged, or a TIFF has channels, depth and time, or more
        pages or fewer than it says. The message names the frame, and the page or axes of a TIFF.

    Examples
    --------
    >>> [frame.dtype.name for frame in read_frames(np.zeros((2, 4, 5), np.uint8))]
    ['uint8', 'uint8']
    """
    first: NDArray | None = None
    for name, frame in _named(frames):
        checked = _check(name, frame)
        if first is None:
            first = checked
        elif checked.shape != first.shape or checked.dtype != first.dtype:
            raise ValueError(
                f"{name} must be {first.dtype} of shape {first.shape} like the first frame, "
                f"got {checked.dtype} of shape {checked.shape}"
            )
        yield checked


def _named(frames: Frames) -> Iterator[tuple[str, NDArray]]:
    """Yield each raw frame with the name that an error message should give it."""
    if isinstance(frames, (str, PathLike)):
        yield from tiff_pages(Path(frames))
    elif isinstance(frames, np.ndarray):
        refuse_masks("frames", frames)
        if frames.ndim != 3:
            raise ValueError(f"frames must have shape (any, any, any), got {frames.shape}")
        for k, frame in enumerate(frames):
            yield f"frames[{k}]", frame
    elif isinstance(frames, Iterable):
        for k, item in enumerate(frames):
            if isinstance(item, (str, PathLike)):
                yield f"frames[{k}], {item},", _image(Path(item))
            else:
                refuse_masks(f"frames[{k}]", item)
                # A camera may hand out the same buffer again and again.
                yield f"frames[{k}]", np.array(item)
    else:
        raise ValueError(
            f"frames must be an array, a TIFF or an iterable of images, got {type(frames).__name__}"
        )


def _check(name: str, frame: NDArray) -> NDArray:
    if frame.ndim != 2 or min(frame.shape) == 0:
        raise ValueError(f"{name} must be a grey image of two dimensions, got shape {frame.shape}")
    if frame.dtype.kind not in "uif":
        raise ValueError(f"{name} must hold real numbers, got {frame.dtype}")
    if frame.dtype in (np.uint8, np.uint16):
        return frame if frame.flags.c_contiguous else np.ascontiguousarray(frame)
    with np.errstate(over="ignore"):  # what overflows is infinite, and told below
        result = np.ascontiguousarray(frame, dtype=np.float32)
    if not np.isfinite(result).all():
        bad = int(result.size - np.isfinite(result).sum())
        raise ValueError(f"{name} must be finite, got {bad} NaN or infinite of {result.size}")
    return result


def _image(path: Path) -> NDArray:
    """Read one image file."""
    if is_tiff(path):
        pages = list(tiff_pages(path))
        if len(pages) != 1:
            raise ValueError(f"{path} must hold one page to be one frame, got {len(pages)}")
        return pages[0][1]
    if not path.is_file():
        raise ValueError(f"frames cannot be read from {path}: no such file")
    image = decode("frames", path, cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError(
            f"frames cannot be read from {path}: damaged, or not an image that OpenCV knows"
        )
    return image
