"""Alignment in local illumination: around each pixel the light has a gain and a bias of its own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, Image
from microlib.tracking._blocks import Agreement, agreement
from microlib.tracking._esm import Level, make_level
from microlib.tracking._geometry import moved, torn

# What parts of the tracker are worth is in its benchmark on photographs, table "Variants".

#: Standard deviation (px of the finest level of the search) of the surroundings in which gain and
#: bias count as constant, and where that Gaussian is cut off.
_SURROUNDINGS, _TRUNCATION = 3.5, 2.0

#: Standard deviation (px of that level) of a corner about the undeformed template, a priori.
_DEFORMATION = 5.0

#: Correlation of surroundings whose gain is believed, and the logarithm of the ratio to it from
#: which on another gain is that of something else.
_ALIKE, _OTHER_GAIN = 0.7, 0.7

#: Variance of the difference, in that of the noise, up to which surroundings are the template's.
_NOISY = 3.0

#: Least share of the template that an alignment must see.
_LEAST_SHOWN = 0.15

#: Correlation of the surroundings, and trust, of the pixels whose residuals tell their size.
_SURE, TRUSTED = 0.5, 0.3

#: Where Tukey's biweight ends, in standard deviations: 95 % efficient for normal noise.
TUKEY = 4.685

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
    wide : tuple of ndarray
        Matrices that sum the surroundings in which the light is constant, down and across.
    prior : ndarray, shape (n, n)
        Inverse covariance of the motion a priori, which holds the deformation only.
    """

    wide: tuple[Image, Image]
    prior: Array

    def fit_light(self, grey: Image, share: Image, floor: float) -> LocalLight:
        """Fit ``grey = gain·template + bias`` around each pixel of images, …×H×W.

        `floor` is the variance of the noise, which keeps what is flat from correlating by chance.
        """
        down, across = self.wide
        wt, wg = share * self.grey, share * grey
        sums = down @ np.stack([share, wt, wg, wt * self.grey, wg * grey, wt * grey]) @ across
        t, g, tt, gg, tg = sums[1:] / np.maximum(sums[0], np.float32(1e-6))
        tt = np.maximum(tt - t * t, 0) + np.float32(floor)
        gg = np.maximum(gg - g * g, 0) + np.float32(floor)
        tg = tg - t * g
        gain = np.clip(tg / tt, np.float32(0.1), np.float32(10))
        residual = grey - g - gain * (self.grey - t)
        return LocalLight(residual, gain, tg / np.sqrt(tt * gg), tt, gg, tg)

    def align_locally(
        self,
        image: Image,
        poses: ArrayLike,
        *,
        noise: float,
        ceiling: float,
        iterations: int,
        tolerance: float,
    ) -> list[Array]:
        """Return the poses, B×3×3, at which template and image agree best in local illumination.

        All are aligned at once; those that diverge are left out.
        """
        poses = np.array(poses, np.float64).reshape(-1, 3, 3)
        n, least = len(self.basis), noise * self.noise
        start = self.corners_of(poses)
        before, total = start.copy(), np.zeros((len(poses), n))
        scale, held = np.full((len(poses), 1, 1), least), np.ones(len(poses), bool)
        going = np.arange(len(poses))
        for _ in range(iterations):
            if not going.size:
                break
            grey, slope, share = self.patch(image, poses[going], ceiling)
            light = self.fit_light(grey, share, least**2)
            scale[going] = _scales(light, share, scale[going], least)
            weight = share * np.maximum(light.correlation, 0)
            weight = weight * tukey(light.residual, scale[going]) / scale[going] ** 2
            weight, gain, residual = (
                v.astype(np.float32).reshape(len(going), 1, -1)
                for v in (weight, light.gain, light.residual)
            )
            slope = np.float32(0.5) * (slope + gain * self.slope)
            rows = self.flow[0] * slope[:, :1] + self.flow[1] * slope[:, 1:]
            weighted = rows * weight
            normal = weighted @ rows.transpose(0, 2, 1) + self.prior
            right = (weighted @ residual.transpose(0, 2, 1))[..., 0] + total[going] @ self.prior
            diagonal = np.diagonal(normal, axis1=1, axis2=2)
            good = (share.mean(axis=(1, 2)) >= _LEAST_SHOWN) & (diagonal > 0).all(axis=1)
            normal += (1e-9 * diagonal + ~good[:, None])[:, :, None] * np.eye(n)
            step = -np.linalg.solve(normal, right[..., None])[..., 0]
            total[going] += step
            poses[going] = moved(poses[going], step, self.basis)
            after = self.corners_of(poses[going])
            good &= ~torn(after, start[going])
            way = np.abs(after - before[going]).max(axis=(1, 2))
            before[going], held[going] = after, good
            going = going[good & (way >= tolerance)]
        return list(poses[held])

    def agreement(self, image: Image, pose: Array, noise: float, ceiling: float) -> Agreement:
        """Return what the blocks say of poses, …×3×3."""
        grey, _, share = self.patch(image, pose, ceiling)
        return agreement(grey, self.grey, share, noise * self.noise)

    def trust(self, grey: Image, share: Image, noise: float) -> Image:
        """Return how far each pixel of a patch looks like the template's, 0 to 1.

        That is its surroundings' correlation with the template, or, where there is little texture,
        how far their difference is noise; the gain must be that of the rest.
        """
        expected = 2 * (noise * self.noise) ** 2
        light = self.fit_light(grey, share, expected / 2)
        sure = light.correlation > _ALIKE
        usual = float(np.median(light.gain[sure])) if sure.any() else 1.0
        alike = np.where(np.abs(np.log(light.gain / usual)) < _OTHER_GAIN, light.correlation, 0)
        rest = light.gg - 2 * usual * light.tg + usual**2 * light.tt
        rest -= (1 + usual**2) * expected / 2
        noisy = _NOISY * expected / np.maximum(rest, _NOISY * expected)
        return np.maximum(np.maximum(alike, noisy), 0).astype(np.float32) * share


def make_local(
    image: Image, box: tuple[int, int, int, int], pose: Array, *, finest: int, **options: Any
) -> LocalLevel:
    """Cut a template from a frame at one resolution, as `make_level` does with the same options.

    `finest` are the halvings of the finest level of the search, in whose px lengths are given.
    """
    level = make_level(image, box, pose, **options)
    scale = 2.0 ** (finest - options["halvings"])
    velocity = level.basis @ np.column_stack([level.corners, np.ones(4)]).T
    moves = (velocity[:, :2] - level.corners.T * velocity[:, 2:]) / level.to_template[0, 0]
    moves = (moves - moves.mean(axis=2, keepdims=True)).reshape(len(level.basis), -1)
    return LocalLevel(
        **vars(level),
        wide=(
            _surroundings(level.grey.shape[0], scale),
            _surroundings(level.grey.shape[1], scale).T,
        ),
        prior=moves @ moves.T / (4 * (_DEFORMATION * scale) ** 2),
    )


@lru_cache(maxsize=64)
def _surroundings(length: int, scale: float) -> Image:
    """Return the matrix that sums the surroundings of each pixel of a side."""
    sigma, place = _SURROUNDINGS * scale, np.arange(length)
    off = np.abs(place[:, None] - place)
    near = off <= np.ceil(_TRUNCATION * sigma)
    return np.where(near, np.exp(-np.square(off) / (2 * sigma**2)), 0.0).astype(np.float32)


def tukey(residual: Array, scale: float | Array) -> Array:
    """Return Tukey's weights."""
    return np.square(np.maximum(1 - np.square(residual / (TUKEY * scale)), 0))


def _scales(light: LocalLight, share: Image, before: Array, least: float) -> Array:
    """Return the robust standard deviation of each image's trusted residuals."""
    sure = (light.correlation > _SURE) & (share > TRUSTED)
    size = np.where(sure, np.abs(light.residual), np.float32(np.inf)).reshape(len(share), -1)
    count = sure.sum(axis=(1, 2))
    middle = np.take_along_axis(np.sort(size, axis=1), (count // 2)[:, None] % size.shape[1], 1)
    known = (count > size.shape[1] // 20)[:, None]
    found = np.where(known, NORMAL * middle, 2 * least)[..., None]
    return np.maximum(np.where(known[..., None], found, np.maximum(before, found)), least)
