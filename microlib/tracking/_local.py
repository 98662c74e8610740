"""A level of the robust search: alignment in local illumination, and the votes of its blocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from microlib._common import Array, Image
from microlib.tracking._blocks import Agreement, agreement, edges
from microlib.tracking._esm import Level, apply_homography, half_pixel, make_level
from microlib.tracking._loops import (
    align_locally,
    block_votes,
    local_fit,
    moved,
    patch_at,
    sample_patch,
)

# The benchmark of tracking in bad light, table "Constants", says what the following are worth.

#: Standard deviation (px of the finest level of the search) of the surroundings in which gain and
#: bias count as constant.
_SURROUNDINGS = 3.5

#: Standard deviation (px of that level) of a corner about the undeformed template, a priori.
_DEFORMATION = 5.0

#: Information (nats) from which on a block votes: chance rarely gives more.
_LEAST_VOTE = 0.2

#: Distances (px) at which a block's vote counts half, one fit of the deformation after another.
_OUTLYING = (4.0, 3.0, 2.0, 1.5, 1.2, 1.0, 1.0, 1.0)

#: Correlation of surroundings whose gain is believed, and the logarithm of the ratio to it from
#: which on another gain is that of something else.
_ALIKE, _OTHER_GAIN = 0.7, 0.7

#: Variance of the difference, in that of the noise, up to which surroundings are the template's.
_NOISY = 3.0

#: Where no gradient is wanted.
_NO_SLOPE = np.empty((2, 0), np.float32)

#: Standard deviation (px) of the smoothing before blocks are compared with their surroundings.
_VOTING = 1.0


@dataclass(frozen=True)
class LocalLevel:
    """A template at one resolution, for alignment in local illumination.

    Attributes
    ----------
    level : Level
        The template, its gradient and its flow.
    pad : int
        Margin of the sampled patch around the template, px.
    grey, slope : ndarray, shapes (H, W) and (2, N)
        The template and its gradient.
    mask : ndarray, shape (H, W)
        How far each pixel counts.
    kernel, wide : ndarray
        Smoothing, and the surroundings in which the light is constant.
    basis : ndarray, shape (n, 3, 3)
        Generators of the motion in px of the sampled patch.
    corners : ndarray, shape (4, 2)
        Corners of the template in these px.
    prior : ndarray, shape (n, n)
        Inverse covariance of the motion a priori, which holds the deformation only.
    noise : float
        Standard deviation that white noise of unit variance keeps at this level.
    from_image, from_template : ndarray, shape (3, 3)
        Inverses of the level's `to_image` and `to_template`.
    """

    level: Level
    pad: int
    grey: Image
    slope: Image
    mask: Image
    kernel: Image
    wide: Image
    basis: Array
    corners: Array
    prior: Array
    noise: float
    from_image: Array
    from_template: Array

    def warp(self, pose: Array) -> Array:
        """Return the map from px of the sampled patch to samples of the image."""
        return np.ascontiguousarray(self.level.to_image @ pose @ self.level.to_template)

    def pose(self, warp: Array) -> Array:
        """Return the pose of a map from px of the sampled patch to samples of the image."""
        return self.from_image @ warp @ self.from_template

    def lattice(self) -> Array:
        """Return some of the template's pixels in normalized coordinates, N×2.

        They are enough to average over the places between pixels that a warp leads to.
        """
        rows, columns = np.mgrid[2 : self.grey.shape[0] : 5, 2 : self.grey.shape[1] : 5]
        points = np.column_stack([columns.ravel(), rows.ravel()]) + float(self.pad)
        return apply_homography(self.level.to_template, points)

    def align(
        self,
        image: Image,
        pose: Array,
        *,
        noise: float,
        ceiling: float,
        iterations: int,
        tolerance: float,
    ) -> Array | None:
        """Return the pose at which template and image agree best in local illumination."""
        warp, steps = align_locally(
            image,
            self.warp(pose),
            self.basis,
            self.level.flow,
            self.grey,
            self.slope,
            self.mask,
            self.kernel,
            self.pad,
            self.wide,
            noise * self.noise,
            ceiling,
            self.prior,
            self.corners,
            iterations,
            tolerance,
        )
        return self.pose(warp) if steps else None

    def patch(self, image: Image, pose: Array, ceiling: float) -> tuple[Image, Image]:
        """Return the image under a pose, and how far each of its pixels counts."""
        grey, inside = np.empty_like(self.grey), np.empty_like(self.grey)
        patch_at(image, self.warp(pose), self.kernel, self.pad, grey, _NO_SLOPE, inside)
        blinded = (grey >= ceiling) & (self.grey < ceiling)
        return grey, np.where(blinded, np.float32(0), inside * self.mask)

    def agreement(
        self, image: Image, pose: Array, noise: float, ceiling: float, template: Image | None = None
    ) -> Agreement:
        """Return what the blocks say of a pose; of another `template`, if one is given."""
        grey, share = self.patch(image, pose, ceiling)
        template = self.grey if template is None else template
        return agreement(grey, template, share, noise * self.noise)

    def trust(self, image: Image, pose: Array, noise: float, ceiling: float) -> Image:
        """Return how far each pixel looks like the template's, 0 to 1.

        That is its surroundings' correlation with the template, or, where there is little texture,
        how far their difference is noise; the gain must be that of the rest.
        """
        grey, share = self.patch(image, pose, ceiling)
        residual, gain, correlation = (np.empty_like(grey) for _ in range(3))
        sums = np.empty((6, *grey.shape), np.float32)
        expected = 2 * (noise * self.noise) ** 2
        local_fit(
            grey, self.grey, share, True, self.wide, expected / 2, sums, residual, gain, correlation
        )
        sure = correlation > _ALIKE
        usual = float(np.median(gain[sure])) if sure.any() else 1.0
        alike = np.where(np.abs(np.log(gain / usual)) < _OTHER_GAIN, correlation, 0)
        square = sums[3:5] / np.maximum(sums[0], 1e-6)
        t, tt = sums[1:3] / np.maximum(sums[0], 1e-6)
        g, gg = square
        tg = sums[5] / np.maximum(sums[0], 1e-6) - t * g
        rest = (gg - g * g) - 2 * usual * tg + usual**2 * (tt - t * t)
        noisy = _NOISY * expected / np.maximum(rest, _NOISY * expected)
        return np.maximum(np.maximum(alike, noisy), 0).astype(np.float32) * share

    def votes(self, image: Image, pose: Array, reach: int, noise: float) -> Image:
        """Return the vote of each block for each shift of a pose by up to `reach` px.

        The votes have the shape (blocks down, blocks across, shifts down, shifts across).
        """
        height, width = self.grey.shape
        window = np.empty((height + 2 * reach, width + 2 * reach), np.float32)
        begin = np.eye(3)
        begin[:2, 2] = self.pad - reach
        warp = np.ascontiguousarray(self.warp(pose) @ begin)
        sample_patch(cv2.GaussianBlur(image, (0, 0), _VOTING), warp, window, np.empty_like(window))
        down, across = edges(height), edges(width)
        shifts = 2 * reach + 1
        votes = np.empty((len(down) - 2, len(across) - 2, shifts, shifts), np.float32)
        mean = np.float32(self.level.mean)
        kept = noise / (2 * np.sqrt(np.pi) * _VOTING)  # of white noise behind a Gaussian
        block_votes(window - mean, self.grey - mean, across, down, _LEAST_VOTE, kept**2, votes)
        return votes

    def fit_blocks(self, image: Image, pose: Array, reach: int, noise: float) -> Array:
        """Return the pose that brings the blocks where each of them fits best, robustly."""
        votes = self.votes(image, pose, reach, noise)
        moves, weights = _best_shifts(votes.reshape(-1, *votes.shape[2:]))
        middles = [((e[:-2] + e[2:]) // 2) for e in map(edges, self.grey.shape)]
        index = (middles[0][:, None] * self.grey.shape[1] + middles[1]).ravel()
        flow = self.level.flow[:, :, index].transpose(2, 0, 1).astype(np.float64)
        step = np.zeros(flow.shape[2])
        for distance in _OUTLYING:
            off = ((moves - flow @ step) ** 2).sum(axis=1)
            weight = weights / (1 + off / distance**2) ** 2
            normal = np.einsum("b,bki,bkj->ij", weight, flow, flow) + 0.05 * self.prior
            normal.flat[:: len(step) + 1] += 1e-9
            step = np.linalg.solve(normal, np.einsum("b,bki,bk->i", weight, flow, moves))
        return moved(pose, step, self.level.basis)


def _best_shifts(votes: Image) -> tuple[Array, Array]:
    """Return the best shift (x, y) of each block, to a fraction of a pixel, and its votes."""
    blocks, rows, columns = votes.shape
    best = votes.reshape(blocks, -1).argmax(axis=1)
    row = np.clip(best // columns, 1, rows - 2)
    column = np.clip(best % columns, 1, columns - 2)
    block = np.arange(blocks)
    top = votes[block, row, column].astype(np.float64)
    top[best != row * columns + column] = 0.0  # at the border: it may be better beyond
    moves = np.stack([column - columns // 2, row - rows // 2], axis=1).astype(np.float64)
    for axis, (dy, dx) in enumerate(((0, 1), (1, 0))):
        before, after = votes[block, row - dy, column - dx], votes[block, row + dy, column + dx]
        bend = 2 * top - before - after
        moves[:, axis] += np.where(
            bend > 0, 0.5 * (after - before) / np.maximum(bend, 1e-9), 0.0
        ).clip(-0.5, 0.5)
    return moves, top


def gaussian(sigma: float, truncation: float) -> Image:
    """Return a Gaussian of unit sum, cut off at `truncation` standard deviations."""
    radius = int(np.ceil(truncation * sigma))
    kernel = np.exp(-np.square(np.arange(-radius, radius + 1)) / (2 * max(sigma, 1e-9) ** 2))
    return (kernel / kernel.sum()).astype(np.float32)


def make_local(
    image: Image,
    box: tuple[int, int, int, int],
    pose: Array,
    *,
    halvings: int,
    finest: int,
    smoothing: float,
    motion: str,
    mask: Image,
    density: int = 1,
) -> LocalLevel:
    """Cut a template from an image that is `halvings` below the frame, as `make_level`.

    `finest` are the halvings of the finest level of the search, in whose px lengths are given.
    """
    step = 2**halvings
    level = make_level(
        image, box, pose, step=step, density=density, smoothing=smoothing, motion=motion
    )
    kernel = gaussian(smoothing, 3.0)
    pad = len(kernel) // 2 + 2
    shape = (level.padded[1] - 2 * pad, level.padded[0] - 2 * pad)
    back = np.linalg.inv(level.to_template)
    scale = 2.0 ** (finest - halvings)
    x, y = -(-box[0] // step) * step - box[0], -(-box[1] // step) * step - box[1]
    # Sampling between the pixels keeps 2/3 of the variance along either axis, on average.
    return LocalLevel(
        level=level,
        pad=pad,
        grey=np.ascontiguousarray((level.template + np.float32(level.mean)).reshape(shape)),
        slope=level.gradient,
        mask=np.ascontiguousarray(mask[y::step, x::step][: shape[0], : shape[1]]),
        kernel=kernel,
        wide=gaussian(_SURROUNDINGS * scale, 2.0),
        basis=np.ascontiguousarray(back @ level.basis @ level.to_template),
        corners=apply_homography(back, level.corners),
        prior=_deformation_prior(level, _DEFORMATION * scale),
        noise=_kept_noise(halvings, density, smoothing),
        from_image=np.linalg.inv(level.to_image),
        from_template=back,
    )


def _deformation_prior(level: Level, sigma: float) -> Array:
    """Return the inverse covariance of motions whose corners deform by `sigma` px of the level."""
    velocity = level.basis @ np.column_stack([level.corners, np.ones(4)]).T
    moves = (velocity[:, :2] - level.corners.T * velocity[:, 2:]) / level.to_template[0, 0]
    moves = (moves - moves.mean(axis=2, keepdims=True)).reshape(len(level.basis), -1)
    return moves @ moves.T / (4 * sigma**2)


@lru_cache(maxsize=64)
def _kept_noise(halvings: int, density: int, smoothing: float) -> float:
    """Return the standard deviation of unit white noise after halving, sampling and smoothing."""
    kernel = gaussian(smoothing, 3.0)
    noise = np.random.default_rng(0).standard_normal((64 << halvings, 64 << halvings))
    layer: Image = noise.astype(np.float32)
    for _ in range(halvings):
        layer = cv2.pyrDown(layer)
    # Half-way between the best and the worst phase of the interpolation.
    between = np.array([0.25, 0.75] if density == 1 else [0.5, 0.5], np.float32)
    layer = half_pixel(layer) if density == 2 else layer
    layer = cv2.sepFilter2D(layer, -1, between, between)[::density, ::density]
    return float(cv2.sepFilter2D(layer, -1, kernel, kernel)[8:-8, 8:-8].std())
