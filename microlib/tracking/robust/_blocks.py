"""The template's parts: do they agree about a pose, and what do they say together?

A block is a rectangle of 2×2 cells and overlaps its neighbors by half.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from microlib._common import Array, Image
from microlib.tracking._geometry import TINY

#: Information (nats) that chance gives a block that shows something else.
_CHANCE = 0.25

#: Largest say of one block in the share of blocks that agree: its variance over that of the noise.
_LARGEST_SAY = 50.0


@dataclass(frozen=True, eq=False)
class Agreement:
    """How far the blocks of the template agree about a pose.

    Attributes
    ----------
    agreeing : float
        Share of the blocks, weighted by their texture over the noise, whose residual is noise.
    texture : float
        Sum of those weights.
    residual : float
        Root mean square, weighted alike, of the blocks' mean residuals about the one gain and bias
        of all, grey levels.
    """

    agreeing: float
    texture: float
    residual: float


@dataclass(frozen=True, eq=False)
class Blocks:
    """Means and (co)variances of template t and image g in K blocks of one or more patches, …×K.

    `count` is the number of pixels that count, `seen` that number over the largest of them, `rest`
    the variance of the image that is not linear in the template, and `noise` the variance of the
    difference of two images of the same.
    """

    count: Array
    seen: Array
    t: Array
    g: Array
    tt: Array
    gg: Array
    tg: Array
    square: Array
    noise: float

    @property
    def rest(self) -> Array:
        return self.gg * (1 - self.square)

    def score(self) -> float:
        """Return the information (nats) in which template and image agree, summed over the blocks.

        A block with the correlation ρ and the gain a says −½ ln(1 − ρ²) − ¼ − (Δ ln a)², if that is
        positive, and less if its residual exceeds the noise; Δ is to the middle of all blocks.
        """
        information = -0.5 * np.log1p(-self.square)
        gain = np.log(np.maximum(self.tg, TINY) / self.tt)
        weight = np.where(information > _CHANCE, information * self.seen, 0.0)
        off = gain - _weighted_median(gain, weight)
        says = np.maximum(information - _CHANCE - off**2, 0)
        return float((says * self.seen / (1 + self.rest / self.noise / 3**2)).sum())

    def agreement(self) -> Agreement:
        """Return how far the blocks of one patch agree."""
        say = np.clip(self.gg / self.noise - 1, 0, _LARGEST_SAY) * self.seen
        texture = say.sum()
        weight = say / max(texture, TINY)
        # Interpolation leaves 2 % of a block's variance.
        fine = self.rest <= 3 * self.noise + 0.02 * self.gg
        # About the one gain and bias of all blocks together.
        share = self.count / max(self.count.sum(), TINY)
        t, g = self.t - share @ self.t, self.g - share @ self.g
        slope = share @ (self.tg + t * g) / max(share @ (self.tt + t * t), TINY)
        off = np.where(self.count > 0, g - slope * t, 0.0)
        return Agreement(float(weight @ fine), float(texture), float(np.sqrt(weight @ off**2)))


def compare(grey: Image, template: Image, share: Image, noise: float) -> Blocks:
    """Compare template and image block by block; of several images, …×H×W, each by itself.

    `share` says how far each pixel counts, and `noise` is its standard deviation.
    """
    template = np.broadcast_to(template, grey.shape)
    wt, wg = share * template, share * grey
    products = np.stack([share, wt, wg, wt * template, wg * grey, wt * grey]).astype(np.float64)
    sums = _members(grey.shape[-2]) @ products @ _members(grey.shape[-1]).T
    sums = sums.reshape(*sums.shape[:-2], -1)
    count = sums[0]
    t, g, tt, gg, tg = sums[1:] / np.maximum(count, TINY)
    tt, gg, tg = np.maximum(tt - t * t, TINY), np.maximum(gg - g * g, TINY), tg - t * g
    return Blocks(
        count=count,
        seen=count / np.maximum(count.max(axis=-1, keepdims=True), TINY),
        t=t,
        g=g,
        tt=tt,
        gg=gg,
        tg=tg,
        square=np.where(tg > 0, np.minimum(tg * tg / (tt * gg), 0.9999), 0.0),
        noise=2.0 * noise**2,
    )


@lru_cache(maxsize=64)
def _members(length: int) -> Array:
    """Return the matrix, blocks×length, that sums each block of a side: 8, or of 8 px at least."""
    ends = np.rint(np.linspace(0, length, min(8, max(1, length // 4 - 1)) + 2))
    at = np.arange(length)
    return ((at >= ends[:-2, None]) & (at < ends[2:, None])).astype(np.float64)


def _weighted_median(values: Array, weights: Array) -> Array:
    """Return the weighted median along the last axis, which stays with a length of 1."""
    order = np.argsort(values, axis=-1)
    total = np.cumsum(np.take_along_axis(weights, order, -1), axis=-1)
    half = (total < total[..., -1:] / 2).sum(axis=-1, keepdims=True)
    return np.take_along_axis(np.take_along_axis(values, order, -1), half, -1)
