"""Gaussian fits to the profiles of focus measures, over the frames of a window.

The window of the product of measures has seven frames, see `find_profiles`.

The logarithm of the measure is fitted by a parabola, because Gaussian blur makes the measure of a
pixel nearly a Gaussian of the distance from focus, (3.9).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.focus.common import TINY

#: Pixels that are fitted at a time: their windows stay in the processor's cache.
_BAND = 16384


class Neighborhood(NamedTuple):
    """Frames around the best one; each field has a column for every frame, or every pixel.

    Attributes
    ----------
    position : ndarray, shape (n,)
        Frame coordinate of the best frame.
    lowest, highest : ndarray, shape (n,)
        Limits of the vertex, from that position.
    inverse_width : ndarray, shape (n,)
        One over half the width of the window of weights.
    offset : ndarray, shape (2 reach + 1, n)
        Frame coordinates of the window, from that of the best one.
    """

    position: NDArray[np.float32]
    lowest: NDArray[np.float32]
    highest: NDArray[np.float32]
    inverse_width: NDArray[np.float32]
    offset: NDArray[np.float32]

    def of(self, best: NDArray[np.unsignedinteger]) -> Neighborhood:
        """Return the fields of each pixel from the number of its best frame."""
        return Neighborhood(*(np.take(field, best, axis=-1, mode="clip") for field in self))


def neighborhoods(coordinates: Array, reach: int, beyond: float = 0.0) -> Neighborhood:
    """Return the neighborhood of every frame; arguments as `fit_peaks` has them."""
    last, number = len(coordinates) - 1, np.arange(len(coordinates))
    around = np.clip(number + np.arange(-reach, reach + 1)[:, None], 0, last)
    offset = coordinates[around] - coordinates
    lowest, highest = offset[reach - 1].copy(), offset[reach + 1].copy()
    gap = np.maximum(-lowest, highest)
    lowest[0], highest[-1] = -beyond, beyond
    # The window is as wide on both sides as the stack allows on the shorter one. At an end of the
    # stack there is one side only, and two frames of it make up the least three.
    half = np.minimum(np.minimum(number, last - number), reach)
    half[half == 0] = 2
    before, after = (
        coordinates[np.clip(number + s * half, 0, last)] - coordinates for s in (-1, 1)
    )
    # The window moves to the vertex, which is half a frame away at most, or a whole one at an end
    # of the stack: no frame of three may lose its weight by that.
    width = np.maximum(-before, after) + np.where(half > 1, 0.5, 1.0) * gap
    fields = (coordinates, lowest, highest, 1 / width, offset)
    return Neighborhood(*(field.astype(np.float32) for field in fields))


def fit_peaks(
    window: NDArray[np.float32],
    best: NDArray[np.unsignedinteger],
    coordinates: Array,
    *,
    near: NDArray[np.float32] | None = None,
    within: float = 0.0,
    beyond: float = 0.0,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Fit a Gaussian to the window of each pixel; return its position and its strength.

    Parameters
    ----------
    window : ndarray of float32, shape (2 reach + 1, rows, cols)
        Measures of the best frame, in the middle, and of its neighbors; 0 beyond the stack.
    best : ndarray of int, shape (rows, cols)
        Number of the best frame.
    coordinates : ndarray, shape (n,)
        Frame coordinate of each frame, rising.
    near : ndarray of float32, shape (rows, cols), optional
        A depth around which the peak is sought, instead of around the best frame.
    within : float
        Largest distance of the peak from `near`.
    beyond : float
        Distance by which the stack extends before the first position and behind the last.

    Returns
    -------
    depth : ndarray of float32, shape (rows, cols)
        Vertex, a frame coordinate. NaN where the measure is flat, or its logarithm opens
        upwards; there an end frame of the stack gives its own position. A vertex beyond the
        neighboring frames or outside of the stack is moved to them.
    strength : ndarray of float32, shape (rows, cols)
        Inverse variance of the depth, up to a common factor: height times curvature of the peak.

    Notes
    -----
    Frames are weighted with a power of their measure, because the logarithm of a small one is
    uncertain, and with the square of an inverted parabola centered on the peak. The power is 3/4:
    the measure itself biases depths of fine texture towards the frames by up to 0.018 of a frame,
    its power 3/4 by 0.010. Around a given depth it is 1, which is better for relief. Profiles have
    longer tails than a Gaussian, and a window that is not centered is biased by one of them. The
    peak is only known after a first fit, so there are two. Near the ends of the stack the window
    is narrower for the same reason, to no less than three frames.
    """
    frames = neighborhoods(coordinates, len(window) // 2, beyond)
    rows, cols = best.shape
    depth, strength = np.empty((2, rows, cols), np.float32)
    band = max(1, _BAND // cols)
    for top in range(0, rows, band):
        here = slice(top, top + band)
        samples = window[:, here].reshape(len(window), -1)
        place = None if near is None else near[here].ravel()
        found = _fit(samples, best[here].ravel(), frames, place, within)
        depth[here], strength[here] = (part.reshape(-1, cols) for part in found)
    return depth, strength


def _fit(
    window: NDArray[np.float32],
    best: NDArray[np.unsignedinteger],
    frames: Neighborhood,
    near: NDArray[np.float32] | None,
    within: float,
) -> tuple[NDArray, NDArray]:
    """Do the work of `fit_peaks` on a band of pixels, window of shape (2 reach + 1, pixels)."""
    height = window[len(window) // 2]
    position, lowest, highest, inverse_width, offset = frames.of(best)
    relative = window / np.maximum(height, TINY)
    log = cv2.log(np.maximum(relative, 1e-6))
    center = np.zeros_like(position)
    if near is None:
        power = np.asarray(cv2.sqrt(relative * cv2.sqrt(relative)))  # relative^(3/4)
    else:
        power, center = relative, near - position
        first = frames.position[0] + frames.lowest[0] - position  # ends of the stack
        last = frames.position[-1] + frames.highest[-1] - position
        lowest = np.maximum(center - np.float32(within), first)
        highest = np.maximum(np.minimum(center + np.float32(within), last), lowest)
    with np.errstate(all="ignore"):
        for _ in range(2):
            weight = offset - center
            weight *= inverse_width
            weight *= weight
            np.maximum(np.subtract(1, weight, out=weight), 0, out=weight)
            weight *= weight
            weight *= power
            vertex, curvature = _parabola(weight, offset, log)
            center = np.clip(vertex, lowest, highest)
        peaked = (height > 0) & (log.min(axis=0) < -1e-3)
        fitted = peaked & (curvature < 0) & np.isfinite(center)
        at_end = peaked & ((best == 0) | (best == len(frames.position) - 1))
        depth = np.where(at_end, position, np.float32(np.nan))
        depth = np.where(fitted, position + center, depth)
        return depth, np.where(fitted, -curvature * height, np.float32(0))


def _parabola(weight: NDArray, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
    """Return the vertex and the leading coefficient of the weighted parabola through each column.

    Its terms are made orthogonal one after the other: 1, then x less its mean, then the square of
    that less its own mean and slope.
    """
    total = weight.sum(axis=0)
    mean = np.einsum("ij,ij->j", weight, x) / total
    away = x - mean
    first = weight * away
    second = first * away
    variance = second.sum(axis=0)
    # Slope and mean of the square, (x − mean)².
    slope = np.einsum("ij,ij->j", second, away) / variance
    level = variance / total
    fourth = np.einsum("ij,ij,ij->j", second, away, away)
    norm = fourth - variance * (slope * slope + level)
    y0, y1, y2 = (np.einsum("ij,ij->j", part, y) for part in (weight, first, second))
    curvature = (y2 - slope * y1 - level * y0) / norm
    curvature[~(norm * total > 1e-6 * variance * variance)] = 0
    return mean + (slope - y1 / (variance * curvature)) / 2, curvature
