"""Tiles of an image, from which properties of the whole stack are estimated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from microlib._common import Image
from microlib.focus.common import TINY, Frame, Spread, blur
from microlib.focus.multiscale._measure import abs_second_derivatives, noise_gain

#: Tiles along each side of the image, their side, and the border of each that its neighbor
#: influences, px.
_TILES, _TILE, _SEAM = 6, 48, 12


def sample_tiles(frame: Frame) -> Image:
    """Return the tiles of a frame side by side."""
    starts = [np.linspace(0, max(n - _TILE, 0), _TILES).astype(np.intp) for n in frame.shape]
    columns = (starts[1][:, None] + np.arange(min(_TILE, frame.shape[1]))).ravel()
    return np.concatenate([frame[top : top + _TILE][:, columns] for top in starts[0]])


def every_other_tile(tiles: Image) -> Image:
    """Return every other tile along each side, side by side."""
    few = _split(tiles)[::2, ::2].swapaxes(1, 2)
    return np.ascontiguousarray(few).reshape([n // 2 for n in tiles.shape])


def peak_width(tiles: Sequence[Image], spread: Spread = map) -> float:
    """Return the equivalent width of the peaks of a stack's focus measure, in frames.

    Area of the peak over its height, both above the profile's 20th percentile: the median over the
    samples, weighted by the heights of their peaks. Ground without texture, whose peaks are low and
    wide, does not count. One where no peak stands out.
    """
    above = np.array(list(spread(_fine_detail, tiles)))
    above -= np.percentile(above, 20, axis=0)
    height = above.max(axis=0)
    clear = height > 0.1 * np.percentile(height, 99)
    if not clear.any():
        return 1.0
    width, weight = above.sum(axis=0)[clear] / height[clear], height[clear]
    order = np.argsort(width)
    share = np.cumsum(weight[order])
    return float(width[order][np.searchsorted(share, share[-1] / 2)])


def _fine_detail(tiles: Image) -> NDArray[np.float32]:
    """Return second derivatives at every fourth pixel; coarse texture has wide peaks of its own.

    They are averaged over 2 px, so that noise does not choose the highest frame.
    """
    seconds = np.add(*abs_second_derivatives(tiles, 0.8))
    return np.asarray(_inner(blur(seconds, 2.0))[..., ::4, ::4].ravel())


def noise_level(tiles: Image) -> float:
    """Return the noise of a frame from its quietest twentieth, grey levels.

    It is no less than the rounding of grey levels makes, or the digits of float32. The filter
    is nearly that of the focus measures: `image_noise` sees less of noise that is correlated over
    pixels, and with it 2.2 % of the bare board of benchmarks/real.py are off by more than a frame
    or unknown, instead of 1.8 %.
    """
    seconds = np.add(*abs_second_derivatives(tiles, 0.5))
    quiet = float(np.percentile(_inner(blur(seconds, 3.0)), 5)) / noise_gain(0.5)
    digits = 1e-5 * float(np.abs(tiles).max())
    return max(quiet, grey_step(tiles) / np.sqrt(12), digits, float(TINY))


def grey_step(tiles: Image) -> float:
    """Return the least difference of grey levels, to which they are rounded; 0 if all are equal."""
    levels = np.unique(tiles).astype(np.float64)
    return float(np.diff(levels).min()) if len(levels) > 1 else 0.0


def _split(tiles: NDArray) -> NDArray:
    """Return tiles side by side as an array of shape (tiles, tiles, rows, cols)."""
    rows, cols = (n // _TILES for n in tiles.shape)
    return tiles.reshape(_TILES, rows, _TILES, cols).swapaxes(1, 2)


def _inner(tiles: NDArray) -> NDArray:
    """Return tiles without the borders that their neighbors influence."""
    separate = _split(tiles)
    down, along = (_SEAM if n == _TILE else 0 for n in separate.shape[2:])
    return separate[:, :, down : separate.shape[2] - down, along : separate.shape[3] - along]
