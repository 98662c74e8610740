"""Membranes: the posterior of the modulus against a second way to each draw; known curves."""

import numpy as np
import pandas as pd
import pytest

from compendium import thesis
from compendium.experiments import membranes, section_5_6
from compendium.experiments.membranes import PRIORS
from microlib.membrane import capsule_modulus, dimple_profile, disc_modulus

pytestmark = pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
DEPTH = section_5_6.printed_dimple()[1]


@pytest.fixture(scope="module")
def crest():
    return membranes.crest_reach(thesis.outline_curve())


@pytest.fixture(params=[("capsule", "hooke"), ("disc", "mooney-rivlin")])
def posterior(request, crest, monkeypatch):
    """Under one law each, that is not the one a membrane has by default."""
    membrane, law = request.param
    monkeypatch.setattr(membranes, "LAWS", (law,))
    return membranes.modulus_posterior(np.random.default_rng(1), membrane, crest, draws=4000)


def direct(row: pd.Series) -> float:
    """E of a draw by the inverse solvers, which the posterior does not use."""
    sizes = {"thickness": row.thickness, "probe_half_width": row.probe_half_width, "law": row.law}
    sizes["poisson_ratio"] = 0.5
    if "inflation" in row:
        sizes["capsule_radius"] = row.capsule_radius
        return capsule_modulus(thesis.FORCE, row.rim_radius, DEPTH, **sizes).modulus
    pressure = row.pressure * thesis.FORCE / (np.pi * row.rim_radius**2)
    before = {"pretension": row.pretension, "rim_inset": row.rim_inset, "pressure": pressure}
    return disc_modulus(thesis.FORCE, row.rim_radius, DEPTH, **sizes, **before)


def test_posterior_draws_reproduce_printed_dimple(posterior):
    """Interpolation errs by 1 % of the depth, which is up to 4 % of the modulus."""
    rows = [posterior.iloc[k] for k in range(12)]
    off = np.abs([np.log(row.E / direct(row)) for row in rows])
    assert np.median(off) < 0.03
    assert off.max() < 0.15  # near the ends of the range that was solved


def depth_of_a_toy(load: np.ndarray, slenderness: np.ndarray) -> np.ndarray:
    return 0.95 * load**0.35 * (1 - 2 * slenderness)


def test_posterior_weights_agree_with_rejection_sampling(monkeypatch, crest):
    """On a membrane with a known formula, beside draws of the priors that hit the depth."""

    def solved(membrane: str, law: str, reach: tuple[float, float]) -> tuple:
        unit = np.random.default_rng(0).random((150, 5))
        inputs = membranes._inputs(membrane, unit, reach)
        shape = depth_of_a_toy(inputs["load"], inputs["slenderness"])
        return unit, np.log(np.column_stack([shape, np.ones(150)]))

    monkeypatch.setattr(membranes, "_solved_states", solved)
    rng = np.random.default_rng(0)
    found = membranes.modulus_posterior(rng, "disc", crest, draws=40_000)
    size, ends = 4_000_000, (crest, PRIORS["probe_half_width"], PRIORS["thickness"])
    rim, half_width, thickness = (rng.uniform(*both, size) for both in ends)
    modulus = np.exp(rng.uniform(np.log(0.2), np.log(10.0), size))
    load = thesis.FORCE / (modulus * thickness * rim)
    hit = np.abs(rim * depth_of_a_toy(load, half_width / rim) - DEPTH) < 1.0
    # Tens of thousands of draws each: means to 0.5 %, quantiles to 1 %.
    for name, drawn in {"rim_radius": rim, "probe_half_width": half_width}.items():
        assert found[name].mean() == pytest.approx(drawn[hit].mean(), rel=0.005)
    levels = [0.1, 0.5, 0.9]
    np.testing.assert_allclose(
        found["E"].quantile(levels), np.quantile(modulus[hit], levels), rtol=0.015
    )


def test_fit_shoulder_recovers_drawn_profile():
    """Of an outline drawn with a = 150 µm, 90 µm deep, level outside, 7 µm too high."""
    half_width = thesis.MEMBRANE["probe_half_width"]
    r = np.linspace(half_width, 250.0, 400)
    depth = dimple_profile(np.minimum(r, 150.0), 150.0, 90.0, probe_half_width=half_width)
    noise = np.random.default_rng(0).normal(0, 0.5, r.size)
    found = membranes.fit_shoulder(r, 7.0 - depth + noise)
    # 400 points of 0.5 µm leave 0.1 µm of the depth, and a rim with no corner 0.5 µm of the radius.
    assert (np.abs(np.subtract(found, (150, 90, 0.5))) < (2, 0.4, 0.025)).all()


def test_modulus_ratios_agree_with_inverse_solver():
    """One is solved for the depth, the other for the modulus."""
    curve, depth = membranes.modulus_ratios("Hooke, no pressure"), 0.4
    sizes = (membranes.INPUTS["rim_radius"], depth * membranes.INPUTS["rim_radius"])
    before = membranes.DISCS["Hooke, no pressure"]
    whole = disc_modulus(thesis.FORCE, *sizes, **thesis.MEMBRANE, **before)
    # Straight lines between 12 points miss a curve that bends this little by less than 1 %.
    found = np.interp(depth, curve.index, curve)
    assert found == pytest.approx(whole / thesis.modulus(*sizes), rel=0.01)
