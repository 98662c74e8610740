"""Section 5.4: what is identified gives the print back; what is predicted follows theory."""

from __future__ import annotations

import numpy as np
import pytest

from compendium import thesis
from compendium.experiments import section_5_4
from compendium.ledger import claim

SEED = 5


@pytest.fixture(scope="module")
def times() -> section_5_4.SettlingTimes:
    return section_5_4.identify_settling(SEED)


@pytest.fixture(scope="module")
def station() -> section_5_4.Workstation:
    """A workstation near the identified one, at round values."""
    return section_5_4.Workstation(
        saturation={"1X": 390.0, "4X": 172.0},
        jitter=0.12,
        path_speed={"circle": 40.0, "square": 32.0, "sinusoid": 27.0},
        seed=SEED,
    )


def test_what_a_sample_leaves_is_the_formula() -> None:
    """l / (T² j² q + l), for the x axis."""
    t, q, ell = thesis.FRAME_INTERVAL, claim("section-5.4/Q").value, claim("section-5.4/L-x").value
    table = section_5_4.gains()
    expected = ell / (t**2 * table["J"] ** 2 * q + ell)
    np.testing.assert_allclose(table["error left after a sample"], expected)
    np.testing.assert_allclose(table["time constant (s)"], -t / np.log(expected))
    assert table["J"].iloc[0] == pytest.approx(1000 * 1.5893 / 9.9)


def test_the_identified_speeds_give_the_printed_times(times) -> None:
    for zoom in thesis.ZOOMS:
        time = section_5_4.step(zoom, times.saturation[zoom], 0.0, SEED, 0, exact=True)
        # Times come a frame apart.
        assert abs(time["settling-time"] - times.printed[zoom]) < thesis.FRAME_INTERVAL
        # A saturated stage needs the step's 95 % over its speed, and at most three samples more.
        way = 0.95 * 50 * thesis.effective_pixel(zoom)
        least = way / times.saturation[zoom]
        assert least - thesis.FRAME_INTERVAL < time["settling-time"]
        assert time["settling-time"] < least + 4 * thesis.FRAME_INTERVAL
    ringing = section_5_4.step(
        "4X", times.saturation["1X"], 0.0, SEED, 0, exact=True, latency=times.latency
    )
    assert abs(ringing["settling-time"] - times.printed["4X"]) < thesis.FRAME_INTERVAL


def test_long_latency_leaves_more_than_is_printed(times) -> None:
    table = section_5_4.explanations(SEED, times, draws=10).set_index("explanation")
    ringing, slow = table.loc["one speed, long latency"], table.loc["a lower speed at 4X"]
    assert ringing["from"] > ringing["printed"]
    assert slow["from"] < slow["printed"] < slow["to"]


def test_an_exact_run_without_jitter_is_dead_beat(station) -> None:
    path = np.array([[0.0, 0.0]] + [[3.0, -2.0]] * 9)
    found = section_5_4.run("1X", path, 0, saturation=1e4, jitter=0.0, exact=True, latency=0.0)
    left = section_5_4.gains().set_index(["unit", "zoom"]).loc[("px/mm", "1X")].iloc[1]
    # The second reference is known one sample ahead, so the first command takes the step; half a
    # step of the stage is 0.004 px.
    assert found.feature[1] - path[1] == pytest.approx(
        -left * np.array([3.0, -2.0]), abs=0.05 * np.hypot(3, 2)
    )
    assert np.abs(found.feature[3:] - path[3:]).max() < 0.01


def test_the_calibration_is_drawn_wrong_by_a_per_cent(station) -> None:
    """Without noise, the first sample of a step tells the drawn Jacobian."""
    moved = []
    for draw in range(60):
        path = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
        found = station.run("1X", path, draw, jitter=0.0, saturation=1e5, latency=0.0)
        moved.append(found.feature[1])
    size, angle = np.linalg.norm(moved, axis=1), np.arctan2(*np.transpose(moved)[::-1])
    # Sixty draws know a standard deviation to 9 %; the stage's steps add 0.4 % of a pixel.
    assert np.std(size) == pytest.approx(0.01, rel=0.4)
    assert np.std(angle) == pytest.approx(np.pi / 180, rel=0.4)


def test_the_identified_workstation_gives_the_printed_numbers() -> None:
    found = section_5_4.identify_workstation(SEED, {"1X": 390.0, "4X": 172.0})
    for name in section_5_4.PATHS:
        errors = section_5_4._mean_error(name, found.path_speed[name], found.jitter, SEED, 390.0)
        printed = section_5_4.printed_path("1X", name, "accuracy")
        assert errors[0] == pytest.approx(printed, rel=0.02), name
        if name == "circle":
            printed = section_5_4.printed_path("1X", name, "precision")
            assert errors[1] == pytest.approx(printed, rel=0.05)
    table = found.table().set_index("identified")["value"]
    assert table["jitter"] == found.jitter
    assert table["speed on the square"] == found.path_speed["square"]
    assert len(table) == 6


def test_the_error_on_a_circle_is_one_sample_of_motion(station) -> None:
    """The controller works on f(k) − f*(k+1), so a perfect one leaves speed times interval."""
    table = section_5_4.path_table(station, draws=6).set_index("claim")
    assert len(table) == 12
    for zoom in thesis.ZOOMS:
        one_sample = 40.0 * thesis.FRAME_INTERVAL * thesis.effective_pixel(zoom)
        row = table.loc[f"table-5.4/{zoom}/circle/accuracy"]
        assert row["median"] == pytest.approx(one_sample, rel=0.1)
        assert row["low"] <= row["median"] <= row["high"]
    result = station.run("1X", station.path("circle"), 2)
    each = section_5_4.lag("1X", result)
    assert len(each) == len(result.time) - 1
    error = section_5_4.path_error("1X", result)
    assert error["accuracy"] == pytest.approx(each.mean())
    assert error["precision"] == pytest.approx(each.std())


def test_the_step_table_settles_as_identified(station) -> None:
    table = section_5_4.step_table(station, draws=12).set_index("claim")["median"]
    assert table["table-5.3/1X/settling-time"] == pytest.approx(0.80, abs=0.05)
    assert table["table-5.3/4X/settling-time"] == pytest.approx(0.45, abs=0.05)
    # Accuracy is below the band of 5 % of the step, which has both axes.
    for zoom in thesis.ZOOMS:
        band = 0.05 * 50 * np.sqrt(2) * thesis.effective_pixel(zoom)
        assert 0 < table[f"table-5.3/{zoom}/accuracy"] < band


def test_images_give_the_run_over_coordinates(station) -> None:
    for zoom, (rendered, fast) in section_5_4.step_runs_over_images(station).items():
        assert len(rendered.time) == len(section_5_4.STEP_PATH), zoom
        np.testing.assert_array_equal(rendered.reference, fast.reference)
        # Tracking errs by hundredths of a pixel, which a dead-beat loop turns into motion.
        assert np.abs(rendered.feature - fast.feature).max() < 0.3
    runs = section_5_4.path_runs_over_images(station)
    for name, rendered in runs.items():
        fast = station.run("1X", station.path(name))
        assert np.abs(rendered.feature - fast.feature).max() < 0.3


def test_prediction_pays_most_at_a_long_latency(station) -> None:
    table = section_5_4.compare_controllers(station, draws=2)
    assert len(table) == 12
    better = table["optimal (2.28), µm"] / table["predictive, µm"]
    assert (better > 1).all()
    short = table["latency (ms)"] == 1000 * section_5_4.LATENCY
    assert (better[~short].to_numpy() > better[short].to_numpy()).all()


def test_the_printed_ratios_tell_the_zooms_apart() -> None:
    """A lag with normal noise has a mean of at least 1.91 of its standard deviations (Rice)."""
    rng = np.random.default_rng(0)
    least = min(
        np.hypot(*(rng.normal(0, 1, (2, 200_000)) + np.array([[lag], [0]]))).mean()
        / np.hypot(*(rng.normal(0, 1, (2, 200_000)) + np.array([[lag], [0]]))).std()
        for lag in (0.0, 0.3, 1.0, 3.0)
    )
    ratios = section_5_4.printed_ratios()
    assert (ratios["4X"] < least).all()
    assert (ratios["1X"] > least).all()


def test_a_taller_sinusoid_runs_less_evenly(station) -> None:
    flat = section_5_4.path_error("1X", station.run("1X", station.path("sinusoid")))
    assert section_5_4.tall_sinusoid_precision(station) > flat["precision"]
