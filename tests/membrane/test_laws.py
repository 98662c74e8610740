"""The constitutive laws against the derivatives of their energies."""

import numpy as np
import pytest
from numpy.typing import NDArray

from microlib.membrane.large._laws import constitutive_law
from tests.membrane.energy import density


@pytest.mark.parametrize(
    ("name", "ratio"), [("hooke", 0.3), ("neo-hooke", 0.5), ("mooney-rivlin", 0.5)]
)
def test_stretch_and_hoop_stress_match_derivatives_of_relaxed_energy(
    name: str, ratio: float
) -> None:
    stretches = np.random.default_rng(0).uniform([1.0, 0.8], [3.0, 2.0], (300, 2)).T
    step = 1e-6

    def stress(direction: list[list[float]]) -> NDArray:
        up, down = (
            density(name, stretches + by * np.array(direction), ratio) for by in (step, -step)
        )
        return (up - down) / (2 * step)

    along, hoop = stress([[1.0], [0.0]]), stress([[0.0], [1.0]])
    assert (np.abs(hoop) < 1e-9).any()  # some are wrinkled
    found = constitutive_law(name, ratio).invert_meridian_stress(along, stretches[1])
    # The differences err by 3e-9, and the stress of rubber grows by 0.17 per stretch or more.
    np.testing.assert_allclose(found, [stretches[0], hoop], atol=2e-8)
