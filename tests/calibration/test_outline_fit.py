"""The fit of outlines: its convergence, its covariance, and what outlines of one image share."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from microlib.calibration._outline_fit import (
    OutlineFit,
    Patches,
    cut_patches,
    fit_outlines,
    ground,
    smooth_parameters,
)


def patches_of(grey, weight=None):
    """Patches whose k-th pixel stands at x = k, y = −k."""
    grey = np.atleast_2d(np.asarray(grey, dtype=float))
    x = np.broadcast_to(np.arange(grey.shape[1], dtype=float), grey.shape)
    weight = np.ones(grey.shape) if weight is None else weight
    return Patches(x, -x, grey, weight, np.zeros((len(grey), 2)))


def arctangent(p):
    """Newton's step overshoots from |p| > 1.4; five pixels, each with a share of its own."""
    share = np.arange(1.0, 6.0)
    return np.arctan(p) * share, (share / (1 + p**2))[..., None]


def test_a_first_step_that_overshoots_is_tried_again():
    """With every step refused at first, the search must not end where it started."""
    truth = np.array([[0.1]])
    patches = patches_of(arctangent(truth)[0] + 1e-3 * np.array([1, -1, 1, -1, 1]))
    fit = fit_outlines(arctangent, np.array([[3.0]]), patches)
    # The noise moves the minimum by about 1e-3/√55.
    np.testing.assert_allclose(fit.parameters, truth, atol=1e-3)
    assert np.isfinite(fit.covariance).all()


def test_a_patch_at_its_minimum_does_not_stop_the_others():
    truth = np.array([[0.1], [0.1]])
    patches = patches_of(arctangent(truth)[0] + 1e-3 * np.array([1, -1, 1, -1, 1]))
    fit = fit_outlines(arctangent, np.array([[0.1], [3.0]]), patches)
    np.testing.assert_allclose(fit.parameters, truth, atol=1e-3)


def test_a_patch_that_still_moves_is_not_called_fitted():
    patches = patches_of(arctangent(np.array([[0.1]]))[0] + 0.01 * np.arange(5))
    fit = fit_outlines(arctangent, np.array([[3.0]]), patches, iterations=3)
    assert np.isnan(fit.covariance).all()
    assert np.isnan(fit.rms).all()


def test_a_failed_patch_leaves_the_others_alone():
    grey = arctangent(np.array([[0.5], [0.5]]))[0] + 0.01 * np.array([1, 0, -1, 1, 0])
    grey[1] = np.nan
    fit = fit_outlines(arctangent, np.array([[0.0], [0.0]]), patches_of(grey))
    alone = fit_outlines(arctangent, np.array([[0.0]]), patches_of(grey[:1]))
    np.testing.assert_array_equal(fit.parameters[0], alone.parameters[0])
    assert np.isnan(fit.rms).tolist() == [False, True]


def test_the_search_ends_by_its_tolerance():
    """The smaller the tolerance, the more steps; a step that changes nothing ends it."""
    calls = []

    def model(p):
        calls.append(p)
        return arctangent(p)

    patches = patches_of(arctangent(np.array([[1.0]]))[0] + [0.1, -0.2, 0.1, 0.0, 0.1])
    counts = []
    for tolerance in (1e-2, 1e-12):
        calls.clear()
        fit_outlines(model, np.array([[0.0]]), patches, tolerance=tolerance)
        counts.append(len(calls))
    assert counts[0] < counts[1] < 12


def bump(p):
    """Height, place and width of a bump over a sloping ground, with derivatives."""
    x = np.arange(24.0)
    z = (x - p[:, 1:2]) / p[:, 2:3]
    shape = np.exp(-z * z / 2)
    light, by_light = ground(patches_of(np.zeros((len(p), 24))), p[:, 3:])
    by = [shape, p[:, :1] * shape * z / p[:, 2:3], p[:, :1] * shape * z * z / p[:, 2:3]]
    return p[:, :1] * shape + light, np.concatenate([np.stack(by, -1), by_light[..., :2]], -1)


def test_it_agrees_with_scipy_pixel_weights_and_covariance_included():
    rng = np.random.default_rng(0)
    truth = np.array([[10.0, 11.0, 3.0, 50.0, 0.5]]) + np.zeros((3, 1))
    padded = np.column_stack([truth, np.zeros(3)])

    def model(p):
        return bump(np.column_stack([p, np.zeros(len(p))]))

    grey = bump(padded)[0] + rng.normal(0, 0.2, (3, 24))
    weight = np.ones_like(grey)
    weight[1, 20:] = 0
    grey[1, 20:] = 1e3  # behind padding, whatever it is
    fit = fit_outlines(model, truth * 1.05, patches_of(grey, weight), tolerance=1e-12)
    for k in range(3):
        seen = weight[k] == 1
        peer = least_squares(
            lambda p, k=k, seen=seen: (model(p[None])[0][0] - grey[k])[seen], truth[k], xtol=1e-15
        )
        np.testing.assert_allclose(fit.parameters[k], peer.x, rtol=1e-5)
        variance = 2 * peer.cost / (seen.sum() - 5)
        expected = variance * np.linalg.inv(peer.jac.T @ peer.jac)
        scale = np.sqrt(np.diag(expected))
        # SciPy's Jacobian is of differences, good to 1e-7, and rounded further by the inverse.
        np.testing.assert_allclose(
            fit.covariance[k] / np.outer(scale, scale),
            expected / np.outer(scale, scale),
            atol=1e-4,
        )
        assert fit.rms[k] == pytest.approx(np.sqrt(variance), rel=1e-6)


def test_too_few_pixels_are_no_fit():
    fit = fit_outlines(arctangent, np.array([[0.0]]), patches_of(np.ones((1, 5)), np.eye(5)[:1]))
    assert np.isnan(fit.rms).all()


def test_patches_hold_the_chosen_pixels_of_the_image():
    image = np.arange(200, dtype=np.float32).reshape(10, 20)
    centers = np.array([[5.4, 4.6], [19.0, 0.2]])
    patches = cut_patches(image, centers, 2, lambda x, y: np.hypot(x, y) < 1.9)
    np.testing.assert_array_equal(patches.centers, [[5, 5], [19, 0]])
    # Nine pixels lie within 1.9 px; of those in the corner four lie in the image.
    assert patches.weight.sum(axis=1).tolist() == [9, 4]
    for k, (column, row) in enumerate([(5, 5), (19, 0)]):
        seen = patches.weight[k] == 1
        x, y = patches.x[k, seen], patches.y[k, seen]
        np.testing.assert_array_equal(patches.grey[k, seen], 20 * (row + y) + column + x)
        assert (np.hypot(x, y) < 1.9).all()
    assert patches.x.shape == (2, 9)


def outlines(n, rng, spread=0.0):
    """n places, a quadratic parameter and a free one, measured with errors that are correlated."""
    centers = rng.uniform(0, 400, (n, 2))
    x, y = centers.T / 400
    truth = np.column_stack([1 + 0.5 * x - 0.3 * x * y + 0.2 * y**2, rng.normal(0, 1, n)])
    truth[:, 0] += rng.normal(0, spread, n) if spread else 0
    covariance = np.array([[0.04, 0.03], [0.03, 0.09]])
    errors = rng.multivariate_normal([0, 0], covariance, n)
    fit = OutlineFit(truth + errors, np.tile(covariance, (n, 1, 1)), np.ones(n))
    return fit, truth, centers


def test_what_is_smooth_is_known_better_and_helps_the_rest():
    """Given the smooth parameter, the other one's variance falls to 0.09 − 0.03²/0.04, and that
    much of it is stated; six unknowns of a quadratic are shared by 400."""
    rng = np.random.default_rng(1)
    fit, truth, centers = outlines(400, rng)
    found = smooth_parameters(fit, centers, [0])
    error = found.parameters - truth
    # 400 values: a standard deviation is known to 3.5 %; three of them.
    assert np.std(error[:, 1]) == pytest.approx(np.sqrt(0.0675), rel=0.11)
    # Of the smooth one itself 6 of 400 parts are left.
    assert np.mean(error[:, 0] ** 2) == pytest.approx(0.04 * 6 / 400, rel=1.0)
    stated = found.covariance.mean(axis=0)
    assert stated[0, 0] == pytest.approx(0.04 * 6 / 400, rel=1e-6)
    assert stated[1, 1] == pytest.approx(0.0675 + 0.0225 * 6 / 400, rel=1e-6)


@pytest.mark.parametrize(("count", "unknowns"), [(12, 6), (11, 3), (6, 3)])
def test_the_polynomial_is_of_the_degree_that_the_outlines_can_bear(count, unknowns):
    fit, _, centers = outlines(count, np.random.default_rng(2))
    found = smooth_parameters(fit, centers, [0])
    # The trace of the projection on a polynomial is its number of unknowns.
    share = found.covariance[:, 0, 0].sum() / 0.04
    assert share == pytest.approx(unknowns, rel=1e-6)


def test_few_outlines_and_rough_parameters_keep_their_own():
    rng = np.random.default_rng(3)
    fit, _, centers = outlines(5, rng)
    assert smooth_parameters(fit, centers, [0]) is fit
    fit, _, centers = outlines(200, rng, spread=0.3)  # a scatter of 1.5 times the errors
    assert smooth_parameters(fit, centers, [0]) is fit
    # A misfit of 1.3 is 3 of its standard deviations of √(2/194): not yet rough.
    fit, _, centers = outlines(200, rng, spread=0.11)
    assert smooth_parameters(fit, centers, [0]) is not fit


def test_the_ground_is_a_plane():
    patches = patches_of(np.zeros((2, 4)))
    light, by = ground(patches, np.array([[1.0, 2.0, 0.0], [3.0, 0.0, 5.0]]))
    np.testing.assert_array_equal(light, [[1, 3, 5, 7], [3, -2, -7, -12]])
    np.testing.assert_array_equal(by[0], np.column_stack([np.ones(4), np.arange(4), -np.arange(4)]))
