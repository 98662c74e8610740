"""The template's parts: do they agree about a pose, and what do they say together?"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from microlib._common import Array, Image

# What parts of the tracker are worth is in its benchmark on photographs, table "Variants".

#: Cells along each side of a template, and the least px of one; a block is 2×2 cells and overlaps
#: its neighbors by half.
_CELLS, _LEAST_CELL = 9, 4

#: Information (nats) that chance gives a block that shows something else.
_CHANCE = 0.25

#: Residual, in standard deviations of the noise, that halves a block's say.
_ODD = 3.0

#: Residual variance, in that of the noise and in that of the block, up to which a block agrees.
_AGREEING, _RELATIVE = 3.0, 0.02

#: Largest say of one block in the share of blocks that agree: its variance over that of the noise.
_LARGEST_SAY = 50.0


@dataclass(frozen=True)
class Agreement:
    """What the blocks of the template say of a pose.

    Attributes
    ----------
    score : float
        Information (nats) in which template and image agree, summed over the blocks.
    agreeing : float
        Share of the blocks, weighted by their texture over the noise, whose residual is noise.
    texture : float
        Sum of those weights.
    drift : float
        Root mean square, weighted alike, of the blocks' mean residuals about the one gain and bias
        of all, grey levels.
    """

    score: float
    agreeing: float
    texture: float
    drift: float


@lru_cache(maxsize=64)
def _members(length: int) -> Array:
    """Return the matrix, blocks×length, that sums each block of a side."""
    cells = min(_CELLS, max(2, length // _LEAST_CELL))
    ends = np.rint(np.linspace(0, length, cells + 1))
    at = np.arange(length)
    return ((at >= ends[:-2, None]) & (at < ends[2:, None])).astype(np.float64)


def agreement(grey: Image, template: Image, share: Image, noise: float) -> Agreement:
    """Compare template and image block by block; of several images, …×H×W, each by itself."""
    template = np.broadcast_to(template, grey.shape)
    wt, wg = share * template, share * grey
    each = np.stack([share, wt, wg, wt * template, wg * grey, wt * grey]).astype(np.float64)
    sums = _members(grey.shape[-2]) @ each @ _members(grey.shape[-1]).T
    sums = sums.reshape(*sums.shape[:-2], -1)
    expected = 2.0 * noise**2
    count = np.maximum(sums[0], 1e-9)
    seen = sums[0] / np.maximum(sums[0].max(axis=-1, keepdims=True), 1e-9)
    t, g, tt, gg, tg = sums[1:] / count
    tt, gg, tg = np.maximum(tt - t * t, 1e-9), np.maximum(gg - g * g, 1e-9), tg - t * g
    square = np.where(tg > 0, np.minimum(tg * tg / (tt * gg), 0.9999), 0.0)
    residual, information = gg * (1 - square), -0.5 * np.log1p(-square)
    gain = np.log(np.clip(tg / tt, 1e-2, 1e2))
    weight = np.where(information > _CHANCE, information * seen, 0.0)
    order = np.argsort(gain, axis=-1)
    total = np.cumsum(np.take_along_axis(weight, order, -1), axis=-1)
    half = (total < total[..., -1:] / 2).sum(axis=-1, keepdims=True)
    middle = np.take_along_axis(np.take_along_axis(gain, order, -1), half, -1)
    says = np.maximum(information - _CHANCE - (gain - middle) ** 2, 0)
    say = np.clip(gg / expected - 1, 0, _LARGEST_SAY) * seen
    texture = say.sum(axis=-1)
    least = np.maximum(texture, 1e-9)
    fine = residual <= _AGREEING * expected + _RELATIVE * gg
    # About the one gain and bias of all blocks together.
    n, st, sg, stt, _, stg = sums.sum(axis=-1, keepdims=True)
    n = np.maximum(n, 1e-9)
    slope = (stg - st * sg / n) / np.maximum(stt - st * st / n, 1e-9)
    off = np.where(sums[0] > 0, g - sg / n - slope * (t - st / n), 0.0)
    return Agreement(
        score=(says * seen / (1 + residual / expected / _ODD**2)).sum(axis=-1),
        agreeing=(say * fine).sum(axis=-1) / least,
        texture=texture,
        drift=np.sqrt((say * off**2).sum(axis=-1) / least),
    )
