"""Fine relief that the smoothing took away, told from noise, and how far a depth may be wrong.

Depths by the second differences along rows and down columns have nearly independent errors, so
that what both have in common is the object, and their difference is noise. All on the grid of every
second pixel, depths in steps.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib.focus._axis import Axis
from microlib.focus._measures import TINY, blur
from microlib.focus._reliability import fill_nearest
from microlib.focus._settings import Settings

#: For each octave of relief: radius of the next coarser mean, px; correlation of the directions,
#: and its scatter in `_WINDOW`, that noise alone has.
_OCTAVES = ((0.8, 0.07, 0.03), (2.0, 0.09, 0.046), (2.8, 0.1, 0.084))
#: Radius over which the directions are compared, and half of that of what they differ by, px.
_WINDOW = 10.0


def find_relief(
    along: NDArray, down: NDArray, weight: NDArray, settings: Settings
) -> tuple[NDArray, NDArray]:
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
    for sigma, common, chance in _OCTAVES:
        total = np.maximum(blur(weight, sigma), TINY)
        wider = tuple(blur(image * weight, sigma) / total for image in (along, down))
        p, q = (fine - wide for fine, wide in zip(finer, wider, strict=True))
        pp, qq, pq, ppqq = (blur(f, _WINDOW) for f in (p * p, q * q, p * q, (p * q) ** 2))
        pp, qq = np.maximum(pp, 0), np.maximum(qq, 0)
        alone = np.sqrt(pp * qq)
        scatter = chance * np.maximum(alone, np.sqrt(np.maximum(ppqq, 0)))
        excess = (pq - common * alone) / np.maximum(scatter, TINY)
        sure = np.clip((excess - settings.doubt) / (settings.sure - settings.doubt), 0, 1)
        # The share of the mean's variance that is the object's.
        share = np.clip(pq / np.maximum((pp + qq + 2 * pq) / 4, TINY), 0, 1) * sure
        kept += share * np.stack([p, q])
        finer = wider
    return kept.mean(axis=0) * _given_back(kept, settings.taken), (finer[0] - finer[1]) / 2


def _given_back(kept: NDArray, taken: float) -> NDArray:
    """Return what relief is to be multiplied by, at most 3, for what the measures' windows took.

    They flatten relief as a Gaussian does: by its mean square wavenumber.
    """
    power = blur(kept[0] * kept[1], 4.0)
    slope = blur(sum(part[0] * part[1] for part in np.gradient(kept, axis=(1, 2))), 4.0)
    given = np.clip(taken * slope / np.maximum(power, 1e-6), 0, np.log(3))
    return np.where(power > 1e-6, np.exp(given), 1).astype(np.float32)


def frame_pull(depth: NDArray, axis: Axis) -> NDArray:
    """Return how far the frames pull a depth towards themselves, steps.

    A real profile is more pointed than a Gaussian, so that its fit leans to the nearest frame, and
    the more so the narrower the peaks. On a slope the pulls of many frames are averaged away.

    Parameters
    ----------
    depth : ndarray, shape (rows, cols)
        The depth, steps; NaN where unknown.
    axis : Axis
        The averaged frames.
    """
    number = np.interp(np.nan_to_num(depth), axis.steps, np.arange(len(axis.steps)))
    # The measures and the smoothing take a mean over a slope, of some 5 px.
    left = np.exp(-((2 * np.pi * 5) ** 2) / 2 * _steepness(depth))
    return np.asarray(-axis.pull * np.sin(2 * np.pi * number) * left, np.float32)


def _steepness(depth: NDArray) -> NDArray:
    """Return the square of the slope, steps per px of the full grid."""
    dy, dx = np.gradient(blur(fill_nearest(depth), 1.0))
    return np.asarray((dx * dx + dy * dy) / 4)


def error_variance(
    depth: NDArray, half_difference: NDArray, pull: NDArray, apart: NDArray, settings: Settings
) -> NDArray:
    """Return the mean square error of a depth: noise, light, slopes, edges and sharp bends.

    Its numbers were found on drawn texture and photographs; the table of stated errors in
    benchmarks/focus_depth.py shows what they are worth.

    Parameters
    ----------
    depth : ndarray, shape (rows, cols)
        The depth; NaN where unknown.
    half_difference : ndarray, shape (rows, cols)
        Half the difference of two independent depths, smoothed as widely.
    pull : ndarray, shape (rows, cols)
        How far changes of the light and frames may pull the depth.
    apart : ndarray, shape (rows, cols)
        Distance of the depths by the default's two measures, steps.
    settings : Settings
        Those of the smoothing.

    Returns
    -------
    ndarray, shape (rows, cols)
        Variance, steps².
    """
    high = 2 * settings.jump
    variance = np.maximum(blur(half_difference**2, 2 * _WINDOW), 0) + pull**2
    # Texture moves a depth along a slope, by 0.12 px of the full grid.
    variance += 0.12**2 * _steepness(depth)
    full = fill_nearest(depth)
    height = step_height(full)
    beside = cv2.dilate(height, np.ones((5, 5), np.uint8))
    # The smoothing may mix both sides of a low edge. Beside a high one the error is the distance of
    # the depths by two measures, or its square if that is less: on drawn texture 0.03 steps at a
    # distance of 0.2, on photographs 1.0 at 1.2.
    doubt = blur(np.minimum(apart, 6), 2.0)
    doubt = np.minimum(doubt, doubt * doubt)
    variance += np.where(beside < high, 0.17 * beside, doubt) ** 2
    # At a sharp bend, such as the tip of a cone.
    bent = (full - blur(full, settings.radius)) ** 2
    bent[cv2.dilate(height, np.ones((15, 15), np.uint8)) >= high] = 0
    return np.asarray(variance + 0.2**2 * np.maximum(blur(bent, 2.0), 0), np.float32)


def step_height(depth: NDArray) -> NDArray:
    """Return how high a step is at each pixel, about 0 on a slope.

    A plane rises three times as far over 7 px as over 3, a step as far.
    """
    return np.asarray(1.5 * depth_range(depth, 3) - 0.5 * depth_range(depth, 7))


def depth_range(depth: NDArray, side: int) -> NDArray:
    """Return the range of depths in a square."""
    square = np.ones((side, side), np.uint8)
    return np.asarray(cv2.dilate(depth, square) - cv2.erode(depth, square))
