"""Membranes: the posterior of the modulus against a second way to each draw; known curves."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_bvp

from compendium import thesis
from compendium.experiments import membranes, section_5_6
from compendium.experiments.chapter_4 import probe_sines
from compendium.experiments.membranes import PRIORS
from microlib.embryo import dimple_geometry
from microlib.membrane import (
    capsule_modulus,
    dimple_profile,
    disc_modulus,
    indentation_force,
    membrane_stress,
)

pytestmark = pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
DEPTH = section_5_6.printed_dimple()[1]


@pytest.fixture(scope="module")
def crest():
    return membranes.crest_reach(thesis.outline_curve())


def direct(row: pd.Series) -> float:
    """E of a draw by the inverse solver, which the posterior does not use."""
    lengths = ["thickness", "probe_half_width", "capsule_radius"]
    sizes = {name: row[name] for name in lengths} | {"poisson_ratio": 0.5, "law": row.law}
    return capsule_modulus(thesis.FORCE, row.rim_radius, DEPTH, **sizes).modulus


def test_posterior_draws_reproduce_printed_dimple(crest, monkeypatch):
    """Under a law that is not the one a capsule has by default.

    Interpolation errs by 1 % of the depth, which is up to 4 % of the modulus.
    """
    monkeypatch.setattr(membranes, "LAWS", ("hooke",))
    posterior = membranes.modulus_posterior(np.random.default_rng(1), crest, draws=4000)
    rows = [posterior.iloc[k] for k in range(12)]
    off = np.abs([np.log(row.E / direct(row)) for row in rows])
    assert np.median(off) < 0.03
    assert off.max() < 0.15  # near the ends of the range that was solved


#: Radius of the rim over that of the capsule, of a membrane with a known formula.
TOY_RIM = 0.42


def depth_of_a_toy(load: np.ndarray, slenderness: np.ndarray, inflation: np.ndarray) -> np.ndarray:
    return 0.5 * load**0.35 * (1 - 2 * slenderness) * inflation**-2


def test_posterior_weights_agree_with_rejection_sampling(monkeypatch, crest):
    """On a membrane with a known formula, beside draws of the priors that hit the depth."""

    def solved(law: str) -> tuple:
        unit = np.random.default_rng(0).random((150, 3))
        depth = depth_of_a_toy(**membranes._inputs(unit))
        return unit, np.log(np.column_stack([depth, np.full(150, TOY_RIM)]))

    monkeypatch.setattr(membranes, "_solved_states", solved)
    rng = np.random.default_rng(0)
    found = membranes.modulus_posterior(rng, crest, draws=40_000)
    names = ["capsule_radius", "probe_half_width", "thickness", "inflation"]
    radius, half_width, thickness, inflation = (rng.uniform(*PRIORS[n], 4_000_000) for n in names)
    base, rise = membranes._USUAL_LOAD
    reach = np.exp(membranes._LOAD_REACH * rng.uniform(-1, 1, len(radius)))
    load = (base + rise * (inflation - 1)) * reach
    modulus = thesis.FORCE / (load * thickness * radius)
    depth = radius * depth_of_a_toy(load, half_width / radius, inflation)
    hit = (np.abs(depth - DEPTH) < 1.0) & (
        np.abs(TOY_RIM * radius - np.mean(crest)) < np.ptp(crest) / 2
    )
    # Tens of thousands of draws each: means to 0.5 %, quantiles to 1 %.
    drawn = {"capsule_radius": radius, "probe_half_width": half_width, "inflation": inflation}
    for name, values in drawn.items():
        assert found[name].mean() == pytest.approx(values[hit].mean(), rel=0.005)
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
    assert (np.abs(np.subtract(found[:3], (150, 90, 0.5))) < (2, 0.4, 0.025)).all()
    assert found[3] < 4 * 0.5  # the largest of 400 normal errors


@pytest.mark.parametrize("pressure", ["balance", 0.0])
def test_shallow_disc_agrees_with_foppls_equations(pressure):
    """Föppl's membrane, E = h = a = F = 1, of u, r N_r and w; a second way to both ratios."""
    zeta = thesis.MEMBRANE["probe_half_width"] / membranes.INPUTS["rim_radius"]
    nu, share = thesis.MEMBRANE["poisson_ratio"], 1.0 if pressure == "balance" else 0.0

    def strains(r, u, along):
        hoop = u / r
        return hoop, along / r * (1 - nu**2) - nu * hoop

    def rates(r, y):
        slope = -(1 - share * r**2) / (2 * np.pi * y[1])
        hoop, radial = strains(r, y[0], y[1])
        return np.array([radial - slope**2 / 2, (hoop + nu * radial) / (1 - nu**2), slope])

    r = zeta ** np.linspace(1, 0, 400)
    start = np.array([1e-3 * np.ones_like(r), 0.3 * np.cbrt(r), 1 - r ** (2 / 3)])
    clamped = lambda left, right: np.array([left[0], right[0], right[2]])  # noqa: E731
    found = solve_bvp(rates, clamped, r, start, tol=1e-8, max_nodes=20_000)
    along = found.sol(np.array([zeta, 1.0]))[1] / (zeta, 1.0)
    sizes = {"thickness": 1e-3, "probe_half_width": zeta, "poisson_ratio": nu}
    by_formula = indentation_force(1e3, 1.0, found.y[2, 0], **sizes)
    expected = along[0] / along[1], float(by_formula)
    assert membranes.shallow_disc(pressure) == pytest.approx(expected, rel=1e-3)


def test_readings_follow_from_the_exponents_and_the_curve():
    found, printed = membranes.readings(), section_5_6.read_off()
    assert found.loc["left-rim", "E"] == pytest.approx(printed[-1], rel=1e-6)
    # One length changes at a time: E ~ w_d⁻³, and the thinner probe is the stiffer reading.
    deep, edge = found.loc["left-rim"], found.loc["edge-depth"]
    assert edge["E"] == pytest.approx(deep["E"] * (deep["w_d"] / edge["w_d"]) ** 3)
    by_width = found[found["a"].eq(deep["a"]) & found["w_d"].eq(deep["w_d"])].sort_values("c")
    assert by_width["E"].is_monotonic_decreasing
    assert found.loc["half-distance", "a"] == pytest.approx(
        (deep["a"] + found.loc["right-rim", "a"]) / 2
    )


def test_modulus_ratio_agrees_with_inverse_solver():
    """One is solved for the load of a depth, the other for the modulus."""
    depth, before = 0.4, membranes.DISCS["Hooke, no pressure"]
    sizes = (membranes.INPUTS["rim_radius"], depth * membranes.INPUTS["rim_radius"])
    whole = disc_modulus(thesis.FORCE, *sizes, **thesis.MEMBRANE, **before)
    found = membranes.modulus_ratios("Hooke, no pressure", [depth])
    assert found.index.to_list() == [depth]
    assert found[depth] == pytest.approx(whole / thesis.modulus(*sizes), rel=1e-4)


def test_force_balance_needs_a_sine_above_one_in_each_reading_of_printed_modulus():
    """The row of the sine at the probe states these numbers; the sine is proportional to w_d/a."""
    found, inputs = membranes.readings(), membranes.INPUTS
    printed = probe_sines(25.0) * inputs["rim_radius"] / inputs["dimple_depth"]
    sines = (printed * found["w_d"] / found["a"])[found["c"] == 25.0]
    assert sines["left-rim"] == pytest.approx(2.67, abs=0.005)
    assert sines.idxmin() == "edge-depth"
    assert printed * found.loc["edge-depth", "w_d"] / inputs["rim_radius"] == pytest.approx(
        2.02, abs=0.005
    )
    # The depth of the curve at each c, below the rim of each side.
    curve, pixel = thesis.outline_curve(), thesis.EMBRYO_PIXEL
    dimple = dimple_geometry(curve, pixel_size=pixel)
    rims = [(-1, dimple.rim_radius, dimple.dimple_depth), (1, *section_5_6.right_dimple())]
    c = np.arange(10.0, 60.0, 0.05)
    for (side, radius, deep), least in zip(rims, (43.5, 46.2), strict=True):
        x, bottom = dimple.bottom
        depth = deep - pixel * (curve(x + side * c / pixel) - bottom)
        sizes = {"thickness": inputs["thickness"], "probe_half_width": c}
        stress = membrane_stress(thesis.FORCE, radius, depth, **sizes)
        carried = thesis.FORCE * (1 - (c / radius) ** 2)
        sine = carried / (2 * np.pi * c * inputs["thickness"] * stress)
        assert c[sine < 1].min() == pytest.approx(least, abs=0.1)
