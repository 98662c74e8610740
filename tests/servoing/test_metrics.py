"""Figures of merit of known responses."""

import numpy as np
import pytest
from scipy.signal import lti, step

from microlib.servoing import path_metrics, step_metrics


def test_first_order_response_settles_at_the_time_of_its_exponential():
    time = np.linspace(0, 10, 10001)
    position = 3.0 * (1 - np.exp(-time / 1.7))[:, None]
    found = step_metrics(time, position, [3.0], band=0.02)
    assert found.settling_time == pytest.approx(1.7 * np.log(50), abs=1e-3)  # one sample
    assert found.accuracy == pytest.approx(0.02 * 3.0, rel=1e-3)
    # Mean and mean square of the exponential from the settling time to the end.
    end = 50 * np.exp(-10 / 1.7)
    rest = 0.06 * 1.7 / (10 - found.settling_time) * np.array([1 - end, 0.03 * (1 - end**2)])
    assert found.precision == pytest.approx(np.sqrt(rest[1] - rest[0] ** 2), rel=1e-2)
    assert found.overshoot == 0.0


def test_second_order_response_overshoots_by_the_damping_formula():
    damping = 0.4
    time, answer = step(lti([1], [1, 2 * damping, 1]), T=np.linspace(0, 30, 30001))
    found = step_metrics(time, answer[:, None], [1.0])
    peak = np.exp(-np.pi * damping / np.sqrt(1 - damping**2))
    assert found.overshoot == pytest.approx(peak, rel=1e-4)
    outside = time[np.abs(answer - 1) > 0.05]
    assert found.settling_time == pytest.approx(outside[-1], abs=2e-3)  # two samples


def test_settling_time_begins_with_the_first_sample_and_ends_at_the_band():
    """An error of half a unit is the default band of a step of ten."""
    found = step_metrics([3.0, 4.0, 6.0, 7.5], [[0.0], [4.0], [9.5], [10.0]], [10.0])
    assert [*vars(found).values()] == pytest.approx([3.0, 0.0, 0.5, 0.25])


def test_step_metrics_are_nan_where_the_response_does_not_settle():
    found = step_metrics([0, 1, 2], [[0.0], [2.0], [0.0]], [1.0])
    assert np.isnan([found.settling_time, found.accuracy, found.precision]).all()
    assert found.overshoot == 1.0


def test_path_metrics_are_mean_std_and_maximum_of_the_distances():
    rng = np.random.default_rng(1)
    error = rng.normal(0, 2.0, (4000, 2))
    found = path_metrics(error + 5.0, np.full((4000, 2), 5.0))
    # Rayleigh: mean σ√(π/2), standard deviation σ√(2 − π/2); 4000 samples give them to 1 %.
    assert found.accuracy == pytest.approx(2 * np.sqrt(np.pi / 2), rel=0.03)
    assert found.precision == pytest.approx(2 * np.sqrt(2 - np.pi / 2), rel=0.05)
    assert found.largest == pytest.approx(np.hypot(*error.T).max(), rel=1e-12)
