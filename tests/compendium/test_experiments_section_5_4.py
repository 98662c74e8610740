"""Section 5.4: what is found gives the printed numbers back; what is predicted follows theory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compendium import thesis
from compendium.experiments import section_5_4


def medians(station: section_5_4.Workstation, draws: int) -> dict[str, float]:
    table = section_5_4.predicted_tables(station, draws)
    assert (len(table), table["fitted"].sum()) == (18, 7)
    return dict(zip(table["claim"], table["value"], strict=True))


def test_error_on_circle_is_one_sample_of_motion(station):
    """The controller works on f(k) − f*(k+1), so a perfect one leaves speed times interval."""
    found = medians(station, draws=6)
    for zoom in thesis.ZOOMS:
        one_sample = 40.0 * thesis.FRAME_INTERVAL * thesis.effective_pixel(zoom)
        assert found[f"table-5.4/{zoom}/circle/accuracy"] == pytest.approx(one_sample, rel=0.1)


def test_precision_after_step_grows_with_band(station):
    """The first frames inside the band have the largest errors of what follows."""
    bands = [replace(station.assumed, band=band) for band in (0.03, 0.05, 0.1)]
    for zoom in thesis.ZOOMS:
        spread = [np.median(replace(station, assumed=b).steps(zoom, 12)[:, 2]) for b in bands]
        assert spread[0] < spread[1] < spread[2]
        # Long after, two axes of measured jitter remain: no band can give less.
        assert spread[0] > 0.5 * station.jitter * thesis.effective_pixel(zoom)


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
    share = section_5_4.saturated_share(station, draws=3)
    # The way of 95 % to 100 % of the step, and at most three samples, are left to the end.
    assert 0.75 < share < 1
    fast = replace(station, saturation=dict.fromkeys(thesis.ZOOMS, 1e4))
    assert section_5_4.saturated_share(fast, draws=3) < 0.5


def test_readings_report_whether_printed_number_is_inside(station, monkeypatch):
    names = ("7 % slower at 4X", "5 times the jitter at 4X")
    readings = {name: section_5_4.OTHER_READINGS[name] for name in names}
    monkeypatch.setattr(section_5_4, "OTHER_READINGS", readings)
    table = section_5_4.by_reading(station, draws=8)
    assert set(table["reading"]) == {"as assumed", *names}
    assert len(table) == 3 * 18
    value = table.set_index(["reading", "claim"])["value"]
    assumed, slower, shaken = (value[name] for name in ("as assumed", *names))
    # The lag is one sample of motion; what is at 1X stays.
    accuracy, precision = "table-5.4/4X/square/accuracy", "table-5.4/1X/square/precision"
    assert slower[accuracy] == pytest.approx(0.93 * assumed[accuracy], rel=0.01)
    assert slower[precision] == assumed[precision]
    for path in section_5_4.PATHS:
        id = f"table-5.4/4X/{path}/precision"
        assert shaken[id] > 2 * assumed[id]
    decided = section_5_4.decided(table)
    turned = table[(table["inside"] != table["claim"].map(decided["inside"])) & ~table["fitted"]]
    assert set(turned["claim"]) == set(decided.index[decided["changed by"] != ""])


def test_jitter_lowers_precision(station):
    for path in section_5_4.PATHS:
        still, shaken = (
            np.median(replace(station, jitter=jitter).path_errors("1X", path, 4)[:, 1])
            for jitter in (0.12, 0.3)
        )
        assert shaken > 1.2 * still
