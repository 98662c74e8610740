"""One image of many: every pixel from the frame that is named for it."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.focus._nearest import nearest_known

__all__ = ["as_type", "select", "warped"]


def select(frames: Iterable[Image], index: NDArray[np.integer]) -> Image:
    """Return an image whose pixels come from the frames of those numbers.

    Parameters
    ----------
    frames : iterable of ndarray, shape (rows, cols) or (rows, cols, 3)
        Frames, grey or in color.
    index : ndarray of int, shape (rows, cols)
        Number of the frame of each pixel; where it is negative, that of the nearest pixel counts,
        or the first if there is none.

    Returns
    -------
    ndarray of the frames' type and shape

    Raises
    ------
    ValueError
        If the frames are too few or of another size.

    Examples
    --------
    >>> frames = [np.full((1, 3), grey) for grey in (10, 20)]
    >>> select(frames, np.array([[1, -1, 0]])).tolist()
    [[20, 20, 10]]
    """
    wanted = _nearest(index)
    last = int(wanted.max())
    result: Image | None = None
    count = 0
    for k, frame in enumerate(frames):
        count += 1
        if frame.shape[:2] != index.shape:
            raise ValueError(f"frames must have the shape {index.shape}, got {frame.shape[:2]}")
        if result is None:
            result = np.zeros_like(frame)
        here = wanted == k
        result[here] = frame[here]
    if result is None or last >= count:
        raise ValueError(f"frames must be at least {last + 1}, got {count}")
    return result


def _nearest(index: NDArray[np.integer]) -> NDArray[np.integer]:
    unknown = index < 0
    if not unknown.any():
        return index
    if unknown.all():
        return np.zeros_like(index)
    at = nearest_known(unknown)
    return index[at]


def warped(image: Image, pose: Array) -> Image:
    """Return an image where the reference frame has it; the pose maps the reference's px to its."""
    moved = cv2.warpAffine(
        image.astype(np.float32),
        pose,
        (image.shape[1], image.shape[0]),
        flags=cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return as_type(np.asarray(moved), image.dtype)


def as_type(image: Image, dtype: np.dtype) -> Image:
    """Return an image in a type: rounded, and no further than its ends if that is of integers."""
    if dtype.kind not in "ui":
        return image.astype(dtype, copy=False)
    ends = np.iinfo(dtype)
    return np.clip(np.rint(image), ends.min, ends.max).astype(dtype)
