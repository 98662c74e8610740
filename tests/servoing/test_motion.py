"""The Jacobian from test moves against the truth that the looks were made with."""

import numpy as np
import pytest

from microlib.servoing._motion import StageMotion, calibration_moves, fit_motion

JACOBIAN = np.array([[0.1, -0.35], [-0.4, -0.05]])
DRIFT = np.array([0.3, -0.2])


def looks(rng, covariance, *, excess=1.0, count=9):
    """Return observations at the test moves, with `excess` times the stated noise."""
    position = np.vstack([np.zeros(2), calibration_moves(25.0)])[:count]
    time = np.linspace(0.0, 2.0, count) ** 1.1  # not evenly, as frames come
    noise = rng.multivariate_normal(np.zeros(2), excess * covariance, len(position))
    feature = (80.0, 60.0) + position @ JACOBIAN.T + np.outer(time, DRIFT) + noise
    return time, position, feature, np.broadcast_to(covariance, (len(position), 2, 2))


@pytest.mark.parametrize("excess", [1.0, 4.0])
def test_jacobian_covariance_matches_scatter_of_repeated_fits(excess):
    rng = np.random.default_rng(1)
    covariance = np.array([[4e-4, 2e-4], [2e-4, 9e-4]])
    every = [fit_motion(*looks(rng, covariance, excess=excess)) for _ in range(400)]
    errors = [np.append(found.jacobian - JACOBIAN, found.drift - DRIFT) for found in every]
    # χ² of 10 degrees of freedom over 10 has the mean 1 and the deviation 0.45; the floor of 1e-3
    # px and 400 draws leave 3 %.
    assert np.mean([found.misfit for found in every]) == pytest.approx(excess, rel=0.08)
    # And a mean to a twentieth of the deviation of one: four of those.
    assert (np.abs(np.mean(errors, axis=0)) < 0.2 * np.std(errors, axis=0)).all()
    spread = np.mean([found.covariance for found in every], axis=0)
    whitened = np.linalg.solve(np.cov(np.array(errors)[:, :4].T), spread)
    # 400 draws know a variance to 7 %; where the tracks explain the scatter, enlarging it
    # whenever χ² is above its mean makes the covariance a fifth too large, never too small.
    high = 1.35 if excess == 1.0 else 1.25
    values = np.linalg.eigvals(whitened).real
    assert values.min() > 0.8
    assert values.max() < high * 1.1


def test_jacobian_fit_weights_frames_by_their_covariance():
    rng = np.random.default_rng(2)
    time, position, feature, covariance = looks(rng, 1e-6 * np.eye(2))
    weights = np.array(covariance)
    feature[3] += 5.0
    weights[3] *= 1e10
    found = fit_motion(time, position, feature, weights)
    np.testing.assert_allclose(found.jacobian, JACOBIAN, atol=2e-4)


def test_jacobian_covariance_is_infinite_if_an_axis_never_moved():
    time, position, feature, covariance = looks(np.random.default_rng(4), 1e-4 * np.eye(2))
    position[:, 1] = 0.0
    assert fit_motion(time, position, feature, covariance).relative_error == float("inf")


def test_jacobian_covariance_is_not_reduced_by_a_misfit_below_one():
    exact, noisy = (
        fit_motion(*looks(np.random.default_rng(3), 1e-3 * np.eye(2), excess=excess))
        for excess in (1e-6, 1.0)
    )
    assert exact.misfit < 0.01
    # The covariance is that of the tracks, which are the same; χ² above 1 may enlarge the other.
    enlarged = max(1.0, noisy.misfit)
    np.testing.assert_allclose(exact.covariance * enlarged, noisy.covariance, rtol=1e-9, atol=1e-18)


def test_relative_error_is_three_sigma_over_smallest_singular_value():
    motion = StageMotion(np.diag([2.0, -0.5]), np.diag([1.0, 2.0, 3.0, 4.0]) * 1e-4, np.zeros(2), 1)
    assert motion.relative_error == pytest.approx(3 * 0.02 / 0.5)
