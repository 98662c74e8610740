"""Least squares: covariances against NumPy's inverse, robust weights on normal errors."""

import numpy as np
import pytest
from scipy import stats

from microlib._common import (
    TUKEY_LIMIT,
    NormalEquations,
    gauss_newton,
    inverse_normal,
    robust_std,
    tukey_weights,
)

rng = np.random.default_rng(0)


def test_determined_problem_has_the_plain_inverse():
    jacobian = rng.normal(size=(30, 4)) * [1e6, 1.0, 1e-3, 1e-12]
    # Scaled to unit columns the condition is below 3, so a few roundings are left.
    scale = np.linalg.norm(jacobian, axis=0)
    found = inverse_normal(jacobian) * np.outer(scale, scale)
    expected = np.linalg.inv((jacobian / scale).T @ (jacobian / scale))
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


def test_undetermined_direction_has_infinite_variance_and_leaves_the_others():
    """The second and fourth parameter change the residuals alike: only their sum is seen."""
    jacobian = rng.normal(size=(20, 4)) * [1.0, 1e3, 1e-3, 1.0]
    jacobian[:, 3] = 5 * jacobian[:, 1]
    found = inverse_normal(jacobian)
    assert np.isinf(found[[1, 3], [1, 3]]).all()
    known = np.ix_([0, 2], [0, 2])
    assert np.isnan(found).sum() == 16 - 4 - 2
    # The others have the covariance that they have when the sum is one parameter.
    fewer = np.linalg.inv(jacobian[:, :3].T @ jacobian[:, :3])
    np.testing.assert_allclose(found[known], fewer[known], rtol=1e-9)


@pytest.mark.parametrize(("gap", "known"), [(1e-7, True), (1e-11, False)])
def test_direction_is_determined_unless_rounding_decides(gap, known):
    """Columns that differ by 1e-7 are told apart, with the huge variance that this means; the
    inverse of JᵀJ itself, with 1e-14 beside 1, would be rounding."""
    first, second = np.linalg.qr(rng.normal(size=(40, 2)))[0].T
    found = inverse_normal(np.column_stack([first, first + gap * second]))
    # By hand: both variances are 1/gap², to rounding over gap.
    expected = gap**-2 if known else np.inf
    np.testing.assert_allclose(np.diag(found), expected, rtol=1e-7)


def test_biweight_is_95_percent_efficient_and_median_gives_std_for_normal_errors():
    errors = stats.norm.ppf((np.arange(20_000) + 0.5) / 20_000)
    assert robust_std(-3.0 * errors) == pytest.approx(3.0, rel=1e-4)
    near = np.stack([errors - 1e-6, errors + 1e-6])
    slope = np.diff(near * tukey_weights(near, TUKEY_LIMIT), axis=0)[0] / 2e-6
    psi = errors * tukey_weights(errors, TUKEY_LIMIT)
    # The variance of the mean over that of an M-estimate.
    assert slope.mean() ** 2 / np.mean(psi**2) == pytest.approx(0.95, abs=1e-3)


def test_gauss_newton_damps_steps_that_increase_the_cost():
    """The zero of arctan x, from which plain steps from x = 3 lead away."""

    def linearize(x, numbers):
        slope, residual = 1 / (1 + x**2), -np.arctan(x)
        return NormalEquations((slope**2)[:, :, None], slope * residual, residual[:, 0] ** 2)

    starts = np.array([[3.0], [np.nan], [-0.5]])
    found, _, converged = gauss_newton(linearize, starts, max_iterations=40, cost_tolerance=1e-9)
    np.testing.assert_allclose(found[[0, 2]], 0.0, atol=1e-6)
    assert converged.tolist() == [True, False, True]
