"""Chapter 4: exponents, spread and corrections of the modulus against closed forms."""

from __future__ import annotations

import pytest

from compendium.experiments import chapter_4


@pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
def test_modulus_exponents_equal_formula():
    found = chapter_4.exponents()
    known = {"force": 1, "dimple depth": -3, "thickness": -1, "poisson ratio": -1}
    assert found[list(known)].to_dict() == pytest.approx(known, abs=1e-5)
    # E grows as a² times a function of c/a alone.
    assert found["dimple radius"] + found["probe half width"] == pytest.approx(2, abs=1e-4)
