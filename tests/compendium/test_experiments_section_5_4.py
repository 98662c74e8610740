"""Section 5.4: what is found gives the printed numbers back; what is predicted follows theory."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from compendium import ledger, thesis
from compendium.experiments import section_5_4, servo_disturbances


@pytest.fixture(scope="module")
def station() -> section_5_4.Workstation:
    """A workstation near the one that is found, at round values."""
    speeds = {"circle": 40.0, "square": 32.0, "sinusoid": 27.0}
    return section_5_4.Workstation({"1X": 390.0, "4X": 172.0}, 0.12, speeds, seed=5)


def test_error_on_circle_is_one_sample_of_motion(station):
    """The controller works on f(k) − f*(k+1), so a perfect one leaves speed times interval."""
    table = section_5_4.predicted_tables(station, draws=6)
    assert (len(table), table["used"].sum()) == (18, 7)
    found = table.set_index("claim")["value"]
    for zoom in thesis.ZOOMS:
        one_sample = 40.0 * thesis.FRAME_INTERVAL * thesis.effective_pixel(zoom)
        assert found[f"table-5.4/{zoom}/circle/accuracy"] == pytest.approx(one_sample, rel=0.1)


def test_taller_sinusoid_has_lower_precision(station):
    """At the same mean error: the speed along the curve varies more."""
    flat = station.path_errors("1X", "sinusoid", 8).mean(axis=0)
    slower = station.path_speed | {"sinusoid": 0.57 * station.path_speed["sinusoid"]}
    tall = replace(station, assumed=replace(station.assumed, height=2.0), path_speed=slower)
    error = tall.path_errors("1X", "sinusoid", 8).mean(axis=0)
    assert error[0] == pytest.approx(flat[0], rel=0.05)
    assert error[1] > 1.05 * flat[1]


def test_image_based_run_agrees_with_coordinate_run(station):
    found = section_5_4.over_images(station, "4X", section_5_4.STEP_PATH[:30], (0.0, 0.0))
    assert len(found.time) == 30
    fast = station.runs("4X", section_5_4.STEP_PATH[:30], 1, start=(0.0, 0.0)).measured
    # Tracking errs by hundredths of a pixel, which a dead-beat loop turns into motion.
    assert np.abs(found.measured - fast[0]).max() < 0.3


def test_velocity_saturates_for_most_of_settling_time(station):
    # The way of 95 % to 100 % of the step, and at most three samples, are left to the end.
    assert 0.75 < section_5_4.saturated_share(station, draws=3) < 1
    fast = replace(station, saturation=dict.fromkeys(thesis.ZOOMS, 1e4))
    assert section_5_4.saturated_share(fast, draws=3) < 0.5
    # With ten times the errors of the calibration, one axis leaves the limit long before the other.
    turned = replace(station, assumed=section_5_4.Assumed(calibration=10.0))
    assert section_5_4.saturated_share(turned, draws=3) < 0.7


def test_rare_errors_have_mean_and_deviation_of_drawn_distances():
    rng = np.random.default_rng(0)
    along, across = rng.normal(0, 2.0, (2, 400_000)) * (rng.random(400_000) < 0.3)
    drawn = np.hypot(1.0 + along, across)
    expected = pytest.approx((drawn.mean(), drawn.std()), rel=0.01)
    assert section_5_4.rare_errors(1.0, 2.0, 0.3) == expected


def test_readings_report_whether_printed_number_is_inside(station, monkeypatch):
    names = ("7 % slower at 4X", "5 times the jitter at 4X")
    readings = {name: section_5_4.OTHER_READINGS[name] for name in names}
    monkeypatch.setattr(section_5_4, "OTHER_READINGS", readings)
    table = section_5_4.by_reading(station, draws=8)
    assert len(table) == 3 * 18
    inside = [row.low <= ledger.claim(row.claim).value <= row.high for row in table.itertuples()]
    assert table["inside"].tolist() == inside
    value = table.set_index(["reading", "claim"])["value"]
    assumed, slower, shaken = (value[name] for name in ("as assumed", *names))
    # The lag is one sample of motion; what is at 1X stays.
    accuracy, precision = "table-5.4/4X/square/accuracy", "table-5.4/1X/square/precision"
    assert slower[accuracy] == pytest.approx(0.93 * assumed[accuracy], rel=0.01)
    assert slower[precision] == assumed[precision]
    for path in section_5_4.PATHS:
        id = f"table-5.4/4X/{path}/precision"
        assert shaken[id] > 2 * assumed[id]


def test_readings_that_change_a_verdict_are_named_beside_it():
    readings = np.repeat(["as assumed", "one", "other"], 3)
    made = {"reading": readings, "claim": [*"abc"] * 3, "used": [False, False, True] * 3}
    made = pd.DataFrame(made).assign(inside=np.array([1, 0, 1, 0, 0, 0, 0, 1, 1], bool))
    found = section_5_4.decided(made).to_dict("index")
    expected = {"a": (True, "one; other"), "b": (False, "other")}
    assert {claim: (*row.values(),) for claim, row in found.items()} == expected


def test_known_disturbance_is_identified(station, monkeypatch):
    """Numbers that paths begun 14 µm beside their start give, in place of the printed ones."""
    label = "begun beside the start"
    strength = (label, np.tile([1.0, 14.0], (60, 1)), np.full(60, station.jitter))
    made = {}
    for name in section_5_4.PATHS:
        for zoom in thesis.ZOOMS:
            runs = servo_disturbances.disturbed(station, zoom, station.path(name), *strength)
            for what, number in zip(section_5_4.PATH_RESULTS, np.median(runs, axis=0), strict=True):
                made[zoom, name, what] = number
    monkeypatch.setattr(servo_disturbances, "printed_path", lambda *entry: made[entry])
    few = {label: servo_disturbances.DISTURBANCES[label], "none": ("", [(0.0, 0.0)])}
    monkeypatch.setattr(servo_disturbances, "DISTURBANCES", few)
    strength, deviation, numbers = servo_disturbances.fit(station, label)
    assert strength.split()[0] in {"10", "14", "20"}
    assert deviation < 0.1 < 0.3 < servo_disturbances.fit(station, "none")[1]
    logs = np.log(numbers["fitted"] / numbers["printed"])
    assert np.sqrt(np.mean(logs**2)) == pytest.approx(deviation)


def test_settling_times_of_both_zooms_follow_from_one_speed_and_one_rest():
    speed, rest = section_5_4.common_speed()
    for zoom in thesis.ZOOMS:
        time = 50 * thesis.effective_pixel(zoom) / speed + rest
        assert time == pytest.approx(ledger.claim(f"table-5.3/{zoom}/settling-time").value)
