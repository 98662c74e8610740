"""The laws of a stretched membrane, against their own energies and each other."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from microlib.membrane.large._laws import constitutive_law
from tests.membrane.energy import density

RATIOS = {"hooke": 0.3, "neo-hooke": 0.5, "mooney-rivlin": 0.5}
STRETCHES = np.random.default_rng(0).uniform([1.0, 0.8], [3.0, 2.0], (300, 2)).T


@pytest.mark.parametrize("name", RATIOS)
def test_stresses_are_derivatives_of_relaxed_energy(name: str) -> None:
    law = constitutive_law(name, RATIOS[name])
    first, second = STRETCHES
    step = 1e-6

    def slope(way: list[list[float]]) -> NDArray:
        up, down = (
            density(name, STRETCHES + by * np.array(way), RATIOS[name]) for by in (step, -step)
        )
        return (up - down) / (2 * step)

    along, across = slope([[1.0], [0.0]]), slope([[0.0], [1.0]])
    got = law.tension_field_stress(first, second)
    assert (got[1] == 0).any()  # some are wrinkled
    np.testing.assert_allclose(got, [along, across], atol=3e-9)


@pytest.mark.parametrize("name", RATIOS)
def test_invert_meridian_stress_inverts_tension_field_stress(name: str) -> None:
    law = constitutive_law(name, RATIOS[name])
    first, second = STRETCHES
    along, across = law.tension_field_stress(first, second)
    got, hoop = law.invert_meridian_stress(along, second)
    np.testing.assert_allclose(got, first, rtol=1e-12)
    np.testing.assert_allclose(hoop, across, atol=1e-12)


@pytest.mark.parametrize("name", RATIOS)
def test_slack_membrane_has_no_stress(name: str) -> None:
    law = constitutive_law(name, RATIOS[name])
    stretch = np.array([0.7, 0.95]), np.array([0.9, 1.0])
    assert not np.any(law.tension_field_stress(*stretch))
