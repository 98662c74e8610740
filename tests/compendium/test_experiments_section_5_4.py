"""Section 5.4: what is identified gives the print back; what is predicted follows theory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from compendium import thesis
from compendium.experiments import section_5_4
from compendium.ledger import claim

SEED = 5
EXACT = section_5_4.Assumed(calibration=0.0)


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
        time = section_5_4.step(zoom, times.saturation[zoom], 0.0, SEED, 0, EXACT)
        # Times come a frame apart.
        assert abs(time["settling-time"] - times.printed[zoom]) < thesis.FRAME_INTERVAL
        # A saturated stage needs the step's 95 % over its speed, and at most three samples more.
        way = 0.95 * 50 * thesis.effective_pixel(zoom)
        least = way / times.saturation[zoom]
        assert least - thesis.FRAME_INTERVAL < time["settling-time"]
        assert time["settling-time"] < least + 4 * thesis.FRAME_INTERVAL
    late = replace(EXACT, latency=times.latency)
    ringing = section_5_4.step("4X", times.saturation["1X"], 0.0, SEED, 0, late)
    assert abs(ringing["settling-time"] - times.printed["4X"]) < thesis.FRAME_INTERVAL


def test_long_latency_leaves_more_than_is_printed(times) -> None:
    table = section_5_4.explanations(SEED, times, draws=10).set_index("explanation")
    ringing, slow = table.loc["one speed, long latency"], table.loc["a lower speed at 4X"]
    assert ringing["from"] > ringing["printed"]
    assert slow["from"] < slow["printed"] < slow["to"]


def test_a_band_of_three_per_cent_decides_for_the_other_explanation() -> None:
    """The thesis prints no band; with its 3 % the long latency is the one that agrees."""
    narrow = replace(section_5_4.ASSUMED, band=0.03)
    times = section_5_4.identify_settling(SEED, narrow)
    table = section_5_4.explanations(SEED, times, 60, narrow).set_index("explanation")
    ringing, slow = table.loc["one speed, long latency"], table.loc["a lower speed at 4X"]
    assert ringing["from"] < ringing["printed"] < ringing["to"]
    assert slow["to"] < slow["printed"]
    # A narrower band is reached later by the same stage, so that the stage must be faster.
    wide = section_5_4.identify_settling(SEED).saturation
    assert all(times.saturation[zoom] > wide[zoom] for zoom in thesis.ZOOMS)


def test_each_band_has_its_own_explanations(monkeypatch) -> None:
    """The band is in the reading that both the identification and the steps are given."""

    def times(seed: int, reading: section_5_4.Assumed) -> tuple:
        return seed, reading.band

    def table(seed: int, found: tuple, draws: int, reading: section_5_4.Assumed) -> pd.DataFrame:
        assert found == (seed, reading.band)
        return pd.DataFrame({"printed": [draws, 100 * reading.band]})

    monkeypatch.setattr(section_5_4, "identify_settling", times)
    monkeypatch.setattr(section_5_4, "explanations", table)
    found = section_5_4.explanations_by_band(7, 9, (0.05, 0.03))
    assert found["band"].tolist() == [0.05, 0.05, 0.03, 0.03]
    assert found["printed"].tolist() == [9, 5, 9, 3]


def test_an_exact_run_without_jitter_is_dead_beat(station) -> None:
    path = np.array([[0.0, 0.0]] + [[3.0, -2.0]] * 9)
    prompt = replace(EXACT, latency=0.0)
    found = section_5_4.run("1X", path, 0, saturation=1e4, jitter=0.0, assumed=prompt)
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
        prompt = replace(station.assumed, latency=0.0)
        found = station.run("1X", path, draw, jitter=0.0, saturation=1e5, assumed=prompt)
        moved.append(found.feature[1])
    size, angle = np.linalg.norm(moved, axis=1), np.arctan2(*np.transpose(moved)[::-1])
    # Sixty draws know a standard deviation to 9 %; the stage's steps add 0.4 % of a pixel.
    assert np.std(size) == pytest.approx(0.01, rel=0.4)
    assert np.std(angle) == pytest.approx(np.pi / 180, rel=0.4)


def test_many_runs_at_once_measure_what_the_runs_do(station) -> None:
    """Two loops over the same draws: they differ by rounding, of features within 200 px."""
    late = replace(station.assumed, latency=1.3 * thesis.FRAME_INTERVAL)
    for zoom, name, assumed in (("1X", "square", station.assumed), ("4X", "circle", late)):
        path = station.path(name, zoom)
        options = {"saturation": station.saturation[zoom], "jitter": 0.2, "assumed": assumed}
        seeds = [[station.seed, draw] for draw in range(3)]
        together = section_5_4.measured_in_runs(zoom, path, seeds, **options)
        each = [section_5_4.run(zoom, path, seed, **options) for seed in seeds]
        np.testing.assert_allclose(together, [one.measured for one in each], rtol=0, atol=1e-9)
        errors = replace(station, jitter=0.2, assumed=assumed).path_errors(zoom, name, 3)
        for row, one in zip(errors, each, strict=True):
            assert dict(zip(section_5_4.PATH_RESULTS, row, strict=True)) == pytest.approx(
                section_5_4.path_error(zoom, one)
            )


def test_the_identified_workstation_gives_the_printed_numbers() -> None:
    found = section_5_4.identify_workstation(SEED, {"1X": 390.0, "4X": 172.0})
    for name in section_5_4.PATHS:
        errors = section_5_4.mean_error(found, name)
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


def test_the_spread_after_a_step_grows_with_the_band(station) -> None:
    """The first samples inside the band are the largest errors of what follows."""
    median = {}
    for band in (0.03, 0.05, 0.1):
        other = replace(station, assumed=replace(station.assumed, band=band))
        median[band] = section_5_4.step_table(other, draws=12).set_index("claim")["median"]
    for zoom in thesis.ZOOMS:
        spread = [median[band][f"table-5.3/{zoom}/precision"] for band in (0.03, 0.05, 0.1)]
        assert spread[0] < spread[1] < spread[2]
        # Long after, two axes of measured jitter remain: no band can give less.
        assert spread[0] > 0.5 * station.jitter * thesis.effective_pixel(zoom)


def test_more_jitter_spreads_the_error(station) -> None:
    still, shaken = (
        section_5_4.path_table(replace(station, jitter=jitter), draws=4).set_index("claim")
        for jitter in (0.12, 0.3)
    )
    for path in section_5_4.PATHS:
        id = f"table-5.4/1X/{path}/precision"
        assert shaken["median"][id] > 1.2 * still["median"][id]


def test_fifty_pixels_are_the_printed_distances() -> None:
    for zoom, magnification in (("1X", 1.5893), ("4X", 6.3859)):
        pixel = claim(f"section-5.4/pixel-{zoom}").value
        assert thesis.effective_pixel(zoom) == pytest.approx(9.9 / magnification)
        assert thesis.effective_pixel(zoom) == pytest.approx(pixel, abs=0.005)
        # Cut off, not rounded: an erratum.
        assert int(50 * pixel) == claim(f"section-5.4/distance-{zoom}").value


def test_the_error_at_settling_is_a_share_of_the_printed_distance() -> None:
    """3.2 % of one axis' way; of both axes' it is below the 3 % of the text."""
    share = claim("table-5.3/1X/accuracy").value / claim("section-5.4/distance-1X").value
    assert share == pytest.approx(claim("section-5.4/error-share").ours, abs=5e-5)
    assert share / np.sqrt(2) < claim("section-5.4/error-share").value < share


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
    short = table["latency (ms)"] == 1000 * section_5_4.ASSUMED.latency
    assert (better[~short].to_numpy() > better[short].to_numpy()).all()


def least_ratio(widths: tuple[float, float]) -> float:
    """Mean over standard deviation of the size of a steady lag with normal noise: the least."""
    noise = np.random.default_rng(0).normal(0, 1, (2, 200_000)) * np.reshape(widths, (2, 1))
    sizes = [
        np.hypot(*(noise + lag * np.array([[np.cos(angle)], [np.sin(angle)]])))
        for lag in (0.0, 0.3, 1.0, 3.0)
        for angle in (0.0, np.pi / 4, np.pi / 2)
    ]
    return min(size.mean() / size.std() for size in sizes)


def test_the_printed_ratios_tell_the_zooms_apart() -> None:
    """A lag with isotropic normal noise has a mean of at least 1.91 standard deviations (Rice)."""
    ratios = section_5_4.printed_ratios()
    least = least_ratio((1.0, 1.0))
    assert least == pytest.approx(np.sqrt(np.pi / 2) / np.sqrt(2 - np.pi / 2), abs=0.01)
    assert (ratios["4X"] < least).all()
    assert (ratios["1X"] > least).all()


def test_noise_along_one_axis_explains_the_circle_only() -> None:
    """Its ratio is at least that of a half-normal number, 1.32."""
    by_share = [least_ratio((1.0, share)) for share in (0.0, 0.2, 0.5)]
    half_normal = np.sqrt(2 / np.pi) / np.sqrt(1 - 2 / np.pi)
    assert min(by_share) == pytest.approx(half_normal, abs=0.01)
    ratios = section_5_4.printed_ratios()["4X"]
    assert ratios["circle"] > half_normal
    assert ratios["square"] < half_normal
    assert ratios["sinusoid"] < half_normal


def test_the_accuracies_in_pixels_are_the_printed_ones_over_the_pixel() -> None:
    table = section_5_4.printed_in_pixels()
    assert table.loc["circle", "1X"] == pytest.approx(7.72 / 6.229, abs=0.001)
    assert table.loc["circle", "4X"] == pytest.approx(1.57 / 1.5503, abs=0.001)
    assert table.loc["circle", "ratio"] == pytest.approx(7.72 / 1.57 * 1.5893 / 6.3859, abs=1e-6)
    assert (table["ratio"] >= 1).all()
    assert table["ratio"].idxmax() == "circle"


def test_the_velocity_is_at_its_limit_for_most_of_the_settling_time(station) -> None:
    share = section_5_4.saturated_share(station, draws=3)
    # The way of 95 % to 100 % of the step, and at most three samples, are left to the end.
    assert 0.75 < share < 1
    fast = replace(station, saturation=dict.fromkeys(thesis.ZOOMS, 1e4))
    assert section_5_4.saturated_share(fast, draws=3) < 0.5


def test_no_error_in_the_same_frame_is_as_large_as_the_printed_one(station) -> None:
    least = section_5_4.path_error("1X", station.run("1X", station.path("circle")), ahead=0)
    most = section_5_4.largest_error_in_frame(station)
    assert least["accuracy"] <= most < 0.5 * section_5_4.printed_path("1X", "circle", "accuracy")


def test_a_number_beyond_those_tried_is_refused() -> None:
    with pytest.raises(ValueError, match="must reach 3"):
        section_5_4.within(np.array([1.0, 2.0]), np.array([1.0, 2.0]), 3.0)


def test_another_reading_at_4X_keeps_what_was_identified_at_1X(station) -> None:
    reading = replace(section_5_4.ASSUMED, faster=0.5, shakier=2.0)
    other = section_5_4.under(station, reading)
    assert (other.saturation, other.jitter) == (station.saturation, station.jitter)
    assert other.shake("4X") == 2 * other.shake("1X") == 2 * station.jitter
    moved = [np.linalg.norm(np.diff(other.path("circle", z), axis=0), axis=1) for z in thesis.ZOOMS]
    assert moved[1].mean() == pytest.approx(0.5 * moved[0].mean(), rel=0.01)


def test_one_speed_for_both_zooms_is_that_of_1X(station) -> None:
    other = section_5_4.under(station, section_5_4.OTHER_READINGS["band 3 %, one speed"])
    assert other.saturation["4X"] == other.saturation["1X"] > 300
    assert 0.015 < other.assumed.latency < thesis.FRAME_INTERVAL
    for zoom in thesis.ZOOMS:
        time = np.median([other.step(zoom, k)["settling-time"] for k in range(9)])
        printed = claim(f"table-5.3/{zoom}/settling-time").value
        assert time == pytest.approx(printed, abs=thesis.FRAME_INTERVAL)


def test_each_reading_gives_each_predicted_number_a_verdict(station, monkeypatch) -> None:
    readings = {
        name: section_5_4.OTHER_READINGS[name]
        for name in ("6 % slower at 4X", "5 times the jitter at 4X")
    }
    monkeypatch.setattr(section_5_4, "OTHER_READINGS", readings)
    table = section_5_4.by_reading(station, draws=8)
    assert set(table["reading"]) == {"ours", *readings}
    assert len(table) == 3 * 11
    assert not any(claim(id).star.startswith("tuned") for id in table["claim"])
    median = table.set_index(["reading", "claim"])["median"]
    ours, slower = median["ours"], median["6 % slower at 4X"]
    # The lag is one sample of motion; what is at 1X stays.
    assert slower["table-5.4/4X/square/accuracy"] == pytest.approx(
        0.94 * ours["table-5.4/4X/square/accuracy"], rel=0.01
    )
    assert slower["table-5.4/1X/square/precision"] == ours["table-5.4/1X/square/precision"]
    shaken = median["5 times the jitter at 4X"]
    for path in section_5_4.PATHS:
        id = f"table-5.4/4X/{path}/precision"
        assert shaken[id] > 2 * ours[id]
    decided = section_5_4.decided(table)
    turned = table[table["verdict"] != table["claim"].map(decided["verdict"])]
    assert set(turned["claim"]) == set(decided.index[decided["turned by"] != ""])


def test_a_taller_sinusoid_runs_less_evenly(station) -> None:
    """At the same mean error: the speed along the curve varies more."""
    flat = section_5_4.mean_error(station, "sinusoid")
    tall = replace(
        station,
        assumed=replace(station.assumed, height=2.0),
        path_speed=station.path_speed | {"sinusoid": 0.57 * station.path_speed["sinusoid"]},
    )
    error = section_5_4.mean_error(tall, "sinusoid")
    assert error[0] == pytest.approx(flat[0], rel=0.05)
    assert error[1] > 1.05 * flat[1]
