"""What proves a solved membrane, on functions that are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from microlib.membrane._solver import gauss_points, reintegration_error


def test_five_abscissae_integrate_the_ninth_power() -> None:
    mesh = np.array([-1.0, 0.5, 0.7, 2.0])
    x, weight = gauss_points(mesh)
    assert x.shape == weight.shape == (15,)
    assert (np.diff(x) > 0).all()
    assert weight.sum() == pytest.approx(3.0)
    assert weight @ x**9 == pytest.approx((2.0**10 - 1) / 10)
    assert weight @ x**10 != pytest.approx((2.0**11 + 1) / 11, rel=1e-9)


def test_a_solution_that_is_none_is_missed_by_what_it_is_off() -> None:
    mesh = np.linspace(0.0, 2.0, 21)

    def slopes(x: Any, y: Any) -> Any:
        return np.stack([y[1], -y[0] + 0 * x])

    exact = np.stack([4 * np.sin(mesh), 4 * np.cos(mesh)])
    # Runge–Kutta of a fortieth: 0.025⁵/120 each, summed, is 1e-8.
    assert reintegration_error(slopes, mesh, exact) < 1e-7
    off = exact.copy()
    off[0, 7] += 1e-3
    # The step to it and the one from it miss: by itself, and by cos 0.1 of it.
    expected = 1e-3 * (1 + np.cos(0.1)) / 4
    assert reintegration_error(slopes, mesh, off) == pytest.approx(expected, rel=1e-3)
    # A state that is zero throughout has the size 0.1.
    small = np.zeros_like(exact)
    small[0, 7] = 1e-3
    assert reintegration_error(slopes, mesh, small) == pytest.approx(4 * expected * 10, rel=1e-3)

    def uneven(x: Any, y: Any) -> Any:
        return np.stack([3 * x**2, 0 * x])  # in which x alone decides

    cubic = np.stack([5 + mesh**3, 0 * mesh])
    assert reintegration_error(uneven, mesh, cubic) < 1e-12
