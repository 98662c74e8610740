"""Chapter 4: exponents, spread and corrections of the modulus against closed forms."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from compendium.experiments import chapter_4
from microlib.membrane import SmallSlopeWarning


@pytest.fixture(autouse=True)
def quiet():
    with warnings.catch_warnings(action="ignore", category=SmallSlopeWarning):
        yield


def test_exponents_are_those_of_the_formula() -> None:
    found = chapter_4.exponents()
    known = {"force": 1, "dimple depth": -3, "thickness": -1, "poisson ratio": -1}
    assert found[list(known)].to_dict() == pytest.approx(known, abs=1e-5)
    # E grows as a² times a function of c/a alone.
    assert found["dimple radius"] + found["probe half width"] == pytest.approx(2, abs=1e-4)


def test_a_small_error_of_the_depth_triples_and_raises_the_mean() -> None:
    found = chapter_4.spread_of_modulus(np.array([1.0, 5.0]), np.random.default_rng(0))
    np.testing.assert_allclose(found["spread, first order"], [3, 15], rtol=1e-4)
    np.testing.assert_allclose(found["spread, drawn"], [3, 15], rtol=0.08)
    # E ~ w_d⁻³: to second order the mean is 6 σ² too large.
    assert found["shift of the mean, drawn"][5.0] == pytest.approx(6 * 0.05**2 * 100, rel=0.2)


def test_small_slopes_need_no_correction() -> None:
    found = chapter_4.slope_corrections([0.01, 0.1, 0.2, 0.49])
    np.testing.assert_allclose(found.loc[0.01], 1, atol=1e-3)
    strain, whole = found.to_numpy().T
    assert (np.diff(strain) > 0).all()
    assert whole[1:3] == pytest.approx([1.05, 1.25], abs=0.01)
    assert np.isnan(whole[-1])
