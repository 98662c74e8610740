"""What checks and measures a solved membrane, on functions that are known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from microlib.membrane import _outline
from microlib.membrane._bending import _bending_energy
from microlib.membrane._disc import _bracket
from microlib.membrane._outline import _correlation, _covariance, _signed_distances, _starts
from microlib.membrane._state import gauss_points, reintegration_error


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


def test_distances_are_to_the_nearest_part_with_a_side() -> None:
    r, z = np.array([1.0, 4.0, 4.0]), np.array([0.0, 0.0, -3.0])
    across, up = (
        np.array([2.0, 2.0, 0.0, 6.0, 3.5, 4.0]),
        np.array([1.0, -1.5, 0.0, 2.0, -2.0, -5.0]),
    )
    found = _signed_distances(across, up, r, z)
    np.testing.assert_allclose(np.abs(found), [1.0, 1.5, 1.0, np.hypot(2, 2), 0.5, 2.0])
    assert (np.sign(found[:2]) == [-1.0, 1.0]).all()
    assert found[3] < 0 < found[4]  # outside, above, and inside


def test_neighbors_that_agree_count_for_one() -> None:
    assert _correlation(np.array([1.0, 1.0, 1.0, 1.0])) == pytest.approx(0.75)
    assert _correlation(np.array([1.0, -1.0, 1.0])) == pytest.approx(-2 / 3)
    assert _correlation(np.zeros(4)) == 0
    rng = np.random.default_rng(0)
    jacobian = rng.standard_normal((40, 3))
    left = np.cumsum(rng.standard_normal(40))
    # All pairs of points, by weights that fall to none at the root of their number apart.
    apart = np.abs(np.subtract.outer(np.arange(40), np.arange(40)))
    weight = np.maximum(1 - apart / 6, 0)
    score = jacobian * left[:, None]
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    expected = inverse @ score.T @ weight @ score @ inverse * 40 / 37
    np.testing.assert_allclose(_covariance(jacobian, left), expected)


SETTINGS = {"thickness": 3.0, "probe_half_width": 25.0}


def dimpled(side: int = 0) -> np.ndarray:
    """A circle of 500 µm at (40, 600) with a dimple of 200 µm radius and a logarithm's depth."""
    angle = np.linspace(-1.9, 1.9, 801)
    x, z = 500 * np.sin(angle), 500 * np.cos(angle)
    rim = 200.0
    inside = np.abs(x) < rim
    beside = np.maximum(np.abs(x), 25.0)
    z = np.where(inside & (z > 0), 490.0 - 40.0 * np.log(rim / beside), z)
    z = np.where(~inside & (z > 0), np.minimum(z, 490.0 - 0.002 * (np.abs(x) - rim) ** 2 / 2), z)
    points = np.column_stack([x, z])
    points = points[np.abs(x) > 30.0]
    if side:
        points = points[points[:, 0] > 0]
        return np.add(points, [0.0, 600.0])
    return np.add(points, [40.0, 600.0])


@pytest.mark.parametrize("side", [0, 1])
def test_a_search_begins_where_the_outline_turns(monkeypatch, side: int) -> None:
    asked = []

    def capsule(force: float, rim: float, depth: float, *, radius: float, **settings: Any) -> Any:
        asked.append((force, rim, depth, radius, settings))
        if len(asked) == 1:
            raise ValueError("no such capsule")
        state = type("State", (), {"z": np.array([0.0, 900.0])})
        return type("Shell", (), {"modulus": 2.0, "inflation": 1.03, "state": state})

    monkeypatch.setattr(_outline, "capsule_modulus", capsule)
    points = dimpled(side)
    starts = list(_starts(70.0, points, 25.0, None, SETTINGS, None))
    assert len(asked) == 12
    assert len(starts) == 11
    force, rim, depth, radius, settings = asked[0]
    assert (force, settings) == (70.0, SETTINGS)
    assert radius == pytest.approx(500.0, rel=1e-4)
    assert rim == pytest.approx(200.0, rel=0.25)
    # Down to the probe's edge, beyond where the outline ends.
    assert depth == pytest.approx(40.0 * np.log(200 / 25), rel=0.05)
    shares = [(a[1] / rim, a[2] / depth) for a in asked]
    expected = [(w, d) for w in (1.0, 0.9, 1.1, 0.8) for d in (1.0, 1.4, 2.0)]
    np.testing.assert_allclose(shares, expected)
    axis = 0.0 if side else 40.0
    np.testing.assert_allclose(
        starts[0], [np.log(2.0), 1.03, axis, points[:, 1].max() - 900.0, radius], atol=2.0
    )
    known = list(_starts(70.0, points, 25.0, 480.0, SETTINGS, None))
    assert len(known[0]) == 4
    assert asked[-1][3] == 480.0


def test_a_start_that_is_given_comes_first(monkeypatch) -> None:
    asked = []

    def capsule(force: float, **settings: Any) -> Any:
        asked.append((force, settings))
        if settings["modulus"] > 10:
            raise ValueError("no such capsule")
        return type("State", (), {"z": np.array([0.0, 1050.0])})

    monkeypatch.setattr(_outline, "indent_capsule", capsule)
    points = dimpled()
    first = next(_starts(70.0, points, 25.0, None, SETTINGS, (1.7, 1.04)))
    crest = points[:, 1].max()
    size = float(np.abs(points[:, 0] - 40.0).max())
    np.testing.assert_allclose(first, [np.log(1.7), 1.04, 40.0, crest - 1050.0, size], atol=1e-6)
    assert asked[0] == (
        70.0, {"modulus": 1.7, "inflation": 1.04, "radius": pytest.approx(size), **SETTINGS}
    )  # fmt: skip
    # One that is no capsule is passed over.
    other = next(_starts(70.0, points, 25.0, None, SETTINGS, (100.0, 1.04)))
    assert other[0] != pytest.approx(np.log(100.0))


def test_moduli_to_either_side_of_a_dimple() -> None:
    def excess(log_modulus: float) -> float:
        return 3.3 - log_modulus

    for start in (0.0, 3.0, 8.0, -8.0):
        low, high = _bracket(excess, start, 5.0)
        assert low <= 3.3 <= high
        assert high - low <= 1.0
    with pytest.raises(ValueError, match="got 5 µm: the stiffest membrane tried hangs deeper"):
        _bracket(excess, -10.0, 5.0)
    with pytest.raises(ValueError, match="softer membranes are not deep enough or fold"):
        _bracket(excess, 30.0, 5.0)

    def folding(log_modulus: float) -> float:
        if log_modulus < 3.2:
            raise ValueError("folds")
        return 3.3 - log_modulus

    low, high = _bracket(folding, 5.0, 5.0)
    assert 3.2 <= low <= 3.3 <= high


def test_bending_at_the_plates_edge_is_that_of_the_wall_that_leaves_it() -> None:
    """Four points: the probe's edge, the wall, where it meets the plate, and the plate's middle."""
    r, z = np.array([20.0, 90.0, 60.0, 0.0]), np.array([150.0, 80.0, 0.0, 0.0])
    first, second = np.array([1.2, 1.1, 1.05, 1.0]), np.array([1.0, 1.15, 1.1, 1.0])
    stresses = np.array([[0.8, 0.6, 0.5, 0.4], [0.2, 0.5, 0.4, 0.4]])
    pressure, rim, h, natural, rigidity, nu = 0.02, 40.0, 3.0, 1 / 100, 7.0, 0.3
    state = SimpleNamespace(
        r=r, z=z, stretches=np.stack([first, second]), stresses=stresses, pressure=pressure,
        rim_radius=rim,
    )  # fmt: skip
    along, across = h * stresses[0] / second, h * stresses[1] / first

    def density(meridian: float, hoop: float, k: int) -> float:
        k1, k2 = first[k] * meridian - natural, second[k] * hoop - natural
        return rigidity / 2 * (k1**2 + k2**2 + 2 * nu * k1 * k2)

    sine = pressure * (r**2 - rim**2) / (2 * r.clip(1) * along)
    free = [density((pressure - s / x * t) / a, s / x, k) for k, (s, x, t, a) in
            enumerate(zip(sine[:2], r[:2], across[:2], along[:2], strict=True))]  # fmt: skip
    flat = [density(0.0, 0.0, k) for k in (2, 3)]
    leaving = density(pressure / along[2], 0.0, 2)
    weight, length = 2 * np.pi * r / (first * second), np.hypot(np.diff(r), np.diff(z))
    smooth = sum(
        (a * weight[k] + b * weight[k + 1]) / 2 * length[k]
        for k, (a, b) in enumerate([(free[0], free[1]), (free[1], leaving), (flat[0], flat[1])])
    )
    angle = np.arcsin(-sine[0])
    corner = 2 * np.pi * r[0] * 4 * np.sqrt(rigidity * along[0]) * (1 - np.cos(angle / 2))
    assert angle > 0.1
    found = _bending_energy(state, rigidity, nu, h, natural)
    assert found == pytest.approx(smooth + corner)
