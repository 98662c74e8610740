"""Look around a pixel: the nearest one at which something is known, the slopes, other sizes."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib.focus._compiled import compiled

__all__ = ["enlarged", "filled", "gradients", "halved", "nearest_known"]

#: How far a known depth is sought, px: further than any window around a known pixel reaches.
_FAR = 48


def nearest_known(unknown: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return row and column of the nearest known pixel of each; some must be known.

    Examples
    --------
    >>> nearest_known(np.array([[False, True, True, True, False]]))[1].tolist()
    [[0, 0, 0, 4, 4]]
    """
    # A third of the time of importing the package, for what many depths have no need of.
    from scipy import ndimage

    rows, cols = ndimage.distance_transform_edt(
        unknown, return_distances=False, return_indices=True
    )
    return rows, cols


def gradients(image: NDArray) -> list[NDArray]:
    """Return the slopes down and along, per px; 0 along a side of one pixel."""
    return [
        np.gradient(image, axis=axis) if image.shape[axis] > 1 else np.zeros_like(image)
        for axis in range(2)
    ]


def halved(image: NDArray) -> NDArray[np.float32]:
    """Return the means of two by two pixels; beyond an odd side the last one stands for two."""
    rows, cols = image.shape
    even = image
    if rows % 2 or cols % 2:
        even = cv2.copyMakeBorder(image, 0, rows % 2, 0, cols % 2, cv2.BORDER_REPLICATE)
    size = ((cols + 1) // 2, (rows + 1) // 2)
    return np.asarray(cv2.resize(even, size, interpolation=cv2.INTER_AREA), np.float32)


def enlarged(half: NDArray, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return an image of that shape from one of every second pixel, or of two by two of them.

    Twice as large, whatever the shape: where a pixel comes from shall not depend on the last row.
    """
    rows, cols = half.shape
    twice = cv2.resize(half, (2 * cols, 2 * rows), interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(twice[: shape[0], : shape[1]])


def filled(depth: NDArray) -> NDArray[np.float32]:
    """Put the nearest known depth in place of each NaN, and 0 where none is near.

    Examples
    --------
    >>> filled(np.array([[1.0, np.nan, np.nan, 4.0]])).tolist()
    [[1.0, 1.0, 4.0, 4.0]]
    """
    source = np.ascontiguousarray(depth, np.float32)
    if not np.isnan(source).any():
        return source
    away = np.full(source.shape, _FAR + 1, np.int8)
    out = np.empty_like(source)
    _fill(source, away, out)
    return out


@compiled
def _fill(depth: NDArray[np.float32], away: NDArray[np.int8], out: NDArray[np.float32]) -> None:
    """Find the nearest known pixel in each column, then among those in a row."""
    rows, cols = depth.shape
    none = np.int8(_FAR + 1)
    for y in range(rows):
        for x in range(cols):
            if depth[y, x] == depth[y, x]:
                away[y, x] = 0
            elif y > 0 and away[y - 1, x] < none:
                away[y, x] = away[y - 1, x] + np.int8(1)
    # Up to here counted from above; from below it is negative, and must be nearer.
    for y in range(rows - 2, -1, -1):
        for x in range(cols):
            below = away[y + 1, x]
            if below <= 0 and below > -_FAR and 1 - below < away[y, x]:
                away[y, x] = below - np.int8(1)
    for y in range(rows):
        for x in range(cols):
            out[y, x] = depth[y, x] if away[y, x] == 0 else _nearest(depth, away, y, x)


@compiled
def _nearest(depth: NDArray[np.float32], away: NDArray[np.int8], y: int, x: int) -> np.float32:
    cols = depth.shape[1]
    best, found = _FAR * _FAR + 1, np.float32(0)
    k = 0
    while k * k < best:
        for at in (x - k, x + k):
            if 0 <= at < cols:
                up = int(away[y, at])
                if up <= _FAR and up * up + k * k < best:
                    best, found = up * up + k * k, depth[y - up, at]
        k += 1
    return found
