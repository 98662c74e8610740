"""Fine relief that the smoothing removed, separated from noise; peak locking; the uncertainty.

Depths by the second derivatives along rows and down columns have nearly independent errors, so that
their covariance is that of the object, and their difference is noise. All on the grid of every
second pixel, depths in averaged frames.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib.focus.common import Band, Spread, bands, blur, ratio
from microlib.focus.multiscale._axis import Axis
from microlib.focus.multiscale._fit import fit_peaks
from microlib.focus.multiscale._fits import Fits
from microlib.focus.multiscale._maps import fill_nearest, typical
from microlib.focus.multiscale._settings import FocusSettings


class Octave(NamedTuple):
    """An octave of relief, and what noise alone has in it.

    Attributes
    ----------
    sigma : float
        That of the next coarser mean, px.
    noise_correlation, noise_scatter : float
        Correlation of the directions, and its standard deviation in `_WINDOW`.
    """

    sigma: float
    noise_correlation: float
    noise_scatter: float


_OCTAVES = (Octave(0.8, 0.07, 0.03), Octave(2.0, 0.09, 0.046), Octave(2.8, 0.1, 0.084))
#: Sigma of the window in which the directions are compared, and of the window in which the mean
#: square of their difference is the variance of the noise, px.
_WINDOW, _NOISE_WINDOW = 10.0, 20.0
#: Rows of which the relief is found at a time, and the reach of all its windows together.
_BAND, _REACH = 256, 40
#: Depths by each direction less a smoothed depth, and their common weight.
DirectionOffsets = tuple[NDArray, NDArray, NDArray]


def direction_offsets(
    depth: NDArray, fits: Fits, axis: Axis, settings: FocusSettings, spread: Spread = map
) -> DirectionOffsets:
    """Return the depths by each direction less a smoothed depth, and their common weight."""
    limit, level = settings.jump, np.nan_to_num(depth)
    near = np.isfinite(depth) & (np.abs(fits.depth - depth) < limit)

    def fitted(window: NDArray) -> tuple[NDArray, NDArray]:
        own, strength = fit_peaks(window, fits.best, axis.coordinates, near=level, within=limit)
        good = near & (strength > 0) & np.isfinite(own)
        offset = np.where(good, np.clip(own - level, -limit, limit), np.float32(0))
        return offset, np.where(good, strength, np.float32(0))

    (along, along_strength), (down, down_strength) = spread(fitted, (fits.along, fits.down))
    weight = np.sqrt(np.sqrt(along_strength * down_strength))
    weight = np.where(weight > 0, np.clip(weight / typical(weight), 0.01, 100), np.float32(0))
    return along, down, np.asarray(weight, np.float32)


def find_relief(
    along: NDArray, down: NDArray, weight: NDArray, settings: FocusSettings, spread: Spread = map
) -> tuple[NDArray, NDArray]:
    """Return the relief on which both directions agree, and half of their difference.

    Parameters
    ----------
    along, down : ndarray, shape (rows, cols)
        Depths by second derivatives of either direction, less the smoothed depth.
    weight : ndarray, shape (rows, cols)
        Weight of each pixel.
    settings : FocusSettings
        Signal-to-noise ratios from which relief is restored.
    spread : callable
        `map`, or that of a pool of threads.

    Returns
    -------
    relief, half_difference : ndarray, shape (rows, cols)
        `half_difference` is that of the two coarsest means.

    Notes
    -----
    In each octave both are h + n₁ and h + n₂ with independent noise. Then cov(h + n₁, h + n₂) is
    the variance of the relief h, and cov / var of their mean is the gain of the Wiener filter.
    """
    relief, half_difference = np.empty((2, *weight.shape), np.float32)

    def find(band: Band) -> None:
        rows = band.padded
        found = _relief_of(along[rows], down[rows], weight[rows], settings)
        for whole, part in zip((relief, half_difference), found, strict=True):
            whole[band.rows] = part[band.own]

    list(spread(find, bands(len(weight), _BAND, _REACH)))
    return relief, half_difference


def _relief_of(
    along: NDArray, down: NDArray, weight: NDArray, settings: FocusSettings
) -> tuple[NDArray, NDArray]:
    """Do the work of `find_relief` on a band of rows."""
    scale, relief = np.stack([along, down]), np.zeros((2, *weight.shape), np.float32)
    for octave in _OCTAVES:
        total = blur(weight, octave.sigma)
        mean = np.stack([ratio(blur(p * weight, octave.sigma), total) for p in (along, down)])
        a, b = scale - mean
        relief += _restored(a, b, octave, settings)
        scale = mean
    return relief.mean(axis=0) * _mtf_gain(relief, settings), np.subtract(*scale) / 2


def _restored(a: NDArray, b: NDArray, octave: Octave, settings: FocusSettings) -> NDArray:
    """Return the relief of an octave in both directions, less the noise."""
    var_a, var_b = (np.maximum(blur(f * f, _WINDOW), 0) for f in (a, b))
    cov, fourth = blur(a * b, _WINDOW), np.maximum(blur((a * b) ** 2, _WINDOW), 0)
    # Noise alone has a small covariance, too; its scatter rises where few pixels make it.
    deviations = np.sqrt(var_a * var_b)
    scatter = octave.noise_scatter * np.maximum(deviations, np.sqrt(fourth))
    snr = ratio(cov - octave.noise_correlation * deviations, scatter)
    significant = (snr - settings.snr_low) / (settings.snr_high - settings.snr_low)
    var_mean = (var_a + var_b + 2 * cov) / 4
    gain = np.clip(ratio(cov, var_mean), 0, 1) * np.clip(significant, 0, 1)
    return np.asarray(gain * np.stack([a, b]))


def _mtf_gain(relief: NDArray, settings: FocusSettings) -> NDArray[np.float32]:
    """Return the factor, at most 3, that compensates for the attenuation by a measure's windows.

    They attenuate relief as a Gaussian does, by exp(−c k²) for the mean square wavenumber k², which
    is the mean square of the slope over that of the relief.
    """
    power = blur(relief[0] * relief[1], 4.0)
    slope = blur(sum(part[0] * part[1] for part in np.gradient(relief, axis=(1, 2))), 4.0)
    exponent = settings.mtf_correction * ratio(slope, power)
    return np.exp(np.clip(exponent, 0, np.log(3)), dtype=np.float32)


def locking_attenuation(depth: NDArray) -> NDArray[np.float32]:
    """Return the factor by which averaging on a slope attenuates peak locking, 0 to 1.

    On a slope of s frames per px the bias is a wave of s periods per px. A Gaussian average, of
    σ = 5 px for the measures and the smoothing together, leaves exp(−(2π s σ)²/2) of it.
    """
    return np.exp(np.float32(-((2 * np.pi * 5) ** 2) / 2) * _squared_slope(depth))


def _squared_slope(depth: NDArray) -> NDArray:
    """Return the square of the slope, frames per px of the full grid."""
    dy, dx = np.gradient(blur(fill_nearest(depth), 1.0))
    return np.asarray((dx * dx + dy * dy) / 4)


def error_variance(
    depth: NDArray, half_difference: NDArray, disagreement: NDArray, settings: FocusSettings
) -> NDArray:
    """Return the mean square error of a depth by noise, slopes, steps and sharp bends.

    Parameters
    ----------
    depth : ndarray, shape (rows, cols)
        The depth; NaN where unknown.
    half_difference : ndarray, shape (rows, cols)
        Half the difference of two independent depths, after the mean of the coarsest octave.
    disagreement : ndarray, shape (rows, cols)
        Distance of the depths by the product and by the edge measure.
    settings : FocusSettings
        Settings of the smoothing and of the stated errors.

    Returns
    -------
    ndarray, shape (rows, cols)
        Variance, frames².
    """
    high = 2 * settings.jump
    variance = np.maximum(blur(half_difference**2, _NOISE_WINDOW), 0)
    # Texture moves a depth along a slope.
    variance += settings.slope_error**2 * _squared_slope(depth)
    full = fill_nearest(depth)
    height = step_height(full)
    beside = cv2.dilate(height, np.ones((5, 5), np.uint8))
    # The smoothing may mix both sides of a low step. Beside a high one the error is the
    # disagreement, or its square if that is less: on drawn texture 0.03 frames at a disagreement of
    # 0.2, on photographs 1.0 at 1.2.
    local = blur(np.minimum(disagreement, 6), 2.0)
    variance += (
        np.where(beside < high, settings.low_step_error * beside, np.minimum(local, local * local))
        ** 2
    )
    # At a high step a pixel may lie anywhere between both sides: the standard deviation of a
    # uniform distribution. Measured are 0.2 to 0.3 of the height on drawn texture, 0.5 where the
    # near side hides the far one, and 0.5 to 0.8 on photographs.
    variance += np.where(height >= high, height, 0) ** 2 / 12
    # At a sharp bend, such as the tip of a cone.
    bent = (full - blur(full, settings.smoothing_sigma)) ** 2
    bent[cv2.dilate(height, np.ones((15, 15), np.uint8)) >= high] = 0
    return np.asarray(
        variance + settings.bend_error**2 * np.maximum(blur(bent, 2.0), 0), np.float32
    )


def step_height(depth: NDArray) -> NDArray:
    """Return the height of a step at each pixel, about 0 on a slope.

    A plane rises three times as far over 7 px as over 3, a step as far.
    """
    return np.asarray(1.5 * depth_range(depth, 3) - 0.5 * depth_range(depth, 7))


def depth_range(depth: NDArray, side: int) -> NDArray:
    """Return the range of depths in a square."""
    square = np.ones((side, side), np.uint8)
    return np.asarray(cv2.dilate(depth, square) - cv2.erode(depth, square))
