"""How many frames is a peak wide? So many are averaged that it has the width the default expects.

All lengths along the axis are in averaged frames further on. Frames are averaged and not their
measures: a measure takes the modulus, and what noise adds to that no average takes away again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.focus._measures import TINY, absolute_seconds, blur, noise_gain

#: Squares along each side of the image that a stack is looked at in first, their side and the
#: border of each that its neighbor in the mosaic reaches into, px.
_SQUARES, _SQUARE, _SEAM = 6, 48, 12


@dataclass(frozen=True)
class Axis:
    """The averaged frames along the optical axis, and what is known of the whole stack.

    Attributes
    ----------
    ends : ndarray of int, shape (groups + 1,)
        Group k is the mean of the frames from ``ends[k]`` to ``ends[k + 1]``, exclusive.
    positions : ndarray, shape (n,)
        Positions of all frames, µm.
    means, spacing
        Position of each group, and their distance, µm.
    steps : ndarray, shape (groups,)
        Position of each group in spacings from the first; it always rises.
    noise : float
        Noise of an averaged frame, grey levels.
    light : ndarray, shape (groups,)
        How far changes of the light pull a depth near each group, averaged frames.
    pull : float
        How far the groups themselves pull the depths between them, at most.
    bias : (float, float)
        Slope and value at 0 µm of what asymmetric peaks add to a depth, µm.
    typical : float, optional
        Strength of a typical peak, where not all of the image is at hand.
    """

    ends: NDArray[np.intp]
    positions: Array
    means: Array
    spacing: float
    steps: Array
    noise: float
    light: Array
    pull: float
    bias: tuple[float, float] = (0.0, 0.0)
    typical: float | None = None

    def micrometers(self, steps: NDArray) -> NDArray:
        """Return positions from steps, within the stack."""
        z = self.positions
        way = np.float32(np.sign(z[-1] - z[0]) * self.spacing)
        low, high = np.float32(z.min()), np.float32(z.max())
        return np.clip(np.float32(self.means[0]) + way * steps, low, high)

    def frame(self, frames: Sequence[Image], k: int, view: tuple[slice, ...]) -> Image:
        """Return what group k shows of a part of the image."""
        return averaged([frame[view] for frame in frames[self.ends[k] : self.ends[k + 1]]])


def averaged(frames: Sequence[Image]) -> Image:
    """Return the mean of some frames, of which a single one keeps its type."""
    return frames[0] if len(frames) == 1 else np.asarray(np.mean(frames, axis=0, dtype=np.float32))


def sampled(length: int) -> NDArray[np.intp]:
    """Return the rows, or the columns, of the squares that a stack is looked at in first."""
    starts = np.linspace(0, max(length - _SQUARE, 0), _SQUARES).astype(np.intp)
    return (starts[:, None] + np.arange(min(_SQUARE, length))).ravel()


def mosaic(frame: Image) -> Image:
    """Return the squares of a frame side by side."""
    return frame[np.ix_(*(sampled(n) for n in frame.shape))]


def find_axis(mosaics: Sequence[Image], positions: Array, target: float) -> Axis:
    """Return how a stack is to be averaged, and its noise.

    Parameters
    ----------
    mosaics : sequence of ndarray
        The `mosaic` of each frame.
    positions : ndarray, shape (n,)
        Position of each frame, µm.
    target : float
        Equivalent width that a peak shall have in averaged frames.
    """
    count, width = len(mosaics), peak_width(mosaics)
    groups = max(count // max(round(width / target), 1), 3)
    ends = np.arange(groups + 1) * count // groups
    levels = np.array([float(np.mean(mosaic)) for mosaic in mosaics])
    means, light = (np.add.reduceat(v, ends[:-1]) / np.diff(ends) for v in (positions, levels))
    spacing = float(np.median(np.abs(np.diff(means))))
    steps = np.abs(means - means[0]) / spacing
    # Of three, so that no single frame decides, such as a black one or one that is all in focus.
    looked_at = (averaged(mosaics[ends[k] : ends[k + 1]]) for k in (0, groups // 2, groups - 1))
    noise = float(np.median([noise_level(mosaic) for mosaic in looked_at]))
    width = max(width * groups / count, 1.7)
    # The default's peak has a standard deviation of 0.4 of its equivalent width. Frames pull half a
    # frame over the fourth power of the width: 0.4 to 0.7 on nine textures, drawn and photographed.
    pulled = light_pull(light, min(0.4 * width, 3.0))
    return Axis(ends, positions, means, spacing, steps, noise, pulled, 0.5 / width**4)


def peak_width(mosaics: Sequence[Image]) -> float:
    """Return the width of the peaks of a stack's focus measure, in frames.

    Area of the peak over its height, both above the profile's 20th percentile: the median over the
    half of the samples that have the higher peaks. One where no peak stands out.
    """
    profiles = []
    for mosaic in mosaics:
        # Fine detail, as coarse texture has wide peaks of its own; averaged over 2 px, so that
        # noise does not choose the highest frame.
        seconds = np.add(*absolute_seconds(mosaic.astype(np.float32), 0.8))
        profiles.append(_inner(blur(seconds, 2.0))[..., ::4, ::4].ravel())
    above = np.array(profiles) - np.percentile(profiles, 20, axis=0)
    height = above.max(axis=0)
    clear = (height >= np.median(height)) & (height > 0)
    return float(np.median(above.sum(axis=0)[clear] / height[clear])) if clear.any() else 1.0


def noise_level(mosaic: Image) -> float:
    """Estimate the noise of a frame from its quietest twentieth, grey levels.

    No less than what rounding to whole grey levels makes, or the digits of float32.
    """
    seconds = np.add(*absolute_seconds(mosaic.astype(np.float32), 0.5))
    quiet = float(np.percentile(_inner(blur(seconds, 3.0)), 5)) / noise_gain(0.5)
    rounding = np.sqrt(1 / 12) if mosaic.dtype.kind == "u" else 0.0
    digits = 1e-5 * float(np.abs(mosaic).max())
    return max(quiet, rounding, digits, float(TINY))


def every_other(mosaic: Image) -> Image:
    """Return a mosaic of every other square along each side."""
    rows, cols = (n // _SQUARES for n in mosaic.shape)
    squares = mosaic.reshape(_SQUARES, rows, _SQUARES, cols)[::2, :, ::2]
    return np.ascontiguousarray(squares).reshape(3 * rows, 3 * cols)


def _inner(mosaic: NDArray) -> NDArray:
    """Return the squares of a mosaic without the borders that their neighbors reach into."""
    rows, cols = (n // _SQUARES for n in mosaic.shape)
    squares = mosaic.reshape(_SQUARES, rows, _SQUARES, cols).swapaxes(1, 2)
    down, along = (_SEAM if n == _SQUARE else 0 for n in (rows, cols))
    return squares[:, :, down : rows - down, along : cols - along]


def light_pull(light: Array, deviation: float) -> Array:
    """Return how far changes of the light pull the depth of something in focus at each frame.

    A measure that grows with the light's square, as a product of two, leans towards the brighter
    frames. To a peak of `deviation` frames the logarithm of the light adds a slope, found here over
    five frames, and its vertex moves by the slope times the deviation's square.

    Parameters
    ----------
    light : ndarray, shape (n,)
        Mean grey level of each frame. Where it is not positive it tells nothing, and the pull is 0.
    deviation : float
        Of the peak, frames.

    Returns
    -------
    ndarray, shape (n,)
        Root mean square of the pull around each frame, frames.
    """
    if not (light > 0).all():
        return np.zeros(len(light))
    mean = np.array([1, 2, 1]) / 4
    level = np.convolve(2 * np.log(np.pad(light, 3, mode="edge")), mean, mode="valid")
    pull = deviation**2 * np.gradient(level)[1:-1]
    return np.sqrt(np.convolve(pull**2, mean, mode="valid"))
