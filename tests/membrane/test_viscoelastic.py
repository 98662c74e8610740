"""The relaxing force against its differential equation, solved by Runge–Kutta."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from microlib.membrane import viscoelastic_force

PRONY, TIMES = np.array([0.3, 0.25]), np.array([0.4, 5.0])
LAW = {"prony_coefficients": PRONY, "relaxation_times": TIMES}


def test_force_matches_maxwell_elements_solved_by_runge_kutta() -> None:
    """Maxwell elements beside a spring: q' = g F' − q/τ, and the first force is instantaneous."""
    time = 3.7 + np.array([0.0, 0.2, 1.0, 2.9, 4.0])
    force = np.array([[2.0, 5.0, 4.0, 4.0, 9.0], [0.0, 2.0, 2.5, 1.0, 1.0]])
    found = viscoelastic_force(time, force, **LAW)
    for row, relaxed in zip(force, found, strict=True):
        held = PRONY * row[0]
        assert relaxed[0] == pytest.approx(row[0])
        for k, rate in enumerate(np.diff(row) / np.diff(time)):
            held = solve_ivp(
                lambda _, q, rate=rate: PRONY * rate - q / TIMES,
                time[k : k + 2], held, rtol=1e-10, atol=1e-10,
            ).y[:, -1]  # fmt: skip
            wanted = (1 - PRONY.sum()) * row[k + 1] + held.sum()
            assert relaxed[k + 1] == pytest.approx(wanted, rel=1e-8)


def test_step_relaxes_and_slow_push_has_relaxed_stiffness() -> None:
    time = np.array([0.0, 0.1, 1.0, 3.0, 1000.0])
    held = viscoelastic_force(time, np.full(5, 10.0), **LAW)
    wanted = 10 * (1 - PRONY @ (1 - np.exp(-time / TIMES[:, np.newaxis])))
    np.testing.assert_allclose(held, wanted, rtol=1e-12)
    slow = viscoelastic_force([0.0, 1e6], [0.0, 10.0], **LAW)
    assert slow[1] == pytest.approx(10 * (1 - PRONY.sum()), rel=1e-4)
    # A relaxation time far beyond the test does not relax.
    elastic = viscoelastic_force(time, time, prony_coefficients=[0.5], relaxation_times=[1e50])
    np.testing.assert_allclose(elastic, time)
