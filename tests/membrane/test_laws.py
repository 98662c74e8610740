"""The constitutive laws against the derivatives of their energies."""

import numpy as np
import pytest

from microlib.membrane.large._laws import constitutive_law
from tests.membrane.energy import stresses


@pytest.mark.parametrize(
    ("name", "ratio"), [("hooke", 0.3), ("neo-hooke", 0.5), ("mooney-rivlin", 0.5)]
)
def test_stresses_and_stretch_match_derivatives_of_relaxed_energy(name: str, ratio: float) -> None:
    stretches = np.random.default_rng(0).uniform([1.0, 0.8], [3.0, 2.0], (300, 2)).T
    along, hoop = wanted = stresses(name, stretches, ratio)
    taut = np.abs(hoop) > 1e-9
    assert not taut.all()  # some are wrinkled
    law = constitutive_law(name, ratio)
    found = law.invert_meridian_stress(along, stretches[1])
    # The stress of rubber grows by 0.17 per stretch or more.
    np.testing.assert_allclose(found, [stretches[0], hoop], atol=2e-8)
    found = law.biaxial_stress(*stretches[:, taut])
    np.testing.assert_allclose(found, wanted[:, taut], atol=2e-8)
