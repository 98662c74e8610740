"""The laws of a stretched membrane, against their own energies and each other."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from microlib.membrane.large._laws import law_of
from tests.membrane.energy import density

RATIOS = {"hooke": 0.3, "neo-hooke": 0.5, "mooney-rivlin": 0.5}
STRETCHES = np.random.default_rng(0).uniform([1.0, 0.8], [3.0, 2.0], (300, 2)).T


@pytest.mark.parametrize("name", RATIOS)
def test_stresses_are_the_slopes_of_the_relaxed_energy(name: str) -> None:
    law = law_of(name, RATIOS[name])
    first, second = STRETCHES
    step = 1e-6

    def slope(way: list[list[float]]) -> NDArray:
        up, down = (
            density(name, STRETCHES + by * np.array(way), RATIOS[name]) for by in (step, -step)
        )
        return (up - down) / (2 * step)

    along, across = slope([[1.0], [0.0]]), slope([[0.0], [1.0]])
    got = law.relaxed_stress(first, second)
    assert (got[1] == 0).any()  # some are wrinkled
    np.testing.assert_allclose(got, [along, across], atol=3e-9)


@pytest.mark.parametrize("name", RATIOS)
def test_the_meridian_returns_the_stretch_that_bears_its_stress(name: str) -> None:
    law = law_of(name, RATIOS[name])
    first, second = STRETCHES
    along, across = law.relaxed_stress(first, second)
    got, hoop = law.meridian(along, second)
    np.testing.assert_allclose(got, first, rtol=1e-12)
    np.testing.assert_allclose(hoop, across, atol=1e-12)


@pytest.mark.parametrize("name", RATIOS)
def test_the_modulus_is_one_at_small_strain(name: str) -> None:
    law = law_of(name, RATIOS[name])
    small, nu = 1e-6, RATIOS[name]
    # A strip that contracts freely across bears E e.
    assert law.strip(np.array(1 + small)) / small == pytest.approx(1, rel=1e-5)
    along, across = law.stress(np.array(1 + small), np.array(1 - nu * small))
    assert along / small == pytest.approx(1, rel=1e-5)
    assert across / small == pytest.approx(0, abs=1e-5)


@pytest.mark.parametrize("name", RATIOS)
def test_a_slack_membrane_bears_nothing(name: str) -> None:
    law = law_of(name, RATIOS[name])
    stretch = np.array([0.7, 0.95]), np.array([0.9, 1.0])
    assert not np.any(law.relaxed_stress(*stretch))


@pytest.mark.parametrize(
    ("name", "ratio", "message"),
    [
        ("rubber", 0.5, "law must be one of hooke, neo-hooke, mooney-rivlin"),
        ("neo-hooke", 0.3, r"poisson_ratio must be 0\.5"),
        ("hooke", 0.6, "poisson_ratio must be at most 0.5, got 0.6"),
    ],
)
def test_impossible_laws_are_refused(name: str, ratio: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        law_of(name, ratio)
