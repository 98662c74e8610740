"""The posterior of the modulus against a second way to each draw; fits of known curves."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from compendium import thesis
from compendium.experiments import section_5_6, section_5_6_mechanics
from compendium.experiments.section_5_6_mechanics import PRIORS
from microlib.embryo import dimple_geometry
from microlib.membrane import capsule_modulus, dimple_profile, disc_modulus

DEPTH = section_5_6.printed_dimple()[1]


@pytest.fixture(scope="module")
def crest() -> tuple[float, float]:
    return section_5_6_mechanics.crest_reach(thesis.outline_curve())


@pytest.fixture(scope="module", params=["capsule", "disc"])
def posterior(request: pytest.FixtureRequest, crest: tuple[float, float]) -> pd.DataFrame:
    """Of fewer solved states than the notebook's, which tell the same to the tests' tolerance."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(section_5_6_mechanics, "_CAPSULES", 24)
        return section_5_6_mechanics.modulus_posterior(
            np.random.default_rng(1), request.param, crest, draws=4000
        )


def direct(row: pd.Series) -> float:
    """E of a draw by the inverse solvers, which the posterior does not use."""
    sizes = {"thickness": row.thickness, "probe_half_width": row.probe_half_width, "law": row.law}
    if "inflation" in row:
        radius, rim = row.radius, row.rim_radius
        return capsule_modulus(thesis.FORCE, rim, DEPTH, radius=radius, **sizes).modulus
    pressure = row.pressure * thesis.FORCE / (np.pi * row.rim_radius**2)
    before = {"pretension": row.pretension, "rim_inset": row.rim_inset, "pressure": pressure}
    return disc_modulus(thesis.FORCE, row.rim_radius, DEPTH, **sizes, **before)


def test_each_draw_has_the_printed_dimple(posterior: pd.DataFrame) -> None:
    """Interpolation errs by 1 % of the depth, which is up to 4 % of the modulus."""
    rows = [posterior.iloc[k] for k in range(12)]
    off = np.array([np.log(row.E / direct(row)) for row in rows])
    assert np.median(np.abs(off)) < 0.03
    assert np.abs(off).max() < 0.15  # near the ends of the range that was solved


def test_draws_lie_within_their_priors(posterior: pd.DataFrame, crest: tuple[float, float]) -> None:
    limits = PRIORS | {"rim_radius": crest}
    for name in limits.keys() & set(posterior.columns):
        assert posterior[name].between(*limits[name]).all(), name
    # The thickness is not tied to the dimple: its prior comes back, ±4 standard errors.
    low, high = PRIORS["thickness"]
    error = (high - low) / np.sqrt(12 * len(posterior))
    assert posterior["thickness"].mean() == pytest.approx((low + high) / 2, abs=4 * error)
    assert set(posterior["law"]) == set(section_5_6_mechanics.LAWS)
    # The range of loads that was solved does not cut the draws off.
    if "radius" in posterior:
        load = thesis.FORCE / (posterior["E"] * posterior["thickness"] * posterior["radius"])
        swing = np.log(load / (0.05 + 1.1 * (posterior["inflation"] - 1)))
        assert np.abs(swing).max() < 0.7
    else:
        load = thesis.FORCE / (posterior["E"] * posterior["thickness"] * posterior["rim_radius"])
        assert load.between(0.065, 0.9).mean() > 0.995


def depth_of_a_toy(load: np.ndarray, slenderness: np.ndarray) -> np.ndarray:
    return 0.95 * load**0.35 * (1 - 2 * slenderness)


def test_weights_are_those_of_rejection(
    monkeypatch: pytest.MonkeyPatch, crest: tuple[float, float]
) -> None:
    """On a membrane with a known formula, beside draws of the priors that hit the depth."""

    def solved(membrane: str, reach: tuple[float, float]) -> dict:
        unit = np.random.default_rng(0).random((150, 5))
        inputs = section_5_6_mechanics._inputs(membrane, unit, reach)
        shape = depth_of_a_toy(inputs["load"], inputs["slenderness"])
        return {"toy": (unit, np.log(np.column_stack([shape, np.ones(150)])))}

    monkeypatch.setattr(section_5_6_mechanics, "_solved_states", solved)
    rng = np.random.default_rng(0)
    found = section_5_6_mechanics.modulus_posterior(rng, "disc", crest, draws=40_000)
    size = 4_000_000
    rim, half_width, thickness = (
        rng.uniform(*ends, size)
        for ends in (crest, PRIORS["probe_half_width"], PRIORS["thickness"])
    )
    modulus = np.exp(rng.uniform(np.log(0.2), np.log(10.0), size))
    load = thesis.FORCE / (modulus * thickness * rim)
    hit = np.abs(rim * depth_of_a_toy(load, half_width / rim) - DEPTH) < 1.0
    # Tens of thousands of draws each: means to 0.5 %, quantiles to 1 %.
    assert found["rim_radius"].mean() == pytest.approx(rim[hit].mean(), rel=0.005)
    assert found["probe_half_width"].mean() == pytest.approx(half_width[hit].mean(), rel=0.005)
    for level in (0.1, 0.5, 0.9):
        wanted = np.quantile(modulus[hit], level)
        assert found["E"].quantile(level) == pytest.approx(wanted, rel=0.015)


def test_the_same_seed_gives_the_same_draws(
    monkeypatch: pytest.MonkeyPatch, crest: tuple[float, float]
) -> None:
    # A polynomial of the second degree in five inputs has 21 coefficients.
    monkeypatch.setattr(section_5_6_mechanics, "_DISCS", 24)
    first, again = (
        section_5_6_mechanics.modulus_posterior(np.random.default_rng(3), "disc", crest, draws=50)
        for _ in range(2)
    )
    pd.testing.assert_frame_equal(first, again)


def test_crest_is_level_to_a_pixel(crest: tuple[float, float]) -> None:
    curve = thesis.outline_curve()
    dimple = dimple_geometry(curve, pixel_size=thesis.EMBRYO_PIXEL)
    axis, top = dimple.bottom[0], dimple.rim[1]
    for radius in crest:
        assert curve(axis - radius / thesis.EMBRYO_PIXEL) == pytest.approx(top - 1, abs=0.05)
    assert crest[0] < dimple.dimple_radius < crest[1]


def test_a_profile_with_a_shoulder_is_found() -> None:
    """Of an outline drawn with a = 150 µm, 90 µm deep, level outside, 7 µm too high."""
    half_width = thesis.MEMBRANE["probe_half_width"]
    r = np.linspace(half_width, 250.0, 400)
    depth = dimple_profile(np.minimum(r, 150.0), 150.0, 90.0, probe_half_width=half_width)
    noise = np.random.default_rng(0).normal(0, 0.5, r.size)
    found = section_5_6_mechanics._nearest_profile(r, 7.0 - depth + noise)
    # 400 points of 0.5 µm leave 0.1 µm of the depth, and a rim with no corner 0.5 µm of the radius.
    assert found == pytest.approx((150, 90, 0.5), rel=0.05)
    assert found[0] == pytest.approx(150, abs=2)
    assert found[1] == pytest.approx(90, abs=0.4)


def test_misfit_of_the_formula_is_that_of_the_claim() -> None:
    curve = thesis.outline_curve()
    shapes = section_5_6_mechanics.shape_misfits(curve).set_index("shape")
    share = section_5_6.compare_shape(curve).share
    assert shapes.loc["profile (4.2)", "largest"] == pytest.approx(share, abs=1e-3)
    # Radius, depth and force of Table 5.6 by each membrane's own inverse, other tests hold them.
    assert shapes.loc["capsule, neo-Hooke", "E"] == pytest.approx(1.12, abs=0.02)
    assert shapes.loc["disc, Hooke", "E"] == pytest.approx(0.73, abs=0.01)
    assert (shapes["stretched"] < shapes["rms"]).all()


def test_one_reading_at_a_time(crest: tuple[float, float]) -> None:
    readings = section_5_6_mechanics.single_readings(crest).set_index("input")
    middle = readings.loc["middle", "one"]
    # E is proportional to 1/h.
    np.testing.assert_allclose(
        readings.loc["thickness"].astype(float), middle / np.array([0.8, 1.2]), rtol=1e-9
    )
    assert readings.loc["radius of the egg", "one"] > 1.5 * middle
    assert np.isnan(readings.loc["crest of the rim", "other"])
