"""The optical axis of a stack: groups of averaged frames, their noise, and biases along the axis.

Frames are averaged until the peak of a focus measure is a few of them wide. All lengths along the
axis are in averaged frames further on. Frames are averaged and not their measures: a measure takes
the modulus, and averages do not remove what noise adds to that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.focus._filters import TINY, blur
from microlib.focus.multiscale._measure import abs_second_derivatives, noise_gain
from microlib.focus.multiscale._symmetry import Symmetry

#: Tiles along each side of the image from which a stack's properties are estimated, their side,
#: and the border of each that its neighbor influences, px.
_TILES, _TILE, _SEAM = 6, 48, 12


@dataclass(frozen=True)
class Axis:
    """The averaged frames along the optical axis, with properties of the whole stack.

    Attributes
    ----------
    ends : ndarray of int, shape (groups + 1,)
        Group k is the mean of the frames from ``ends[k]`` to ``ends[k + 1]``, exclusive.
    positions : ndarray, shape (n,)
        Positions of all frames, µm.
    means, spacing
        Position of each group, and their distance, µm.
    steps : ndarray, shape (groups,)
        Coordinate of each group in spacings from the first; it always rises.
    noise : float
        Standard deviation of the noise of an averaged frame, grey levels.
    drift_bias : ndarray, shape (groups,)
        Bias of a depth near each group by illumination drift, averaged frames.
    locking : float
        Largest peak-locking bias, towards the nearest averaged frame.
    symmetry : Symmetry
        Coordinate of the steps.
    shape_error : (float, float)
        Bias of a depth by the shape of the peaks, steps: constant, and between the frames.
    """

    ends: NDArray[np.intp]
    positions: Array
    means: Array
    spacing: float
    steps: Array
    noise: float
    drift_bias: Array
    locking: float
    symmetry: Symmetry
    shape_error: tuple[float, float] = (0.0, 0.0)

    def micrometers(self, steps: NDArray) -> NDArray:
        """Return positions from steps, within the stack."""
        z, (first, unit) = self.positions, self._scale()
        low, high = np.sort(self.symmetry.coordinate(z[[0, -1]])).astype(np.float32)
        u = np.clip(np.float32(first) + np.float32(unit) * steps, low, high)
        return np.clip(self.symmetry.position(u), np.float32(z.min()), np.float32(z.max()))

    def step(self, z: NDArray) -> NDArray:
        """Return the steps of positions."""
        first, unit = self._scale()
        return np.asarray((self.symmetry.coordinate(z) - first) / unit)

    def _scale(self) -> tuple[float, float]:
        """Return the coordinate of the first group, and that of one step further less this one."""
        first = group_means(self.symmetry.coordinate(self.positions), self.ends)[0]
        return float(first), float(np.sign(self.positions[-1] - self.positions[0]) * self.spacing)

    def frame(self, frames: Sequence[Image], k: int, view: tuple[slice, ...]) -> Image:
        """Return a part of the image in group k."""
        return averaged([frame[view] for frame in frames[self.ends[k] : self.ends[k + 1]]])


def averaged(frames: Sequence[Image]) -> Image:
    """Return the mean of some frames; a single one keeps its type."""
    return frames[0] if len(frames) == 1 else np.asarray(np.mean(frames, axis=0, dtype=np.float32))


def group_means(values: Array, ends: NDArray[np.intp]) -> Array:
    """Return the mean of a value of each frame over the frames of each group."""
    return np.asarray(np.add.reduceat(values, ends[:-1]) / np.diff(ends))


def tile_pixels(length: int) -> NDArray[np.intp]:
    """Return the rows, or the columns, of the tiles of an image."""
    starts = np.linspace(0, max(length - _TILE, 0), _TILES).astype(np.intp)
    return (starts[:, None] + np.arange(min(_TILE, length))).ravel()


def sample_tiles(frame: Image) -> Image:
    """Return the tiles of a frame side by side."""
    rows, cols = (tile_pixels(n) for n in frame.shape)
    return frame[rows][:, cols]


def find_axis(
    tiles: Sequence[Image], positions: Array, target: float, symmetry: Symmetry | None = None
) -> Axis:
    """Return the groups in which a stack is averaged, their noise and their biases.

    Parameters
    ----------
    tiles : sequence of ndarray
        The `sample_tiles` of each frame.
    positions : ndarray, shape (n,)
        Position of each frame, µm.
    target : float
        Equivalent width that a peak shall have in averaged frames.
    symmetry : Symmetry, optional
        Coordinate in which the groups are equally long, by default equal numbers of frames.
    """
    count, width = len(tiles), peak_width(tiles)
    groups = max(count // max(round(width / target), 1), 3)
    ends = np.arange(groups + 1) * count // groups
    spacing = float(np.median(np.abs(np.diff(group_means(positions, ends)))))
    u = positions
    if symmetry is not None:
        u = symmetry.coordinate(positions)
        if groups < count:
            group = (np.abs(u - u[0]) / spacing + 0.5).astype(int)
            starts = np.unique(group, return_index=True)[1]
            ends = np.append(starts, count) if len(starts) > 2 else ends
            groups = len(ends) - 1
    levels = np.array([float(np.mean(tile)) for tile in tiles])
    means, light, u = (group_means(values, ends) for values in (positions, levels, u))
    # Of three, so that no single frame decides, such as a black one or one that is all in focus.
    samples = (averaged(tiles[ends[k] : ends[k + 1]]) for k in (0, groups // 2, groups - 1))
    width = max(width * float(np.median(np.abs(np.diff(positions)))) / spacing, 1.7)
    return Axis(
        ends=ends,
        positions=positions,
        means=means,
        spacing=spacing,
        steps=np.abs(u - u[0]) / spacing,
        noise=float(np.median([noise_level(sample) for sample in samples])),
        # The peak of the product has a standard deviation of 0.4 of its equivalent width.
        drift_bias=illumination_drift_bias(light, min(0.4 * width, 3.0)),
        # Half a frame over the fourth power of the width: 0.4 to 0.7 on nine textures.
        locking=0.5 / width**4,
        symmetry=symmetry or Symmetry(),
    )


def peak_width(tiles: Sequence[Image]) -> float:
    """Return the equivalent width of the peaks of a stack's focus measure, in frames.

    Area of the peak over its height, both above the profile's 20th percentile: the median over the
    half of the samples that have the higher peaks. One where no peak stands out.
    """
    profiles = []
    for tile in tiles:
        # Fine detail, as coarse texture has wide peaks of its own; averaged over 2 px, so that
        # noise does not choose the highest frame.
        seconds = np.add(*abs_second_derivatives(tile, 0.8))
        profiles.append(_inner(blur(seconds, 2.0))[..., ::4, ::4].ravel())
    above = np.array(profiles)
    above -= np.percentile(above, 20, axis=0)
    height = above.max(axis=0)
    clear = (height >= np.median(height)) & (height > 0)
    return float(np.median(above.sum(axis=0)[clear] / height[clear])) if clear.any() else 1.0


def noise_level(tiles: Image) -> float:
    """Estimate the noise of a frame from its quietest twentieth, grey levels.

    No less than the rounding to whole grey levels makes, or the digits of float32.
    """
    seconds = np.add(*abs_second_derivatives(tiles, 0.5))
    quiet = float(np.percentile(_inner(blur(seconds, 3.0)), 5)) / noise_gain(0.5)
    rounding = np.sqrt(1 / 12) if tiles.dtype.kind == "u" else 0.0
    digits = 1e-5 * float(np.abs(tiles).max())
    return max(quiet, rounding, digits, float(TINY))


def _split(tiles: NDArray) -> NDArray:
    """Return tiles side by side as an array of shape (tiles, tiles, rows, cols)."""
    rows, cols = (n // _TILES for n in tiles.shape)
    return tiles.reshape(_TILES, rows, _TILES, cols).swapaxes(1, 2)


def every_other_tile(tiles: Image) -> Image:
    """Return every other tile along each side, side by side."""
    few = _split(tiles)[::2, ::2].swapaxes(1, 2)
    return np.ascontiguousarray(few).reshape([n // 2 for n in tiles.shape])


def _inner(tiles: NDArray) -> NDArray:
    """Return tiles without the borders that their neighbors influence."""
    separate = _split(tiles)
    down, along = (_SEAM if n == _TILE else 0 for n in separate.shape[2:])
    return separate[:, :, down : separate.shape[2] - down, along : separate.shape[3] - along]


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
