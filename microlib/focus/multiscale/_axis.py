"""The optical axis of a stack: groups of averaged frames, their noise, and biases along the axis.

Frames are averaged until the peak of a focus measure is a few of them wide. All lengths along the
axis are in averaged frames further on. Frames are averaged and not their measures: a measure takes
the modulus, and averages do not remove what noise adds to that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.focus.common import Frame, Spread, halved, peak_centers, shape_error
from microlib.focus.multiscale._fit import fit_peaks
from microlib.focus.multiscale._profiles import find_profiles
from microlib.focus.multiscale._settings import FocusSettings
from microlib.focus.multiscale._tiles import (
    every_other_tile,
    grey_step,
    noise_level,
    peak_width,
    sample_tiles,
)


@dataclass(frozen=True)
class Axis:
    """The averaged frames along the optical axis, with properties of the whole stack.

    Attributes
    ----------
    ends : ndarray of int, shape (groups + 1,)
        Group k is the mean of the frames from ``ends[k]`` to ``ends[k + 1]``, exclusive.
    positions : ndarray, shape (n,)
        Positions of all frames, µm.
    spacing : float
        Distance of the groups, µm.
    coordinates : ndarray, shape (groups,)
        Frame coordinate of each group: its distance from the first, in spacings. It always rises.
    noise : float
        Standard deviation of the noise of an averaged frame, grey levels.
    rounding : float
        Standard deviation that rounding adds to less noise than half a step of the grey levels.
    drift_bias : ndarray, shape (groups,)
        Bias of a depth near each group by illumination drift, averaged frames.
    locking : float
        Largest peak-locking bias, towards the nearest averaged frame.
    shape_error : float
        Bias of a depth by the shape of the peaks, averaged frames.
    """

    ends: NDArray[np.intp]
    positions: Array
    spacing: float
    coordinates: Array
    noise: float
    rounding: float
    drift_bias: Array
    locking: float
    shape_error: float

    def micrometers(self, coordinates: NDArray) -> NDArray:
        """Return the positions of frame coordinates, within the stack."""
        z = self.positions
        first, unit = group_means(z, self.ends)[0], np.sign(z[-1] - z[0]) * self.spacing
        found = np.float32(first) + np.float32(unit) * coordinates
        return np.clip(found, np.float32(z.min()), np.float32(z.max()))

    def averaged_frames(
        self, frames: Sequence[Frame], rows: slice = slice(None)
    ) -> Iterator[Image]:
        """Yield some rows of the averaged frames."""
        for start, end in pairwise(self.ends):
            yield averaged([frame[rows] for frame in frames[start:end]])


def averaged(frames: Sequence[Image]) -> Image:
    """Return the mean of some frames; a single one keeps its type."""
    if len(frames) == 1:
        return frames[0]
    return np.asarray(np.mean(frames, axis=0, dtype=np.float32))


def group_means(values: Array, ends: NDArray[np.intp]) -> Array:
    """Return the mean of a value of each frame over the frames of each group."""
    return np.asarray(np.add.reduceat(values, ends[:-1]) / np.diff(ends))


def describe_axis(
    frames: Sequence[Frame], positions: Array, settings: FocusSettings, spread: Spread = map
) -> Axis:
    """Return the groups in which the frames of a stack are averaged, their noise and their biases.

    Parameters
    ----------
    frames : sequence of ndarray, shape (rows, cols)
        All frames.
    positions : ndarray, shape (n,)
        Position of each frame, µm.
    settings : FocusSettings
        Settings of the measures, and the width that a peak shall have.
    spread : callable
        `map`, or that of a pool of threads.
    """
    tiles = list(spread(sample_tiles, frames))
    few = [every_other_tile(tile) for tile in tiles]
    count, width = len(frames), peak_width(tiles, spread)
    fewer = max(count // max(round(width / settings.width), 1), 3)
    ends = np.arange(fewer + 1) * count // fewer
    first, *_ = middles = group_means(positions, ends)
    spacing, way = float(np.median(np.abs(np.diff(middles)))), np.sign(positions[-1] - positions[0])
    single = _noise(tiles, np.arange(count + 1))  # noise of single frames
    profiles = find_profiles(few, count, few[0].shape, single, settings).product
    blocks = np.stack([halved(image) for image in profiles.profiles(slice(None))])
    center = way * (peak_centers(blocks, positions)[1] - first) / spacing
    coordinates = way * (middles - first) / spacing
    noise = _noise(tiles, ends)
    if fewer < count:
        means = (averaged(few[start:end]) for start, end in pairwise(ends))
        profiles = find_profiles(means, fewer, few[0].shape, noise, settings).product
    light = group_means(np.array([float(np.mean(tile)) for tile in tiles]), ends)
    width = max(width * float(np.median(np.abs(np.diff(positions)))) / spacing, 1.7)
    locking = 0.5 / width**4  # half a frame over the fourth power: 0.4 to 0.7 on nine textures
    depth, _ = fit_peaks(profiles.windows()[0], profiles.best, coordinates)
    depth -= peak_locking_bias(depth, coordinates, locking)
    return Axis(
        ends=ends,
        positions=positions,
        spacing=spacing,
        coordinates=coordinates,
        noise=noise,
        rounding=np.sqrt(max((grey_step(tiles[count // 2]) / 2) ** 2 - single**2, 0)),
        # The peak of the product has a standard deviation of 0.4 of its equivalent width.
        drift_bias=illumination_drift_bias(light, min(0.4 * width, 3.0)),
        locking=locking,
        shape_error=shape_error(halved(depth), center),
    )


def _noise(tiles: Sequence[Image], ends: NDArray[np.intp]) -> float:
    """Return the noise of averaged frames: the median of the first, the middle and the last.

    No single frame decides, such as a black one, or one that is all in focus.
    """
    numbers = (0, (len(ends) - 1) // 2, len(ends) - 2)
    return float(np.median([noise_level(averaged(tiles[ends[k] : ends[k + 1]])) for k in numbers]))


def peak_locking_bias(depth: NDArray, coordinates: Array, largest: float) -> NDArray[np.float32]:
    """Return the bias of depths towards the nearest averaged frame, averaged frames.

    A real profile is more pointed than a Gaussian, so that its fit is biased towards the nearest
    frame, and the more so the narrower the peaks.

    Parameters
    ----------
    depth : ndarray, shape (rows, cols)
        Frame coordinates; NaN where unknown.
    coordinates : ndarray, shape (groups,)
        Frame coordinate of each averaged frame.
    largest : float
        Largest bias.
    """
    number = np.interp(np.nan_to_num(depth), coordinates, np.arange(len(coordinates)))
    return np.float32(-largest) * np.sin(np.float32(2 * np.pi) * number.astype(np.float32))


def illumination_drift_bias(light: Array, deviation: float) -> Array:
    """Return the bias of a depth near each frame by changes of the illumination.

    The measure, a product of two, grows with the square of the illumination, so that its peak is
    shifted towards the brighter frames. To a Gaussian of standard deviation s the logarithm of the
    illumination adds a slope, found here over five frames, and its vertex moves by s² times it.

    Parameters
    ----------
    light : ndarray, shape (n,)
        Mean grey level of each frame. Where one is not positive, the bias is 0.
    deviation : float
        Standard deviation of the peak, frames.

    Returns
    -------
    ndarray, shape (n,)
        Root mean square of the bias around each frame, frames.
    """
    if not (light > 0).all():
        return np.zeros(len(light))
    mean = np.array([1, 2, 1]) / 4
    level = np.convolve(2 * np.log(np.pad(light, 3, mode="edge")), mean, mode="valid")
    bias = deviation**2 * np.gradient(level)[1:-1]
    return np.sqrt(np.convolve(bias**2, mean, mode="valid"))
