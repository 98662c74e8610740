"""The relaxing force against its differential equation, solved by Runge–Kutta."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from microlib.membrane import viscoelastic_force

PRONY, TIMES = np.array([0.3, 0.25]), np.array([0.4, 5.0])


def test_force_matches_maxwell_elements_solved_by_runge_kutta() -> None:
    """Maxwell elements beside a spring: q' = g F' − q/τ, of a force that is no straight line."""
    time = np.linspace(0, 12, 2401)

    def pressed(t: np.ndarray) -> np.ndarray:
        return 80 * (1 - np.cos(0.9 * t)) + 3 * t

    def slopes(t: float, q: np.ndarray) -> np.ndarray:
        return PRONY * (72 * np.sin(0.9 * t) + 3) - q / TIMES

    held = solve_ivp(slopes, (0, 12), np.zeros(2), t_eval=time, rtol=1e-10, atol=1e-10).y
    wanted = (1 - PRONY.sum()) * pressed(time) + held.sum(axis=0)
    found = viscoelastic_force(
        time, pressed(time), prony_coefficients=PRONY, relaxation_times=TIMES
    )
    # Chords of 5 ms leave F''Δ²/8 = 2e-4.
    np.testing.assert_allclose(found, wanted, atol=5e-4)


def test_step_relaxes_and_slow_push_has_relaxed_stiffness() -> None:
    time = np.array([0.0, 0.1, 1.0, 3.0, 1000.0])
    held = viscoelastic_force(
        time, np.full(5, 10.0), prony_coefficients=PRONY, relaxation_times=TIMES
    )
    wanted = 10 * (1 - PRONY @ (1 - np.exp(-time / TIMES[:, np.newaxis])))
    np.testing.assert_allclose(held, wanted, rtol=1e-12)
    slow = viscoelastic_force(
        [0.0, 1e6], [0.0, 10.0], prony_coefficients=PRONY, relaxation_times=TIMES
    )
    assert slow[1] == pytest.approx(10 * (1 - PRONY.sum()), rel=1e-4)
    # So slow a relaxation is none.
    fast = viscoelastic_force(time, time, prony_coefficients=[0.5], relaxation_times=[1e50])
    np.testing.assert_allclose(fast, time)


def test_intermediate_times_change_nothing() -> None:
    law = {"prony_coefficients": PRONY, "relaxation_times": TIMES}
    few = viscoelastic_force([0.0, 1.0, 4.0], [0.0, 10.0, 4.0], **law)
    time = np.array([0.0, 0.2, 1.0, 1.5, 2.9, 4.0])
    rows = np.stack([np.interp(time, [0, 1, 4], [0, 10, 4]), np.ones(6)])
    many = viscoelastic_force(time, rows, **law)
    np.testing.assert_allclose(many[0, [0, 2, 5]], few, rtol=1e-12)
    np.testing.assert_allclose(many[1], viscoelastic_force(time, np.ones(6), **law))
