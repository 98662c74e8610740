"""Relief that smoothing took, put back as far as two independent depths agree on it.

The errors of depths from horizontal and from vertical second differences are nearly independent, so
that their covariance is the variance of what is on the object. All depths are in frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.focus._directions import Directions
from microlib.focus._errors import smooth_variance
from microlib.focus._measures import blur

# What the depth and its uncertainty owe to each constant is measured in benchmarks/focus_depth.py.

#: Largest offset from the smoothed depth that may be relief; what differs by more is another side
#: of a step, see `_JUMP` in _depth.py.
_MOST = 1.6
#: Largest ratio of a weight to the median, either way: one pixel shall not decide alone.
_WEIGHTS = 100.0
#: Variance of the harmonics of the position between frames that is added to their own: an image
#: all of one depth (variance near 0) does not show how its depths are pulled towards frames, one
#: over several frames (variance 0.5) does.
_RIDGE = 0.1
#: Radius over which the depth is smoothed for that, px, as relief shall not be taken for the pull,
#: and the difference from the depth itself up to which a pixel counts, frames.
_LARGE, _ALIKE = 20.0, 0.2
#: Smoothings whose differences are the bands of relief, px: octaves from the pixel to what the base
#: keeps by itself.
_SIGMAS = (0.5, 0.8, 1.6, 3.2, 6.4)
#: Windows over which the agreement in each band is averaged, px: about 20 times the band's own
#: grain, so that chance is small, see `_CHANCE`.
_WINDOWS = (20.0, 20.0, 20.0, 28.0)
#: Correlation that noise alone has in each band, and its standard deviation times the window, px:
#: the largest found on smooth surfaces of several textures, contrasts, noises, JPEG and spreads.
_COMMON, _CHANCE = (0.05, 0.07, 0.09, 0.10), (0.4, 0.6, 0.92, 1.68)
#: Standard deviations above chance from which on agreement counts as relief, and counts fully.
_DOUBT, _SURE = 2.5, 4.5
#: Variance of the windows of the directional measures, px²: 1 from their spread, the rest from the
#: second difference. Relief of wavenumber k comes out smaller by exp(-σ²k²/2).
_BLUR = 1.25
#: Largest factor by which that is undone; relief finer than 8 px is lost in noise.
_SHARPEN = 2.2
#: Radius over which the composed relief is averaged, px.
_COMPOSED = 16.0
#: Variance of the noise that comes back with the relief, and of relief that does not come back,
#: over what both directions show of them. Measured on rendered relief, where the error is known.
_RETURNED, _LOST = 1.4, 1.6


@dataclass(frozen=True)
class Relief:
    """What is added to the smoothed depth, and how sure the sum is.

    Attributes
    ----------
    offset : ndarray of float32, shape (rows, cols)
        Relief above the smoothed depth, frames.
    variance : ndarray of float32, shape (rows, cols)
        Mean square error of the sum of both, frames².
    """

    offset: NDArray[np.float32]
    variance: NDArray[np.float32]


#: Averages over a window, where the depth is known.
_Mean = Callable[[NDArray], NDArray]


def find_relief(base: Array, directions: Directions, doubtful: NDArray[np.bool_]) -> Relief:
    """Return the relief above a smoothed depth on which two independent depths agree.

    Parameters
    ----------
    base : ndarray of float64, shape (rows, cols)
        Smoothed depth, frames; NaN where unknown.
    directions : Directions
        Offsets of the directional depths from it.
    doubtful : ndarray of bool, shape (rows, cols)
        Where light from elsewhere was found, or no depth.

    Returns
    -------
    Relief
        Offset and the variance of the whole.

    Notes
    -----
    The offsets are split into bands. In each, the covariance of the two directions over the
    variance of their joint depth is the share of relief, as in Wiener's filter, and counts if it is
    more than chance. The relief so composed has a mean square wavenumber, again from the covariance
    of both directions, which tells what the windows of the measure took from it.

    The variance has the parts of `smooth_variance`, and two of its own: noise that returned with
    the relief, which is its variance less the covariance, and relief that was seen but held back.
    """
    known = np.isfinite(base)
    weights = _weights(directions.weights, known)
    plain = np.clip(directions.offsets, -_MOST, _MOST)
    offsets = plain - _locking(plain, weights, base)
    bands, smooth = _bands(offsets, weights)
    relief, held = np.zeros_like(offsets), np.zeros_like(offsets)
    for band, window, common, chance in zip(bands, _WINDOWS, _COMMON, _CHANCE, strict=True):
        mean = _mean(known, window)
        share, agreed = _agreement(band, mean, common, chance / window)
        share, agreed = (_enlarged(part, base.shape) for part in (share, agreed))
        relief += share * band
        held += agreed * (1 - share) * band
    mean = _mean(known, _COMPOSED)
    sharpen, returned = _composed(relief, mean)
    lost_sharpen, _ = _composed(held, mean)
    lost = np.maximum(mean(held[1] * held[2]), 0) * lost_sharpen**2
    own = _enlarged(_RETURNED * returned * sharpen**2 + _LOST * lost, base.shape)
    half_difference = (smooth[1] - smooth[2]) / 2
    return Relief(
        offset=relief[0] * _enlarged(sharpen, base.shape),
        variance=own + smooth_variance(base, half_difference, weights[0], doubtful),
    )


def _weights(weights: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return weights around 1, without extremes, and 0 where there is no depth."""
    result = np.zeros_like(weights)
    for kind, raw in enumerate(weights):
        used = known & (raw > 0)
        typical = np.median(raw[used]) if used.any() else 1.0
        relative = np.clip(raw / typical, 1 / _WEIGHTS, _WEIGHTS)
        result[kind] = np.where(used, relative, 0)
    return result


def _locking(offsets: NDArray, weights: NDArray, base: Array) -> NDArray[np.float32]:
    """Return how far each depth is pulled towards frames, as a function of its place between them.

    The logarithm of a profile is no parabola, so that its fit depends on where the frames lie. Both
    directions are pulled alike, and it would pass for relief. Two harmonics of the place, fitted to
    all pixels.
    """
    level = np.nan_to_num(base).astype(np.float32)
    large = _weighted_blur(level, np.isfinite(base).astype(np.float32), _LARGE)
    # At the image's border and beside steps the wide mean says nothing of a pixel's own place.
    certain = weights * (np.abs(large - level) < _ALIKE)
    pull = np.empty_like(offsets)
    for kind, (offset, weight) in enumerate(zip(offsets, certain, strict=True)):
        total = max(float(weight.sum()), 1e-30)
        centered = [wave - np.vdot(wave, weight) / total for wave in (*_harmonics(large), offset)]
        weighted = [weight * wave for wave in centered[:-1]]
        products = np.array([[np.vdot(a, b) for b in centered] for a in weighted]) / total
        factors = np.linalg.solve(products[:, :-1] + _RIDGE * np.eye(4), products[:, -1])
        pull[kind] = np.tensordot(factors.astype(np.float32), _harmonics(level), axes=1)
    return pull


def _harmonics(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    phase = 2 * np.pi * (depth % 1)
    return np.stack([wave(k * phase) for k in (1, 2) for wave in (np.sin, np.cos)])


def _bands(offsets: NDArray, weights: NDArray) -> tuple[list[NDArray], NDArray]:
    """Return the differences of ever smoother offsets, weighted, and the smoothest."""
    bands = []
    finer = None
    for sigma in _SIGMAS:
        smooth = np.stack(
            [_weighted_blur(*pair, sigma) for pair in zip(offsets, weights, strict=True)]
        )
        if finer is not None:
            bands.append(finer - smooth)
        finer = smooth
    return bands, smooth


def _weighted_blur(image: NDArray, weight: NDArray, sigma: float) -> NDArray[np.float32]:
    # Beyond the reach of any weight there is nothing to smooth.
    return blur(image * weight, sigma) / np.maximum(blur(weight, sigma), np.float32(1e-12))


def _mean(known: NDArray[np.bool_], sigma: float) -> _Mean:
    """Return a function that averages over known pixels, in every second pixel of an image."""
    weight = known[::2, ::2].astype(np.float32)
    total = np.maximum(blur(weight, sigma / 2), np.float32(1e-6))
    return lambda image: blur(image[::2, ::2] * weight, sigma / 2) / total


def _mean_square(mean: _Mean, image: NDArray) -> NDArray:
    # Running sums leave less than nothing where all is zero beside something large.
    return np.maximum(mean(image**2), 0)


def _enlarged(image: NDArray, shape: tuple[int, ...]) -> NDArray[np.float32]:
    return np.asarray(cv2.resize(image, shape[::-1]))


def _agreement(band: NDArray, mean: _Mean, common: float, chance: float) -> tuple[NDArray, NDArray]:
    """Return the share of relief in a band, and how far it is more than chance, 0 to 1."""
    both, along, down = band
    product = along * down
    covariance = mean(product)
    alone = np.sqrt(_mean_square(mean, along) * _mean_square(mean, down))
    # Where a few pixels hold most of the noise, chance is that of so few: the root of the products'
    # mean square takes the place of that of two normal variates.
    scatter = chance * np.maximum(alone, np.sqrt(_mean_square(mean, product)))
    least = np.float32(1e-30)
    above = (covariance - common * alone) / np.maximum(scatter, least)
    agreed = np.clip((above - _DOUBT) / (_SURE - _DOUBT), 0, 1)
    share = np.clip(covariance / np.maximum(_mean_square(mean, both), least), 0, 1)
    return share * agreed, agreed


def _composed(relief: NDArray, mean: _Mean) -> tuple[NDArray, NDArray]:
    """Return what undoes the measure's windows, and the variance of noise within the relief."""
    both, along, down = relief
    covariance = mean(along * down)
    slopes = sum(mean(a * b) for a, b in zip(np.gradient(along), np.gradient(down), strict=True))
    # Below a thousandth of a frame there is no relief whose wavenumber could be told.
    wavenumber = np.where(covariance > 1e-6, slopes / np.maximum(covariance, 1e-6), 0)
    sharpen = np.exp(np.clip(_BLUR / 2 * wavenumber, 0, np.log(_SHARPEN)))
    return sharpen, np.maximum(mean(both**2) - covariance, 0)
