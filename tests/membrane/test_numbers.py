"""Of numbers the formulas return a number, of arrays an array, as their types say."""

from __future__ import annotations

from typing import assert_type

import numpy as np
import pytest

from microlib import membrane
from microlib._common import Array
from tests import fuzz

pytestmark = pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
NAMES = ["elastic_modulus", "indentation_force", "dimple_depth", "membrane_stress", "mean_strain"]


@pytest.mark.parametrize("name", NAMES)
def test_of_numbers_a_number_of_arrays_an_array(name: str) -> None:
    function, given = getattr(membrane, name), fuzz.valid_call(f"membrane.{name}")
    one = function(**given)
    assert isinstance(one, float)
    several = function(**given | {"probe_half_width": np.array([17.0, 30.0])})
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
