"""Relief that smoothing took, put back as far as two independent depths agree on it.

The errors of depths from horizontal and from vertical second differences are nearly independent, so
that their covariance is the variance of what is on the object. All depths are in frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, pipeline
from microlib.focus._bands import (
    TILE_ROWS,
    add_products,
    compose_rows,
    median_above_zero,
    split_rows,
    unlock,
)
from microlib.focus._directions import Directions
from microlib.focus._errors import smooth_variance
from microlib.focus._filters import own_room
from microlib.focus._loops import balance
from microlib.focus._measures import blur, blur_taps
from microlib.focus._nearest import enlarged
from microlib.focus._questions import Question, Steps

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


def find_relief(
    base: Array, directions: Directions, doubtful: NDArray[np.bool_], *, workers: int = 1
) -> Steps[Relief]:
    """Return the relief above a smoothed depth on which two independent depths agree.

    Parameters
    ----------
    base : ndarray of float64, shape (rows, cols)
        Smoothed depth, frames; NaN where unknown.
    directions : Directions
        Offsets of the directional depths from it.
    doubtful : ndarray of bool, shape (rows, cols)
        Where light from elsewhere was found, or no depth.
    workers : int
        Threads; the result does not depend on them.

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
    weights = yield from _weights(directions.weights, known)
    offsets = yield from _unlocked(np.clip(directions.offsets, -_MOST, _MOST), weights, base)
    del directions
    relief, held, half_difference = _relief(offsets, weights, known, workers)
    del offsets
    mean = _mean(known, _COMPOSED)
    covariance, sharpen = _composed(relief[1:], mean)
    returned = np.maximum(mean(relief[0, ::2, ::2] ** 2) - covariance, 0)
    lost_covariance, lost_sharpen = _composed(held, mean)
    lost = np.maximum(lost_covariance, 0) * lost_sharpen**2
    own = enlarged(_RETURNED * returned * sharpen**2 + _LOST * lost, base.shape)
    variance = yield from smooth_variance(base, half_difference, weights[0], doubtful)
    return Relief(relief[0] * enlarged(sharpen, base.shape), own + variance)


def _weights(weights: NDArray[np.float32], known: NDArray[np.bool_]) -> Steps[NDArray[np.float32]]:
    """Return weights around 1, without extremes, and 0 where there is no depth."""
    result = weights * known
    typical = yield Question(
        "weights",
        lambda: [weight[::2, ::2][weight[::2, ::2] > 0] for weight in result],
        lambda samples: np.array(
            [median_above_zero(np.concatenate(kind)) for kind in zip(*samples, strict=True)]
        ),
    )
    for weight, middle in zip(result, typical, strict=True):
        balance(weight, np.float32(middle), np.float32(_WEIGHTS))
    return result


def _unlocked(
    offsets: NDArray[np.float32], weights: NDArray[np.float32], base: Array
) -> Steps[NDArray[np.float32]]:
    """Take from each depth how far it is pulled towards frames, by its place between them.

    The logarithm of a profile is no parabola, so that its fit depends on where the frames lie. Both
    directions are pulled alike, and it would pass for relief. Two harmonics of the place, fitted to
    all pixels.
    """
    level = np.where(np.isfinite(base), base, 0).astype(np.float32)
    factors = yield Question("pull", lambda: _products(level, base, offsets, weights), _factors)
    result = np.empty_like(offsets)
    unlock(level, offsets, factors, result)
    return result


def _products(
    level: NDArray[np.float32],
    base: Array,
    offsets: NDArray[np.float32],
    weights: NDArray[np.float32],
) -> Array:
    """Return sums over all pixels of the products of harmonics and offsets, (kinds, 5, 6)."""
    known = np.isfinite(base)
    every = known.all()
    large = (
        blur(level, _LARGE) if every else _weighted_blur(level, known.astype(np.float32), _LARGE)
    )
    sums = np.zeros((len(offsets), 5, 6))
    # At the image's border and beside steps the wide mean says nothing of a pixel's own place.
    add_products(level, large, _ALIKE, offsets, weights, sums)
    return sums


def _factors(samples: list[Array]) -> NDArray[np.float32]:
    """Return the factors of four harmonics for each kind of offset, by least squares."""
    sums = np.sum(samples, axis=0)
    factors = np.zeros((len(sums), 4), np.float32)
    for factor, products in zip(factors, sums, strict=True):
        mean = products / max(products[0, 0], 1e-30)
        central = (mean - np.outer(mean[:, 0], mean[0]))[1:, 1:]
        factor[:] = np.linalg.solve(central[:, :-1] + _RIDGE * np.eye(4), central[:, -1])
    return factors


def _relief(
    offsets: NDArray[np.float32],
    weights: NDArray[np.float32],
    known: NDArray[np.bool_],
    workers: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return the relief by both directions and by each, what is held back of it, and the rest.

    The rest is half the difference of both directions, smoothed as widely as the widest band. One
    band after the other, as they are large.
    """
    shape = known.shape
    relief, held = np.zeros((3, *shape), np.float32), np.zeros((2, *shape), np.float32)
    finer, band = np.zeros_like(offsets), np.empty_like(offsets)

    def compose(top: int, share: NDArray, agreed: NDArray) -> None:
        rows = slice(top, top + TILE_ROWS)
        part = share[rows], agreed[rows], relief[:, rows], held[:, rows]
        compose_rows(band[:, rows], *part)

    tops = range(0, shape[0], TILE_ROWS)
    means = {window: _mean(known, window) for window in set(_WINDOWS)}
    _split(offsets, weights, 0, band, finer, workers)
    for k, window in enumerate(_WINDOWS):
        _split(offsets, weights, k + 1, band, finer, workers)
        found = _agreement(band[:, ::2, ::2], means[window], _COMMON[k], _CHANCE[k] / window)
        share, agreed = (enlarged(part, shape) for part in found)
        pipeline(iter([partial(compose, share=share, agreed=agreed)]), tops, workers)
    return relief, held, (finer[1] - finer[2]) / 2


def _split(
    offsets: NDArray[np.float32],
    weights: NDArray[np.float32],
    number: int,
    band: NDArray[np.float32],
    finer: NDArray[np.float32],
    workers: int,
) -> None:
    """Put the next smoothing in the place of a finer one, and the difference into the band."""
    filter_ = blur_taps(_SIGMAS[number])

    def split(top: int) -> None:
        bottom = min(top + TILE_ROWS, offsets.shape[1])
        split_rows(offsets, weights, filter_, top, bottom, own_room(), band, finer)

    pipeline(iter([split]), range(0, offsets.shape[1], TILE_ROWS), workers)


def _weighted_blur(image: NDArray, weight: NDArray, sigma: float) -> NDArray[np.float32]:
    # Beyond the reach of any weight there is nothing to smooth.
    total = np.maximum(blur(weight, sigma), np.float32(1e-12))
    return np.asarray(blur(image * weight, sigma) / total, np.float32)


def _mean(known: NDArray[np.bool_], sigma: float) -> _Mean:
    """Return a function that averages over known pixels an image of every second pixel."""
    weight = known[::2, ::2].astype(np.float32)
    total = np.maximum(blur(weight, sigma / 2), np.float32(1e-6))
    return lambda image: blur(image * weight, sigma / 2) / total


def _mean_square(mean: _Mean, image: NDArray) -> NDArray:
    # Running sums leave less than nothing where all is zero beside something large.
    return np.maximum(mean(image**2), 0)


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
    """Return the covariance of both directions, and what undoes the measure's windows."""
    along, down = relief
    covariance = mean(along[::2, ::2] * down[::2, ::2])
    slopes = sum(
        mean(_slope(along, axis) * _slope(down, axis)) for axis in range(2) if along.shape[axis] > 1
    )
    # Below a thousandth of a frame there is no relief whose wavenumber could be told.
    wavenumber = np.where(covariance > 1e-6, slopes / np.maximum(covariance, 1e-6), 0)
    return covariance, np.exp(np.clip(_BLUR / 2 * wavenumber, 0, float(np.log(_SHARPEN))))


def _slope(image: NDArray, axis: int) -> NDArray:
    """Return the slope along an axis, from both neighbors, at every second pixel."""
    turned = np.moveaxis(image, axis, 0)[:, ::2] if axis == 0 else image[::2].T
    last = len(turned) - 1
    at = np.arange(0, last + 1, 2)
    before, after = np.maximum(at - 1, 0), np.minimum(at + 1, last)
    slope = (turned[after] - turned[before]) / (after - before).astype(np.float32)[:, None]
    return slope if axis == 0 else slope.T
