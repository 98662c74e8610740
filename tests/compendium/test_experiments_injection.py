"""The injection of a simulated egg: contact, force and depth beside the truth."""

from __future__ import annotations

import numpy as np
import pytest

from compendium.experiments.injection import Egg, see


@pytest.fixture(scope="module")
def egg():
    return Egg(np.random.default_rng([5, 81]))


def test_untouched_egg_has_no_force_and_is_round(egg):
    assert egg.way(egg.home) == 0.0
    assert float(egg.force(0.0)) == float(egg.depth(0.0)) == 0.0
    sight = see(egg.frame(egg.home))
    np.testing.assert_allclose(sight.tip, egg.home, atol=0.1)
    # The circle through the wall's middle: its crown lies half a wall below the place of contact.
    assert sight.center[1] - sight.radius == pytest.approx(egg.contact[1] + 1.5 / 3.875, abs=0.1)
    assert abs(sight.sunk(sight)) < 0.05
