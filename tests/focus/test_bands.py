"""The compiled loops of the relief beside what they stand for, in double precision."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import ndimage

from microlib.focus import _bands, _directions, _loops, _relief

SHAPE = (75, 530)


def maps(seed):
    rng = np.random.default_rng(seed)
    offsets = rng.uniform(-1, 1, (3, *SHAPE)).astype(np.float32)
    weights = rng.gamma(1.0, 1.0, (3, *SHAPE)).astype(np.float32)
    weights[:, 20:26] = 0
    return offsets, weights


@pytest.mark.parametrize("workers", [1, 2])
def test_bands_are_differences_of_weighted_means(workers):
    offsets, weights = maps(0)
    smooth, bands = np.zeros_like(offsets), np.empty((5, *offsets.shape), np.float32)
    for k in range(5):
        _relief._split(offsets, weights, k, bands[k], smooth, workers)

    def mean(kind, sigma):
        def blurred(image):
            radius = round(8 * sigma + 1) // 2
            return ndimage.gaussian_filter(image, sigma, mode="mirror", radius=radius)

        weight = weights[kind].astype(float)
        return blurred(offsets[kind] * weight) / np.maximum(blurred(weight), 1e-12)

    for kind in range(3):
        for k, (fine, coarse) in enumerate(pairwise(_relief._SIGMAS[:4])):
            expected = mean(kind, fine) - mean(kind, coarse)
            np.testing.assert_allclose(bands[k + 1, kind], expected, atol=1e-5)
        # The widest is of two boxes of 15 px.
        weight = weights[kind].astype(float)
        upper, lower = offsets[kind] * weight, weight
        for _ in range(2):
            upper, lower = (ndimage.uniform_filter(v, 15, mode="mirror") for v in (upper, lower))
        np.testing.assert_allclose(smooth[kind], upper / lower, atol=1e-5)


def test_products_are_those_of_sines_and_cosines():
    offsets, weights = maps(1)
    rng = np.random.default_rng(2)
    large = rng.uniform(0, 20, SHAPE).astype(np.float32)
    level = large + rng.uniform(-0.4, 0.4, SHAPE).astype(np.float32)
    sums = np.zeros((3, 5, 6))
    _bands.add_products(level, large, 0.2, offsets, weights, sums)
    phase = 2 * np.pi * large.astype(float)
    waves = [np.ones(SHAPE), np.sin(phase), np.cos(phase), np.sin(2 * phase), np.cos(2 * phase)]
    for kind in range(3):
        weight = weights[kind] * (np.abs(large - level) < 0.2)
        for i, wave in enumerate(waves):
            for j, other in enumerate([*waves, offsets[kind]]):
                expected = np.sum(weight * wave * other, dtype=float)
                assert sums[kind, i, j] == pytest.approx(expected, abs=1e-6 * float(weight.sum()))


def test_harmonics_are_taken_from_the_offsets():
    offsets, _ = maps(3)
    level = np.random.default_rng(4).uniform(-3, 30, SHAPE).astype(np.float32)
    factors = np.array([[0.1, 0.2, 0.3, 0.4], [0, 1, 0, 0], [0, 0, 0, -1]], np.float32)
    found = np.empty_like(offsets)
    _bands.unlock(level, offsets, factors, found)
    phase = 2 * np.pi * level.astype(float)
    waves = np.stack([np.sin(phase), np.cos(phase), np.sin(2 * phase), np.cos(2 * phase)])
    expected = offsets - np.tensordot(factors, waves, axes=1)
    # Depths of 30 frames leave 2e-6 of a frame, an angle of 24e-6 at twice the frequency.
    np.testing.assert_allclose(found, expected, atol=3e-5)


@pytest.mark.parametrize("count", [0, 1, 2, 999, 1000])
def test_the_median_of_positive_values(count):
    rng = np.random.default_rng(count)
    positive = np.exp(rng.normal(0, 5, count)).astype(np.float32)
    values = rng.permutation(np.concatenate([positive, np.zeros(7, np.float32)]))
    expected = np.median(positive) if count else 1.0
    assert _bands.median_above_zero(values) == pytest.approx(expected, rel=1e-6)


def test_relief_is_composed_of_shares():
    rng = np.random.default_rng(5)
    bands = rng.uniform(-1, 1, (4, 3, 9, 40)).astype(np.float32)
    shares, agreed = rng.random((2, 4, 9, 40)).astype(np.float32)
    relief, held = np.zeros((3, 9, 40), np.float32), np.zeros((2, 9, 40), np.float32)
    for k in range(4):
        _bands.compose_rows(bands[k], shares[k], agreed[k], relief, held)
    np.testing.assert_allclose(relief, (shares[:, None] * bands).sum(axis=0), atol=1e-6)
    back = (agreed * (1 - shares))[:, None] * bands[:, 1:]
    np.testing.assert_allclose(held, back.sum(axis=0), atol=1e-6)


def test_weights_are_balanced_around_a_typical_one():
    weights = np.array([[0, 1, 2, 4000, 1e-9, 3]], np.float32)
    _loops.balance(weights, np.float32(2), np.float32(100))
    np.testing.assert_allclose(weights, [[0, 0.5, 1, 100, 0.01, 1.5]])


@pytest.mark.parametrize("sign", [1, -1])
def test_the_nearest_frame_is_that_of_argmin(sign):
    rng = np.random.default_rng(6)
    positions = sign * np.cumsum(rng.uniform(0.5, 2, 40))
    depth = rng.uniform(positions.min() - 2, positions.max() + 2, (7, 90))
    found = _directions.nearest_frames(depth, positions)
    np.testing.assert_array_equal(found, np.abs(depth[..., None] - positions).argmin(axis=-1))
