"""How many frames is a peak wide? So many are averaged that it has the width the default expects.

All lengths along the axis are in frames further on. Averaged frames, not averaged measures: a
measure takes the modulus, and what noise adds to that no average takes away again.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.focus._measures import Scale
from microlib.focus._window import Window

#: The measure whose peak is looked at: fine, as wide texture has wide peaks of its own, and
#: averaged over 2 px, so that noise does not choose the highest frame.
_MEASURE = Scale(0.8, 2.0)
#: Side and largest number along each side of the squares that it is sampled in, and the distance of
#: the samples, px: 4096 pixels at the most, which tell a median to a few percent.
_SQUARE, _SQUARES, _SAMPLE = 32, 8, 4
#: Percentile of a profile that is taken for its ground.
_GROUND = 20
#: Equivalent width of a peak in averaged frames. The error is flat from 2.8 to 4.5, table "frames
#: averaged into one" of benchmarks/focus_depth.py; rounding to whole frames keeps above 2.8.
_WIDTH = 3.7


def peak_width(frames: Iterable[Image]) -> float:
    """Return the width of the peaks of a stack's focus measure, in frames.

    Parameters
    ----------
    frames : iterable of ndarray, shape (rows, cols)
        All frames, at least one.

    Returns
    -------
    float
        Area of the peak over its height, both above the profile's 20th percentile: the median
        over the half of the samples that have the higher peaks. One where no peak stands out.
    """
    return _width(np.stack([_samples(frame) for frame in frames]))


def width_of_squares(squares: list[list[Image]], shape: tuple[int, int]) -> tuple[float, Array]:
    """Return what `peak_width` does from the `square_windows` of a large image, and their peaks.

    Parameters
    ----------
    squares : list of lists of ndarray
        For each window, what all frames show of it.
    shape : tuple of int
        Rows and columns of the image.

    Returns
    -------
    width : float
        As `peak_width` returns it.
    height : ndarray, shape (len(squares),)
        Median height of the peaks in each square.
    """
    reach = _MEASURE.reach
    rows, cols = (_around(side, reach) for side in shape)
    places = [(down - down.min(), along - along.min()) for down in rows for along in cols]
    profiles, heights = [], []
    for frames, place in zip(squares, places, strict=True):
        inner = np.s_[reach:-reach:_SAMPLE, reach:-reach:_SAMPLE]
        samples = [_MEASURE(frame[np.ix_(*place)].astype(np.float32))[inner] for frame in frames]
        profile = np.stack([sample.ravel() for sample in samples])
        profiles.append(profile)
        heights.append(float(np.median(_above_ground(profile).max(axis=0))))
    return _width(np.concatenate(profiles, axis=1)), np.array(heights)


def square_windows(shape: tuple[int, int]) -> list[Window]:
    """Return the squares that a stack's width is measured in, with what is around them."""
    rows, cols = (_around(side, _MEASURE.reach) for side in shape)
    return [
        Window(down.min(), along.min(), down.max() + 1, along.max() + 1, shape)
        for down in rows
        for along in cols
    ]


def _width(profiles: NDArray[np.float32]) -> float:
    above = _above_ground(profiles)
    height = above.max(axis=0)
    clear = (height >= np.median(height)) & (height > 0)
    if not clear.any():
        return 1.0
    return float(np.median(above.sum(axis=0)[clear] / height[clear]))


def _above_ground(profiles: NDArray[np.float32]) -> NDArray[np.float32]:
    return profiles - np.percentile(profiles, _GROUND, axis=0).astype(np.float32)


def _samples(frame: Image) -> NDArray[np.float32]:
    """Return the measure at samples from squares all over the frame."""
    reach = _MEASURE.reach
    rows, cols = (_around(side, reach) for side in frame.shape)
    # Side by side in one image: none reaches into its neighbor as far as its samples.
    squares = frame[rows.ravel()][:, cols.ravel()].astype(np.float32)
    measure = _MEASURE(squares).reshape(*rows.shape, *cols.shape)
    inner = (
        slice(reach, rows.shape[1] - reach, _SAMPLE),
        slice(reach, cols.shape[1] - reach, _SAMPLE),
    )
    return measure[:, inner[0], :, inner[1]].ravel()


def _around(side: int, reach: int) -> NDArray[np.intp]:
    """Return the pixels of every square along a side and around it, mirrored at the border."""
    square = np.arange(-reach, min(_SQUARE, side) + reach)
    pixels = np.abs(_starts(side)[:, None] + square) % max(2 * side - 2, 1)
    return np.minimum(pixels, np.abs(2 * side - 2 - pixels))


def _starts(side: int) -> NDArray[np.intp]:
    """Return where squares begin along a side: at even distances, as many as fit."""
    count = min(max(side // _SQUARE, 1), _SQUARES)
    return np.linspace(0, max(side - _SQUARE, 0), count).astype(np.intp)


def group_sizes(count: int, width: float) -> NDArray[np.intp]:
    """Return how many frames are averaged into each: even to one frame, three groups at least."""
    size = max(round(width / _WIDTH), 1)
    groups = max(count // size, 3)
    return np.diff(np.arange(groups + 1) * count // groups)


def averaged_positions(positions: Array, sizes: NDArray[np.intp]) -> Array:
    """Return the mean position of each group."""
    starts = np.cumsum(sizes) - sizes
    return np.add.reduceat(positions, starts) / sizes


def averaged(frames: Iterator[Image], sizes: NDArray[np.intp]) -> Iterator[Image]:
    """Yield the mean of each group of frames, float32."""
    for size in sizes:
        total = next(frames).astype(np.float32)
        for frame in islice(frames, int(size) - 1):
            cv2.add(total, frame, dst=total, dtype=cv2.CV_32F)
        yield total / np.float32(size)
