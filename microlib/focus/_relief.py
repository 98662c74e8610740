"""Fine relief that the smoothing took away, told from noise, and how far a depth may be wrong.

Depths by the second differences along rows and down columns have nearly independent errors, so
that what both have in common is the object, and their difference is noise. All on the grid of every
second pixel, depths in steps.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib.focus._measures import blur
from microlib.focus._reliability import fill_nearest

#: Difference in depth across which nothing is smoothed, steps, and the smoothing's radius, px.
JUMP, RADIUS = 1.5, 3.5
#: For each octave of relief: radius of the next coarser mean and side of the window of comparison,
#: px; correlation of the directions, and its scatter in a window of 1 px, that noise alone has.
_OCTAVES = (
    (0.4, 20, 0.05, 0.4),
    (0.8, 20, 0.07, 0.6),
    (2.0, 20, 0.09, 0.92),
    (2.8, 28, 0.1, 1.68),
)
#: Standard deviations by which a covariance must exceed that of noise to begin to count, and to
#: count in full.
_DOUBT, _SURE = 2.5, 4.5
#: Logarithm of what a measure's windows take from relief, over its mean squared slope, px²; the
#: most that is given back, and the radius over which the slope is told.
_TAKEN, _MOST_GIVEN, _SLOPE_WINDOW = 0.27, 2.2, 8.0
#: Variance of the smoothed depth over that of half the difference of both directions, and the
#: radius over which that is averaged, px.
_NOISE_SHARE, _NOISE_WINDOW = 0.78, 20.0
#: Variance that neither direction shows, everywhere and where the depth is level, steps²: the fit
#: pulls depths towards frames, and the smoothing takes the mean over a slope (px of the full grid).
_UNSEEN, _PULL, _PULL_RADIUS = 0.0065**2, 0.010**2, 5.2
#: How far a texture moves a depth along a slope, px of the full grid, and the steepest slope for
#: which that holds, steps/px; the radius over which the slope is looked at.
_SHIFT, _STEEPEST, _SLOPE_RADIUS = 0.15, 0.3, 1.15
#: Least rise over 3 px, beyond that of a slope, that is an edge, steps, and the errors over its
#: height: at it, and up to 2 px beside one below two jumps, which the smoothing may mix.
_EDGE, _AT_EDGE, _BESIDE_EDGE = 0.25, 0.4, 0.09
#: Beside a higher one the error is the distance of the depths by two measures, or its square if
#: that is less: on drawn texture 0.03 steps at a distance of 0.2, on photographs 1.0 at 1.2. The
#: most that one pixel counts, steps, and the radius over which this and the next are averaged, px.
_MOST_APART, _LOCAL = 6.0, 2.0
#: Error at a sharp bend, such as the tip of a cone, over its distance from a Gaussian mean.
_BENT = 0.2


def find_relief(along: NDArray, down: NDArray, weight: NDArray) -> tuple[NDArray, NDArray]:
    """Return the relief that both directions agree on, and half of what they differ by.

    Parameters
    ----------
    along, down : ndarray, shape (rows, cols)
        Depths by second differences of either direction, less the smoothed depth.
    weight : ndarray, shape (rows, cols)
        Weight of each pixel.

    Returns
    -------
    relief, half_difference : ndarray, shape (rows, cols)
        The latter of what is coarser than all octaves.
    """
    finer = (along, down)
    kept = np.zeros((2, *along.shape), np.float32)
    for sigma, window, common, chance in _OCTAVES:
        total = np.maximum(blur(weight, sigma), 1e-12)
        wider = tuple(blur(image * weight, sigma) / total for image in (along, down))
        p, q = (fine - wide for fine, wide in zip(finer, wider, strict=True))
        pp, qq, pq, ppqq = (blur(f, window / 2) for f in (p * p, q * q, p * q, (p * q) ** 2))
        pp, qq = np.maximum(pp, 0), np.maximum(qq, 0)
        alone = np.sqrt(pp * qq)
        scatter = chance / window * np.maximum(alone, np.sqrt(np.maximum(ppqq, 0)))
        excess = (pq - common * alone) / np.maximum(scatter, 1e-30)
        sure = np.clip((excess - _DOUBT) / (_SURE - _DOUBT), 0, 1)
        # The share of the mean's variance that is the object's.
        share = np.clip(pq / np.maximum((pp + qq + 2 * pq) / 4, 1e-30), 0, 1) * sure
        kept += share * np.stack([p, q])
        finer = wider
    # The windows of the measure flatten relief as a Gaussian does: by its mean square wavenumber.
    (py, px), (qy, qx) = (_forward(part) for part in kept)
    power = blur(kept[0] * kept[1], _SLOPE_WINDOW)
    slope = blur(px * qx + py * qy, _SLOPE_WINDOW)
    given = np.clip(_TAKEN * slope / np.maximum(power, 1e-6), 0, np.log(_MOST_GIVEN))
    factor = np.where(power > 1e-6, np.exp(given), 1).astype(np.float32)
    return kept.mean(axis=0) * factor, (finer[0] - finer[1]) / 2


def _forward(image: NDArray) -> tuple[NDArray, NDArray]:
    """Return the differences to the next row and column, 0 at the last."""
    down, along = (np.diff(image, axis=k, append=image.take([-1], k)) for k in (0, 1))
    return down, along


def error_variance(
    depth: NDArray, half_difference: NDArray, pull: NDArray, apart: NDArray
) -> NDArray:
    """Return the mean square error of a depth: noise, light, slopes, edges and sharp bends.

    Parameters
    ----------
    depth : ndarray, shape (rows, cols)
        The depth; NaN where unknown.
    half_difference : ndarray, shape (rows, cols)
        Half the difference of two independent depths, smoothed as widely.
    pull : ndarray, shape (rows, cols)
        How far changes of the light pull the depth.
    apart : ndarray, shape (rows, cols)
        Distance of the depths by the default's two measures, steps.

    Returns
    -------
    ndarray, shape (rows, cols)
        Variance, steps².
    """
    variance = _NOISE_SHARE * np.maximum(blur(half_difference**2, _NOISE_WINDOW), 0) + pull**2
    full = fill_nearest(depth)
    dy, dx = np.gradient(blur(full, _SLOPE_RADIUS))
    steepness = (dx * dx + dy * dy) / 4  # per px of the full grid
    variance += _UNSEEN + _PULL * np.exp(-((2 * np.pi * _PULL_RADIUS) ** 2) * steepness)
    variance += _SHIFT**2 * np.minimum(steepness, _STEEPEST**2)
    # A plane rises three times as far over 7 px as over 3, a step as far.
    jump = np.maximum(1.5 * depth_range(full, 3) - 0.5 * depth_range(full, 7), 0)
    jump[jump < _EDGE] = 0
    variance += (_AT_EDGE * jump) ** 2
    beside = cv2.dilate(jump, np.ones((5, 5), np.uint8))
    doubt = blur(np.minimum(apart, _MOST_APART), _LOCAL)
    doubt = np.minimum(np.minimum(doubt, doubt * doubt), _AT_EDGE * beside)
    variance += np.where(beside < 2 * JUMP, _BESIDE_EDGE * beside, doubt) ** 2
    bent = (full - blur(full, RADIUS)) ** 2
    bent[cv2.dilate(jump, np.ones((15, 15), np.uint8)) >= 2 * JUMP] = 0
    return np.asarray(variance + _BENT**2 * np.maximum(blur(bent, _LOCAL), 0), np.float32)


def depth_range(depth: NDArray, side: int) -> NDArray:
    """Return the range of depths in a square."""
    square = np.ones((side, side), np.uint8)
    return np.asarray(cv2.dilate(depth, square) - cv2.erode(depth, square))
