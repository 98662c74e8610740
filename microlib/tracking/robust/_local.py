"""Alignment in local illumination: around each pixel the light has a gain and a bias of its own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, Image
from microlib.tracking._esm import LEAST_VISIBLE, Level, make_level
from microlib.tracking._geometry import TINY, degenerate, retract
from microlib.tracking._sampling import View
from microlib.tracking.robust._blocks import Blocks, compare

#: Standard deviation (px of the finest level of the search) of the surroundings in which gain and
#: bias count as constant. With twice as much no more is found; the glare asks for little.
LOCAL_WINDOW = 3.5

#: Where Tukey's biweight ends, in standard deviations: 95 % efficient for normal noise.
TUKEY = 4.685

#: Standard deviation of a normal variable over the mean of its size.
NORMAL_MEAN = 1.25

#: Standard deviation of a normal variable over the median of its size.
NORMAL = 1.4826


@dataclass(frozen=True, eq=False)
class LocalLight:
    """Gain and bias around each pixel, what they leave, and the (co)variances there."""

    residual: Image
    gain: Image
    correlation: Image
    tt: Image
    gg: Image
    tg: Image


@dataclass(frozen=True, eq=False)
class LocalLevel(Level):
    """A template at one resolution, for alignment in local illumination.

    Attributes
    ----------
    halvings : int
        How often the frame was halved.
    wide : tuple of ndarray
        Matrices that sum the surroundings in which the light is constant, down and across.
    """

    halvings: int
    wide: tuple[Image, Image]

    def fit_light(self, grey: Image, share: Image, floor: float) -> LocalLight:
        """Fit ``grey = gain·template + bias`` around each pixel of images, …×H×W.

        `floor` is the variance of the noise, which keeps what is flat from correlating by chance.
        """
        down, across = self.wide
        wt, wg = share * self.grey, share * grey
        sums = down @ np.stack([share, wt, wg, wt * self.grey, wg * grey, wt * grey]) @ across
        t, g, tt, gg, tg = sums[1:] / np.maximum(sums[0], np.float32(TINY))
        tt = np.maximum(tt - t * t, 0) + np.float32(floor)
        gg = np.maximum(gg - g * g, 0) + np.float32(floor)
        tg = tg - t * g
        gain = np.clip(tg / tt, np.float32(0.1), np.float32(10))
        residual = grey - g - gain * (self.grey - t)
        return LocalLight(residual, gain, tg / np.sqrt(tt * gg), tt, gg, tg)

    def align_locally(
        self,
        view: View,
        poses: ArrayLike,
        *,
        tolerance: float = 0.1,
        iterations: int = 10,
    ) -> list[Array]:
        """Return the poses, B×3×3, at which template and frame agree best in local illumination.

        All are aligned at once; those that diverge are left out.
        """
        poses = np.array(poses, np.float64).reshape(-1, 3, 3)
        first = corners = self.corners_of(poses)
        held, going = np.ones(len(poses), bool), np.arange(len(poses))
        for _ in range(iterations):
            if not going.size:
                break
            patches = self.patch(view.layer(self.halvings), poses[going], view.saturation)
            step, seen = self._step(*patches, view.noise * self.noise)
            poses[going] = retract(poses[going], step, self.basis)
            after = self.corners_of(poses)
            held[going] = seen & ~degenerate(after[going], first[going])
            way, corners = np.abs(after - corners).max(axis=(1, 2)), after
            going = going[held[going] & (way[going] >= tolerance)]
        return list(poses[held])

    def _step(
        self, grey: Image, slope: Image, share: Image, noise: float
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return a second-order step of each of B patches, and whether it is seen.

        Pixels count as far as their local windows correlate, with Tukey's weights.
        """
        light = self.fit_light(grey, share, noise**2)
        weight = share * np.maximum(light.correlation, 0)
        total = np.maximum(weight.sum(axis=(1, 2), keepdims=True), np.float32(TINY))
        mean_size = (weight * np.abs(light.residual)).sum(axis=(1, 2), keepdims=True) / total
        weight = weight * tukey(light.residual, np.maximum(NORMAL_MEAN * mean_size, noise))
        weight = weight.astype(np.float32).reshape(len(grey), 1, -1)
        gain = light.gain.astype(np.float32).reshape(weight.shape)
        slope = np.float32(0.5) * (slope + gain * self.slope)
        rows = self.flow[0] * slope[:, :1] + self.flow[1] * slope[:, 1:]
        residual = light.residual.astype(np.float32).reshape(weight.shape)
        normal = (rows * weight) @ rows.transpose(0, 2, 1)
        right = (rows * weight) @ residual.transpose(0, 2, 1)
        diagonal = np.diagonal(normal, axis1=1, axis2=2)
        seen = (share.mean(axis=(1, 2)) >= LEAST_VISIBLE) & (diagonal > 0).all(axis=1)
        ridge = TINY * diagonal.astype(np.float64) + ~seen[:, None]
        normal = normal + ridge[:, :, None] * np.eye(len(self.basis))
        return -np.linalg.solve(normal, right.astype(np.float64))[..., 0], seen

    def blocks(self, view: View, pose: Array) -> Blocks:
        """Compare the template with the frame under poses, …×3×3, block by block."""
        grey, _, share = self.patch(view.layer(self.halvings), pose, view.saturation)
        return compare(grey, self.grey, share, view.noise * self.noise)

    def inlier_weight(self, grey: Image, share: Image, noise: float) -> Image:
        """Return how far each pixel of a patch looks like the template's, 0 to 1.

        That is its surroundings' correlation with the template, or, where there is little texture,
        how far their difference is noise, which may have 3 times its variance; the gain must be
        that of the rest, within a factor of 2.
        """
        expected = 2 * (noise * self.noise) ** 2
        light = self.fit_light(grey, share, expected / 2)
        sure = light.correlation > 0.7
        usual = float(np.median(light.gain[sure])) if sure.any() else 1.0
        same_gain = (light.gain > usual / 2) & (light.gain < 2 * usual)
        alike = np.where(same_gain, light.correlation, 0)
        rest = light.gg - 2 * usual * light.tg + usual**2 * light.tt
        rest -= (1 + usual**2) * expected / 2
        noisy = 3 * expected / np.maximum(rest, 3 * expected)
        return np.maximum(np.maximum(alike, noisy), 0).astype(np.float32) * share


def make_local(
    image: Image,
    box: tuple[int, int, int, int],
    pose: Array,
    *,
    halvings: int,
    finest: int,
    **options: Any,
) -> LocalLevel:
    """Cut a template from a frame at one resolution, as `make_level` does with the same options.

    `finest` are the halvings of the finest level of the search, in whose px lengths are given.
    """
    level = make_level(image, box, pose, halvings=halvings, **options)
    sigma = LOCAL_WINDOW * 2.0 ** (finest - halvings)
    down, across = (_gaussian_sums(side, sigma) for side in level.grey.shape)
    return LocalLevel(**vars(level), halvings=halvings, wide=(down, across.T))


@lru_cache(maxsize=64)
def _gaussian_sums(length: int, sigma: float) -> Image:
    """Return the matrix that sums the surroundings of each pixel of a side, a Gaussian to 2 σ."""
    place = np.arange(length)
    off = np.abs(place[:, None] - place)
    near = off <= np.ceil(2 * sigma)
    return np.where(near, np.exp(-np.square(off) / (2 * sigma**2)), 0.0).astype(np.float32)


def tukey(residual: Array, scale: float | Array) -> Array:
    """Return Tukey's weights."""
    return np.square(np.maximum(1 - np.square(residual / (TUKEY * scale)), 0))


def robust_scale(residual: Array, inliers: Array, fewest: float) -> float:
    """Return the standard deviation of the trusted residuals, 0 if they are too few."""
    kept = np.abs(residual[inliers > 0.3])
    return NORMAL * float(np.median(kept)) if kept.size >= fewest else 0.0
