"""Correlation of the blocks of a template with those of an image, and their agreement on a pose.

A block is a rectangle of 2×2 cells and overlaps its neighbors by half.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.tracking._geometry import TINY
from microlib.tracking._settings import TrackerSettings


@dataclass(frozen=True, eq=False)
class Blocks:
    """Means and (co)variances of template t and image g in K blocks of a patch, K.

    `count` is the sum of the weights of the pixels, `visible` is `count` divided by the largest
    `count`, `square` the squared correlation, `unexplained` the variance of the image that is not
    linear in the template, and `noise_variance` the variance of the difference of two images of the
    same.
    """

    count: Array
    visible: Array
    t: Array
    g: Array
    tt: Array
    gg: Array
    tg: Array
    square: Array
    noise_variance: float
    settings: TrackerSettings

    @property
    def unexplained(self) -> Array:
        return self.gg * (1 - self.square)

    def score(self) -> float:
        """Return the information (nats) in which template and image agree, of all blocks."""
        return float(self.scores().sum())

    def excess_in(self, other: Blocks) -> float:
        """Return the gain in information (nats) at another pose, summed over blocks with a gain."""
        return float(np.maximum(other.scores() - self.scores(), 0).sum())

    def scores(self) -> Array:
        """Return the information (nats) in which each block of the template agrees with the image.

        A block with the correlation ρ and the gain a has −½ ln(1 − ρ²) − ¼ − (Δ ln a)², if that is
        positive, times its visible share, divided by 1 + u/9e. Δ is to the median of all blocks, u
        is the variance that the template does not explain, and e the one that is expected of noise
        and interpolation.
        """
        unrelated = self.settings.unrelated_information
        information = -0.5 * np.log1p(-self.square)
        gain = np.log(np.maximum(self.tg, TINY) / self.tt)
        weight = np.where(information > unrelated, information * self.visible, 0.0)
        off = gain - _weighted_median(gain, weight)
        score = np.maximum(information - unrelated - off**2, 0)
        expected = self.noise_variance + self.settings.interpolation_error * self.gg
        return np.asarray(score * self.visible / (1 + self.unexplained / expected / 3**2))

    @cached_property
    def texture(self) -> Array:
        """Variance of the image over that of the noise, minus 1, in the visible part of a block."""
        most = self.settings.max_block_weight
        return np.clip(self.gg / self.noise_variance - 1, 0, most) * self.visible

    def agree(self) -> bool:
        """Return whether all blocks agree, by their texture, and have enough texture for that."""
        # Interpolation leaves at most 2 % of a block's variance.
        is_noise = self.unexplained <= 3 * self.noise_variance + 0.02 * self.gg
        texture, total = self.texture, float(self.texture.sum())
        most = texture @ is_noise >= self.settings.min_agreement * total
        return bool(most and total >= self.settings.min_texture)

    def residual_of_means(self) -> float:
        """Return the residual of the blocks' means about one gain and bias of all blocks.

        It is a root mean square in grey levels, weighted by the texture.
        """
        share = self.count / max(self.count.sum(), TINY)
        t, g = self.t - share @ self.t, self.g - share @ self.g
        slope = share @ (self.tg + t * g) / max(share @ (self.tt + t * t), TINY)
        residual = np.where(self.count > 0, g - slope * t, 0.0)
        weight = self.texture / max(self.texture.sum(), TINY)
        return float(np.sqrt(weight @ residual**2))


def compare(
    grey: Image, template: Image, weight: Image, noise: float, settings: TrackerSettings
) -> Blocks:
    """Compare template and image, H×W, block by block.

    `weight` is that of the pixels, and `noise` the standard deviation of their noise.
    """
    wt, wg = weight * template, weight * grey
    products = np.stack([weight, wt, wg, wt * template, wg * grey, wt * grey])
    rows, columns = (_cells(side) for side in grey.shape)
    cells = np.add.reduceat(products, columns, axis=2, dtype=np.float64)
    cells = np.add.reduceat(cells, rows, axis=1)
    pairs = cells[:, 1:] + cells[:, :-1]
    count, *others = (pairs[:, :, 1:] + pairs[:, :, :-1]).reshape(len(products), -1)
    t, g, tt, gg, tg = others / np.maximum(count, TINY)
    tt, gg, tg = np.maximum(tt - t * t, TINY), np.maximum(gg - g * g, TINY), tg - t * g
    return Blocks(
        count=count,
        visible=count / max(count.max(), TINY),
        t=t,
        g=g,
        tt=tt,
        gg=gg,
        tg=tg,
        square=np.where(tg > 0, np.minimum(tg * tg / (tt * gg), 0.9999), 0.0),
        noise_variance=2.0 * noise**2,
        settings=settings,
    )


@lru_cache(maxsize=64)
def _cells(length: int) -> NDArray[np.intp]:
    """Return where the cells of a side begin: 9 cells, or fewer of at least 4 px."""
    blocks = min(8, max(1, length // 4 - 1))
    return np.rint(np.linspace(0, length, blocks + 2)[:-1]).astype(np.intp)


def _weighted_median(values: Array, weights: Array) -> float:
    """Return the weighted median."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.count_nonzero(total < total[-1] / 2)])
