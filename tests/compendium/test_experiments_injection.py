"""The injection of a simulated egg: contact, force and depth beside the truth."""

from __future__ import annotations

import numpy as np
import pytest

from compendium.experiments.injection import Egg, press, see


@pytest.fixture(scope="module")
def egg() -> Egg:
    return Egg(np.random.default_rng([5, 81]))


def test_an_untouched_egg_bears_nothing_and_is_round(egg) -> None:
    assert egg.way(egg.home) == 0.0
    assert float(egg.force(0.0)) == float(egg.depth(0.0)) == 0.0
    sight = see(egg.frame(egg.home))
    np.testing.assert_allclose(sight.tip, egg.home, atol=0.1)
    # The circle through the wall's middle: its crown lies half a wall below the place of contact.
    assert sight.center[1] - sight.radius == pytest.approx(egg.contact[1] + 1.5 / 3.875, abs=0.1)
    assert abs(sight.sunk(sight)) < 0.05


def test_force_and_depth_rise_with_the_way(egg) -> None:
    ways = np.linspace(0.0, 0.8 * egg.force.x[-1], 50)
    assert (np.diff(egg.force(ways)) > 0).all()
    assert (np.diff(egg.depth(ways)) > -1e-6).all()
    # A dimple is less deep than the way, since the whole egg yields.
    assert (egg.depth(ways) <= ways).all()


def test_contact_is_seen_and_the_force_reached() -> None:
    pressed = press(5)
    # Of six seeds: contact 0.7 to 1.2 µm late, force within 1.2 %, depth within 0.2 %.
    assert 0.0 <= pressed["late"] < 2.0
    assert abs(pressed["force error"]) < 0.04
    assert abs(pressed["depth error"]) < 0.01
    log = pressed["log"]
    assert list(log["phase"].unique()) == ["approach", "press", "withdraw"]
    assert log["true_force"].iloc[-1] == 0.0
    assert len(pressed["pictures"]) == 3
