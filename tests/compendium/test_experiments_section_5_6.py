"""Section 5.6: draws, inversions and fits against the truth that they were made from."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize

from compendium import thesis
from compendium.experiments import section_5_6
from compendium.ledger import claim, half_ulp
from microlib.embryo import dimple_geometry
from microlib.membrane import indentation_force

pytestmark = pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")


def test_rounding_of_table_5_5_leaves_two_per_cent_of_modulus():
    draws = section_5_6.rounding_draws(seed=1, draws=400)
    # 400 draws know a standard deviation to 3.5 %, and their sum of 24 is near a Gaussian's.
    known = {"x_1": 0.23, "y_1": 0.023, "x_2": 0.028, "y_2": 0.14, "E": 0.025}
    for name, half_width in known.items():
        low, high = np.quantile(draws[name], [0.025, 0.975])
        assert (high - low) / 2 == pytest.approx(half_width, rel=0.15), name
    for name in section_5_6.READ[:4]:
        stated = claim(f"section-5.6/{name}")
        assert draws[name].median() == pytest.approx(stated.value, abs=0.2)


@pytest.fixture(scope="module")
def reach():
    return section_5_6.rounding_reach()


def test_printed_coordinates_need_nearly_all_of_the_rounding(reach):
    stated = [claim(f"section-5.6/{name}") for name in ("x_1", "y_1", "x_2", "y_2")]
    printed = np.array([one.value for one in stated])
    half = np.array([half_ulp(one.printed) for one in stated])
    # Enough: with this share the curve itself gives the four numbers as printed.
    assert np.abs(reach.units).max() == pytest.approx(reach.share, rel=1e-9)
    assert (np.abs(section_5_6.read_off(reach.units)[:4] - printed) <= half + 1e-8).all()
    assert 0.9 < reach.share < 1.0
    # Needed: whatever weights y the four have, |y·(printed − found)| − |y|·half is at most the
    # share times Σ|effectsᵀ y|, the linear programme's dual. The best weights reach its bound, but
    # for the curve's bend.
    steps = 0.1 * np.eye(24)
    effects = [section_5_6.read_off(s)[:4] - section_5_6.read_off(-s)[:4] for s in steps]
    effects = np.array(effects) / 0.2
    apart = printed - section_5_6.read_off()[:4]

    def bound(weights: np.ndarray) -> float:
        reached = np.abs(effects @ weights).sum()
        return float((apart @ weights - half @ np.abs(weights)) / reached)

    start = np.linalg.solve(effects.T @ effects, apart)
    best = minimize(lambda y: -bound(y * start), np.ones(4), method="Nelder-Mead", tol=1e-10)
    assert -best.fun == pytest.approx(reach.share, abs=0.02)
    # An even distribution has a third of the square of its half-width as its variance.
    covariance = (effects.T @ effects + np.diag(half**2)) / 3
    chi_squared = apart @ np.linalg.solve(covariance, apart)
    assert reach.chi_squared == pytest.approx(chi_squared, rel=0.02)


def test_printed_modulus_implies_probe_half_width_of_25_um():
    low, high = section_5_6.probe_half_widths()
    assert low < 25.0 < high
    assert high - low < 0.02
    narrow = section_5_6.probe_half_widths(coordinates=True)  # as the row of the modulus states
    assert narrow == pytest.approx((24.996, 25.002), abs=5e-4)
    # Each number of Table 5.6 off by half a unit, every combination: none gives a c outside.
    film = {"thickness": 3.0, "poisson_ratio": 0.5}
    printed = [claim(f"table-5.6/{name}") for name in ("a", "w_d", "F", "E")]
    for signs in product((-1, 1), repeat=4):
        a, w_d, force, modulus = (
            one.value + side * half_ulp(one.printed)
            for one, side in zip(printed, signs, strict=True)
        )
        needed = [
            indentation_force(modulus, a, w_d, probe_half_width=c, **film) - force
            for c in (low - 1e-6, high + 1e-6)
        ]
        assert needed[0] < 0 < needed[1]


def test_right_rim_is_highest_point_on_its_side():
    curve, pixel = thesis.outline_curve(), thesis.EMBRYO_PIXEL
    x0, y0 = dimple_geometry(curve, pixel_size=pixel).bottom
    x = np.linspace(x0, 265.0, 400_001)
    wanted = pixel * np.array([x[curve(x).argmax()] - x0, curve(x).max() - y0])
    assert section_5_6.right_dimple() == pytest.approx(wanted, abs=0.01)


def test_table_5_7_is_scaled_to_the_largest_force():
    # Four embryos that read the same at each force: nothing is left to chance.
    reading = np.array([1.0, 1.5, 2.0])
    made = pd.DataFrame({"force": [1.0, 2.0, 3.0] * 4, "thesis": np.tile(reading, 4)})
    found = section_5_6.table_5_7(np.random.default_rng(0), made, draws=7)
    scaled = reading / 2.0 * section_5_6.MODULUS
    assert found["mean"].to_list() == pytest.approx([scaled.mean()] * 7)
    assert found["std"].to_list() == pytest.approx([scaled.std(ddof=1)] * 7)
    # Two embryos that read apart: picked force by force, so the mean takes several values.
    made = pd.DataFrame({"force": [1.0, 2.0] * 2, "thesis": [1.0, 2.0, 3.0, 4.0]})
    found = section_5_6.table_5_7(np.random.default_rng(0), made, draws=400)
    values = section_5_6.MODULUS * np.array([(a / b + 1) / 2 for a in (1, 3) for b in (2, 4)])
    counts = [np.isclose(found["mean"], value).sum() for value in values]
    assert sum(counts) == 400
    assert min(counts) > 100 - 4 * np.sqrt(75)
