"""Chapter 2's experiments: what they draw from known truth, and what they must find in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compendium import thesis
from compendium.experiments import chapter_2
from microlib.calibration import calibrate
from microlib.microscope import Microscope
from microlib.servoing import loop_poles

NOISE = 0.02


@pytest.fixture(scope="module")
def scope() -> Microscope:
    printed = thesis.microscope("circle-1X")
    focal = printed.focal_length
    return replace(printed, tube_length=1.59 * focal, distance=focal / 1.59)


def test_the_grid_fills_the_view_and_no_more(scope) -> None:
    points = chapter_2.grid_in_view(scope)
    seen = scope.project(points)
    width, height = scope.image_size
    assert (seen > 5).all()
    assert (seen < (width - 6, height - 6)).all()
    np.testing.assert_allclose(points / 280, np.round(points / 280))
    assert len(np.unique(points, axis=0)) == len(points)
    # A cell of the grid covers 280² µm² of the view; points within half a pitch of its edge differ.
    view = np.prod(np.array(scope.image_size) - 11) * np.prod(scope.cell / scope.magnification)
    assert len(points) == pytest.approx(view / 280**2, rel=0.1)


@pytest.mark.parametrize("degrees", [0.0, 2.0, 20.0])
def test_a_pattern_is_tilted_by_what_was_asked(scope, degrees) -> None:
    # Two turns that are not small do not quite add as a vector.
    normal = chapter_2.tilted(scope, degrees).rotation[2, 2]
    assert np.rad2deg(np.arccos(normal)) == pytest.approx(degrees, rel=0.005, abs=1e-6)


def test_the_steps_of_a_calibration_are_in_the_units_they_say(scope) -> None:
    world = chapter_2.grid_in_view(scope)
    fit = calibrate(
        world,
        scope.project(world),
        focal_length=scope.focal_length,
        pixel_size=scope.pixel_size,
        image_size=scope.image_size,
    )
    start = [getattr(scope, name) for name in chapter_2.PARAMETERS]
    steps = chapter_2.calibration_steps(scope, start, fit)
    np.testing.assert_allclose(steps["start"], steps["truth"])
    np.testing.assert_allclose(steps["refined"], steps["truth"], rtol=1e-5)
    assert steps.loc["α (°)", "truth"] == pytest.approx(90.7144)
    assert steps.loc["γ (°)", "truth"] == pytest.approx(175.9179)
    assert steps.loc["κ (10⁻¹⁰ µm⁻²)", "truth"] == pytest.approx(-8.4)
    assert steps.loc["M", "σ"] == fit.sigma["magnification"]


def test_an_angle_beyond_the_turn_is_shown_within_it(scope) -> None:
    turned = replace(scope, gamma=scope.gamma - 2 * np.pi)
    world = chapter_2.grid_in_view(turned)
    fit = calibrate(
        world,
        turned.project(world),
        focal_length=turned.focal_length,
        pixel_size=turned.pixel_size,
        image_size=turned.image_size,
    )
    start = [getattr(turned, name) for name in chapter_2.PARAMETERS]
    row = chapter_2.calibration_steps(turned, start, fit).loc["γ (°)"]
    np.testing.assert_allclose(row[["truth", "start", "refined"]], 175.9179, atol=1e-3)


def test_the_valley_opens_with_the_tilt(scope, monkeypatch) -> None:
    monkeypatch.setattr(chapter_2, "VALLEY_TILTS", (0.0, 20.0))
    monkeypatch.setattr(chapter_2, "RATIOS", (0.5, 1.0, 2.0))
    residuals = chapter_2.residuals_by_focal_length(scope, NOISE, np.random.default_rng(0))
    assert list(residuals.columns) == [0.0, 20.0]
    np.testing.assert_allclose(residuals[0.0], residuals.loc[1.0, 0.0], rtol=0.01)
    # Some 100 points: their root mean square scatters by 1/√400.
    np.testing.assert_allclose(residuals.loc[1.0], NOISE, rtol=0.2)
    assert (residuals.loc[[0.5, 2.0], 20.0] > 5 * NOISE).all()


def test_the_study_loses_f_on_a_parallel_plane_and_keeps_m(scope, monkeypatch) -> None:
    monkeypatch.setattr(chapter_2, "STUDY_TILTS", (0.0, 10.0))
    monkeypatch.setattr(chapter_2, "PARALLEL_RUNS", 2)
    study = chapter_2.focal_length_study(scope, NOISE, 12, np.random.default_rng(1))
    parallel, steep = (row for _, row in study.iterrows())
    assert parallel["lost"] == 1
    assert np.isinf(parallel["bound"])
    assert np.isnan(parallel["scatter"])
    assert steep["lost"] == 0
    assert steep["stated"] == pytest.approx(steep["bound"], rel=0.25)
    # The standard deviation of twelve numbers is right to a fifth.
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


def test_the_thesis_gain_bears_little_more_than_a_frame() -> None:
    gain = 0.99883  # 2.2/thesis-gain
    assert 0.999 < abs(loop_poles(gain, 1.0)[0]) < 1
    assert abs(loop_poles(gain, 1.05)[0]) > 1
