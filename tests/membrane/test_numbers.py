"""Of numbers the formulas return a number, of arrays an array, as their types say."""

from __future__ import annotations

from typing import assert_type

import numpy as np
import pytest

from microlib import membrane
from microlib._common import Array

DIMPLE = {"dimple_radius": 250.0, "dimple_depth": 20.0, "probe_half_width": 25.0}
MATERIAL = {"thickness": 3.0, "poisson_ratio": 0.4}
CALLS = {
    "elastic_modulus": DIMPLE | MATERIAL | {"force": 1.3},
    "indentation_force": DIMPLE | MATERIAL | {"modulus": 1.3},
    "dimple_profile": DIMPLE | {"radius": 70.0},
    "membrane_stress": DIMPLE | {"force": 1.3, "thickness": 3.0},
    "mean_strain": DIMPLE,
}
CALLS["dimple_depth"] = CALLS["indentation_force"] | {"force": 1.3}
del CALLS["dimple_depth"]["dimple_depth"]


@pytest.mark.parametrize("name", CALLS)
def test_of_numbers_a_number_of_arrays_an_array(name: str) -> None:
    function, given = getattr(membrane, name), CALLS[name]
    one = function(**given)
    assert isinstance(one, float)
    several = function(**given | {"probe_half_width": np.array([25.0, 30.0])})
    assert isinstance(several, np.ndarray)
    assert several.shape == (2,)
    assert several[0] == pytest.approx(one, rel=1e-12)


def test_a_type_checker_sees_the_same() -> None:
    """By `mypy`, which reads this module, too."""
    film = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.4}
    drop = {"probe_half_width": 25.0}
    assert_type(membrane.elastic_modulus(1.3, 250.0, 20.0, **film), float)
    assert_type(membrane.elastic_modulus([1.3, 2.0], 250.0, 20.0, **film), Array)
    assert_type(membrane.indentation_force(1.3, 250.0, np.ones(2), **film), Array)
    assert_type(membrane.dimple_depth(1.3, 250.0, 100.0, **film), float)
    assert_type(membrane.mean_strain(250.0, 20.0, **drop, small_slopes=False), float)
    assert_type(membrane.dimple_profile(np.ones(3) * 70.0, 250.0, 20.0, **drop), Array)
