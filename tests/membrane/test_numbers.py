"""Of numbers the formulas return a number, of arrays an array."""

import numpy as np
import pytest

from microlib import membrane
from tests import fuzz

pytestmark = pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
NAMES = ["elastic_modulus", "indentation_force", "dimple_depth", "membrane_stress", "mean_strain"]


@pytest.mark.parametrize("name", NAMES)
def test_scalars_give_a_scalar_and_arrays_an_array(name: str) -> None:
    function, given = getattr(membrane, name), fuzz.valid_call(f"membrane.{name}")
    one = function(**given)
    assert isinstance(one, float)
    radius = given["rim_radius"] * np.array([[1.0], [1.1], [1.2]])
    several = function(**given | {"probe_half_width": [17.0, 30.0], "rim_radius": radius})
    assert isinstance(several, np.ndarray)
    assert several.shape == (3, 2)
    assert several[0, 0] == pytest.approx(one, rel=1e-12)
