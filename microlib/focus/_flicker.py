"""How far flicker and drift of the light pull depths, where nobody asked to undo them.

A focus measure grows with the light, so that a peak leans towards the brighter of its frames. How
bright the frames are is seen: the pull follows from it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.focus._peaks import fit_peak

#: Standard deviation of the default measure's peak over the width of that in _scale.py: with it the
#: depths of rendered stacks lean as far as computed, within a fifth.
_DEVIATION = 0.4
#: Least and greatest standard deviation, frames: what narrower and wider peaks come to is no peak.
_NARROWEST, _WIDEST = 0.5, 3.0
#: The measure is a product of two, each in proportion to the light.
_POWER = 2
#: Depths for each frame at which the pull is computed: it is averaged over one frame, as where it
#: changes sign it is not known so well.
_FINE = 8
#: Frames on either side in the fit, and around it where a peak that leans may have its best frame.
_FIT, _AROUND = 3, 2
#: Variance that is not worth stating, frames²: a tenth of what no depth shows, see _errors.py.
_LEAST = 0.003**2


def watched(frames: Iterable[Image], levels: list[float]) -> Iterator[Image]:
    """Yield frames, and append the mean grey level of each to a list."""
    for frame in frames:
        levels.append(cv2.mean(frame)[0])
        yield frame


def flicker_variance(
    depth: Array, levels: Array, sizes: NDArray[np.intp], width: float
) -> NDArray[np.float32]:
    """Return the mean square of the pull of brighter frames.

    Parameters
    ----------
    depth : ndarray, shape (rows, cols)
        Depth, as a number of averaged frames; NaN where unknown.
    levels : ndarray, shape (n,)
        Mean grey level of every frame.
    sizes : ndarray of int, shape (m,)
        How many frames are averaged into each.
    width : float
        Width of the stack's peaks, frames, as `peak_width` returns it.

    Returns
    -------
    ndarray of float32, shape (rows, cols)
        Variance, in squares of averaged frames; 0 where the depth is unknown, and everywhere if
        some frame has no mean light, from which a gain could be told.
    """
    starts = np.cumsum(sizes) - sizes
    level = np.add.reduceat(np.asarray(levels, float), starts) / sizes
    if not (level > 0).all():
        return np.zeros(depth.shape, np.float32)
    deviation = np.clip(_DEVIATION * width * len(sizes) / len(levels), _NARROWEST, _WIDEST)
    place, pull = _pull(np.log(level), float(deviation))
    square = np.pad(pull**2, _FINE // 2, mode="edge")
    mean = np.convolve(square, np.full(_FINE + 1, 1 / (_FINE + 1)), mode="valid")
    if mean.max() < _LEAST:
        return np.zeros(depth.shape, np.float32)
    known = np.isfinite(depth)
    return np.where(known, np.interp(np.nan_to_num(depth), place, mean), 0).astype(np.float32)


def _pull(log_level: Array, deviation: float) -> tuple[Array, Array]:
    """Return depths, in frames, and how far the fit to a Gaussian peak there leans."""
    last = len(log_level) - 1
    place = np.arange(last * _FINE + 1) / _FINE
    around = np.arange(-_FIT - _AROUND, _FIT + _AROUND + 1)[:, None]
    frame = np.rint(place).astype(np.intp) + around
    inside = (frame >= 0) & (frame <= last)
    logarithm = -((frame - place) ** 2) / (2 * deviation**2)
    gain = _POWER * (log_level[np.clip(frame, 0, last)] - log_level.mean())
    fits = [
        _vertex(np.where(inside, y, -np.inf), frame, last) for y in (logarithm, logarithm + gain)
    ]
    return place, np.nan_to_num(fits[1] - fits[0])


def _vertex(logarithm: Array, frame: NDArray[np.intp], last: int) -> Array:
    """Return the depth that the default's fit finds for each column's profile."""
    middle = slice(_FIT, len(frame) - _FIT)
    best = _FIT + logarithm[middle].argmax(axis=0)
    rows = np.clip(best + np.arange(-_FIT, _FIT + 1)[:, None], 0, len(frame) - 1)
    peak = np.take_along_axis(logarithm, best[None], 0)
    # The fit is of float32, and compiled for no other type.
    window = np.exp(np.take_along_axis(logarithm, rows, 0) - peak).astype(np.float32)
    index = np.clip(np.take_along_axis(frame, best[None], 0), 0, last).astype(np.uint16)
    return fit_peak(window[:, None], index, np.arange(last + 1.0))[0][0].astype(float)
