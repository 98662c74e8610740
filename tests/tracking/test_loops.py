"""The compiled loops against SciPy, NumPy and loops written out."""

import numpy as np
import pytest
from numpy.random import default_rng
from scipy import ndimage
from scipy.linalg import expm

from microlib.tracking import _loops
from microlib.tracking._blocks import edges
from microlib.tracking._esm import generators

SINGLE = 1e-4  # grey values up to 255 in single precision, a few sums deep


def grey(shape=(40, 50), seed=0):
    return ndimage.gaussian_filter(default_rng(seed).uniform(0, 255, shape), 1.5).astype(np.float32)


def test_a_patch_is_sampled_linearly_and_knows_what_it_saw():
    image = grey()
    warp = np.array([[1.05, 0.1, -2.0], [-0.05, 0.95, 3.0], [1e-3, -5e-4, 1.0]])
    patch, inside = np.empty((30, 35), np.float32), np.empty((30, 35), np.float32)
    _loops.sample_patch(image, warp, patch, inside)
    rows, columns = np.mgrid[:30, :35]
    x, y, depth = np.tensordot(warp, np.stack([columns, rows, np.ones_like(rows)]), 1)
    x, y = x / depth, y / depth
    expected = ndimage.map_coordinates(image.astype(float), (y, x), order=1, mode="nearest")
    np.testing.assert_allclose(patch, expected, atol=SINGLE)
    np.testing.assert_array_equal(inside, (x >= 0) & (x <= 49) & (y >= 0) & (y <= 39))
    assert 0 < inside.mean() < 1


@pytest.mark.parametrize("size", [1, 3, 9])
def test_smoothing_is_the_separable_convolution(size):
    image, kernel = grey((12, 17)), np.hanning(size + 2)[1:-1].astype(np.float32)
    found = np.empty_like(image)
    _loops.smooth(image, kernel, found)
    expected = ndimage.correlate1d(image.astype(float), kernel, axis=0, mode="constant")
    expected = ndimage.correlate1d(expected, kernel, axis=1, mode="constant")
    np.testing.assert_allclose(found, expected, atol=10 * SINGLE)


def test_the_gradient_of_a_patch_is_that_of_a_cubic():
    # Fourth-order differences are exact for cubic polynomials; whole pixels, so that sampling is.
    rows, columns = np.mgrid[:30, :30] / 10.0
    image = (columns**3 - 2 * columns * rows**2 + rows).astype(np.float32)
    patch, inside = np.empty((20, 20), np.float32), np.empty((20, 20), np.float32)
    slope = np.empty((2, 400), np.float32)
    warp = np.array([[1.0, 0, 3], [0, 1, 3], [0, 0, 1]])
    _loops.patch_at(image, warp, np.ones(1, np.float32), 2, patch, slope, inside)
    part = np.s_[5:25, 5:25]
    np.testing.assert_array_equal(patch, image[part])
    dx = 0.1 * (3 * columns**2 - 2 * rows**2)[part]
    dy = 0.1 * (1 - 4 * columns * rows)[part]
    np.testing.assert_allclose(slope, [dx.ravel(), dy.ravel()], atol=2e-5)


def test_the_local_fit_is_a_weighted_line_through_the_surroundings():
    template, wide = grey(seed=1), np.array([1, 2, 3, 2, 1], np.float32) / 9
    share = default_rng(2).uniform(0, 1, template.shape).astype(np.float32)
    image = 0.7 * template + 20 + default_rng(3).normal(0, 5, template.shape).astype(np.float32)
    residual, gain, correlation = (np.empty_like(template) for _ in range(3))
    sums = np.empty((6, *template.shape), np.float32)
    _loops.local_fit(image, template, share, True, wide, 0.0, sums, residual, gain, correlation)
    row, column = 17, 23
    near = np.s_[row - 2 : row + 3, column - 2 : column + 3]
    weight = np.outer(wide, wide) * share[near]
    t, g = template[near].astype(float), image[near].astype(float)
    slope, intercept = np.polyfit(t.ravel(), g.ravel(), 1, w=np.sqrt(weight.ravel()))
    assert gain[row, column] == pytest.approx(slope, abs=1e-3)
    expected = image[row, column] - slope * template[row, column] - intercept
    assert residual[row, column] == pytest.approx(expected, abs=0.02)
    covariance = np.cov(t.ravel(), g.ravel(), aweights=weight.ravel())
    expected = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert correlation[row, column] == pytest.approx(expected, abs=1e-3)


def test_votes_are_the_information_of_the_correlation_of_blocks():
    template, window = grey((30, 30), 4), grey((36, 38), 5)
    window[3:33, 6:36] = template  # the shift (6, 3)
    down, across = edges(30), edges(30)
    votes = np.empty((len(down) - 2, len(across) - 2, 7, 9), np.float32)
    _loops.block_votes(window, template, across, down, 0.2, 0.0, votes)
    for j, i, dy, dx in ((0, 0, 3, 6), (2, 3, 0, 0), (1, 4, 5, 8), (4, 0, 2, 7)):
        block = template[down[j] : down[j + 2], across[i] : across[i + 2]].ravel()
        part = window[down[j] + dy : down[j + 2] + dy, across[i] + dx : across[i + 2] + dx].ravel()
        rho = max(np.corrcoef(block, part)[0, 1], 0)
        expected = max(-0.5 * np.log(1 - min(rho**2, 0.9999)) - 0.2, 0)
        assert votes[j, i, dy, dx] == pytest.approx(expected, abs=2e-3)
    best = votes.sum(axis=(0, 1))
    assert np.unravel_index(best.argmax(), best.shape) == (3, 6)


@pytest.mark.parametrize("n", [1, 8, 39])
def test_the_solver_solves_and_refuses(n):
    rng = default_rng(n)
    root = rng.standard_normal((n, n + 3))
    matrix, right = root @ root.T, rng.standard_normal(n)
    expected = np.linalg.solve(matrix, right)
    assert _loops._solve(matrix.copy(), right)
    np.testing.assert_allclose(right, expected, rtol=1e-8, atol=1e-10)
    assert not _loops._solve(-np.eye(n), np.ones(n))


@pytest.mark.parametrize("count", [1, 2, 7, 100])
def test_the_median_is_the_middle_one(count):
    values = default_rng(count).normal(size=120).round(1).astype(np.float32)
    expected = np.sort(values[:count])[count // 2]
    assert _loops._median(values, count) == expected


def test_a_motion_is_the_exponential():
    basis = generators("homography")
    for scale in (1e-3, 0.3, 3.0):
        step = scale * default_rng(0).standard_normal(8)
        found = _loops.moved(np.eye(3), step, basis)
        expected = expm(np.tensordot(step, basis, 1))
        np.testing.assert_allclose(found, expected, atol=1e-11 * np.abs(expected).max())
    assert not _loops.moved(np.eye(3), np.full(8, np.nan), basis).any()


def test_the_weighted_median_halves_the_weight():
    values, weights = np.array([5.0, 1, 3, 2]), np.array([1.0, 1, 4, 1])
    assert _loops._weighted_median(values, weights) == 3.0


def test_a_warp_of_zeros_and_one_of_nan_are_torn_and_sample_within_the_image():
    corners = np.array([[0.0, 0], [9, 0], [9, 9], [0, 9]])
    for warp in (np.zeros((3, 3)), np.full((3, 3), np.nan)):
        moved = _loops.corners_of(warp, corners)
        assert _loops._torn(warp, moved, corners)
        image, patch, inside = (
            grey(),
            np.empty((10, 10), np.float32),
            np.empty((10, 10), np.float32),
        )
        _loops.sample_patch(image, warp, patch, inside)
        np.testing.assert_array_equal(inside, 0)
        assert image.min() <= patch.min() <= patch.max() <= image.max()
