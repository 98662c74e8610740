"""Chapter 2's experiments: what they draw from known truth, and what they must find in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compendium import thesis
from compendium.experiments import chapter_2, identifiability
from microlib.microscope import Microscope
from microlib.servoing import loop_poles

NOISE = 0.02


@pytest.fixture(scope="module")
def scope() -> Microscope:
    printed = thesis.microscope("circle-1X")
    focal = printed.focal_length
    return replace(printed, tube_length=1.59 * focal, distance=focal / 1.59)


def test_points_without_noise_lead_back_to_the_truth(scope) -> None:
    steps = chapter_2.calibration_steps(scope, 0.0, np.random.default_rng(0))
    np.testing.assert_allclose(steps["refined"], steps["truth"], rtol=1e-5)
    printed = {"α (°)": 90.7144, "γ (°)": 175.9179, "κ (10⁻¹⁰ µm⁻²)": -8.4, "T_x (µm)": -781.4}
    assert steps["truth"][list(printed)].to_dict() == pytest.approx(printed)
    assert steps.loc["M", "start"] == pytest.approx(steps.loc["M", "truth"], rel=0.01)


def test_the_stated_deviation_is_that_of_many_draws(scope) -> None:
    draws = [chapter_2.calibration_steps(scope, NOISE, np.random.default_rng(k)) for k in range(12)]
    found = np.array([steps.loc["M", "refined"] for steps in draws])
    # The standard deviation of twelve numbers is right to a fifth.
    assert draws[0].loc["M", "σ"] == pytest.approx(found.std(), rel=0.7)


def test_forces_grow_with_their_powers_of_the_size() -> None:
    table = chapter_2.forces_on_sphere([0.1, 1.0])
    powers = np.log10(table.iloc[1] / table.iloc[0])
    np.testing.assert_allclose(powers, [3, 1, 1, 1, 2], atol=1e-9)
    # A millimeter of silicon weighs 2330 kg/m³ · 0.5236 mm³ · 9.81 m/s².
    assert table.loc[1.0, "weight"] == pytest.approx(2330 * 0.5236e-9 * 9.81, rel=1e-4)
    water = chapter_2.forces_on_sphere([chapter_2.balance("surface tension")]).iloc[0]
    assert water["surface tension"] == pytest.approx(water["weight"])


def test_one_direction_of_the_lengths_is_invisible(scope) -> None:
    table, weakest = identifiability.directions(scope)
    values = table["singular value"]
    assert values.iloc[-1] < 1e-12 * values.iloc[0] < values.iloc[-2]
    lengths = [weakest[name] for name in ("tube_length", "focal_length", "distance")]
    np.testing.assert_allclose(lengths, [-1, 1, -1], atol=1e-6)


def test_the_study_loses_f_on_a_parallel_plane_and_keeps_m(scope, monkeypatch) -> None:
    monkeypatch.setattr(identifiability, "TILTS", (0.0, 10.0))
    monkeypatch.setattr(identifiability, "PARALLEL_RUNS", 2)
    study = identifiability.focal_length_study(scope, NOISE, 12, np.random.default_rng(1))
    parallel, steep = (row for _, row in study.iterrows())
    assert parallel["lost"] == 1
    assert np.isinf(parallel["bound"])
    assert np.isnan(parallel["scatter"])
    assert steep["lost"] == 0
    assert steep["stated"] == pytest.approx(steep["bound"], rel=0.25)
    assert steep["scatter"] == pytest.approx(steep["bound"], rel=0.7)
    assert (study["M"] < 1e-4).all()


def test_the_full_model_without_tilt_and_distortion_differs_by_perspective_alone(scope) -> None:
    plain = replace(scope, distortion=0.0, alpha=0.0, beta=0.0, gamma=np.pi)
    x, y, depth = 700.0, 400.0, plain.translation[2]
    found = chapter_2.jacobian_comparison(plain, (x, y, depth)).set_index("motion")
    scale = plain.magnification / plain.cell[0]
    full = found[["x, full model", "y, full model"]]
    np.testing.assert_allclose(full.loc["V_x"], [scale, 0], atol=1e-6)
    np.testing.assert_allclose(full.loc["V_z"], [-scale * x / depth, -scale * y / depth], rtol=1e-3)
    np.testing.assert_allclose(full.loc["ω_z"], [-scale * y, scale * x], rtol=1e-5)
    assert found.loc["V_x", "difference"] < 1e-6
    far = scale * np.hypot(x, y) / depth
    assert found.loc["V_z", "difference"] == pytest.approx(far, rel=1e-3)


def test_simulated_loops_decay_where_their_poles_say() -> None:
    loops = chapter_2.simulated_loops(0.03, seed=3)
    assert len(loops) == len(chapter_2.DELAYS) * len(chapter_2.GAINS)
    one = loops[loops["delay"] == 1.0]
    # One frame of delay: z² − z + g = 0, stable for g < 1.
    assert (one["decays"] == (one["gain"] < 1)).all()
    poles = [abs(loop_poles(g, d)[0]) for d, g in loops[["delay", "gain"]].to_numpy()]
    assert (loops["decays"] == (np.array(poles) < 1)).all()
    assert loops["decays"].nunique() == 2


@pytest.mark.parametrize(
    ("delay", "limit"), [(0.0, 2.0), (0.25, 4.0), (0.5, 2.0), (1.0, 1.0), (2.0, 0.618)]
)
def test_the_limits_that_chapter_2_states(delay, limit) -> None:
    assert abs(loop_poles(0.998 * limit, delay)[0]) < 1
    assert abs(loop_poles(1.002 * limit, delay)[0]) > 1
