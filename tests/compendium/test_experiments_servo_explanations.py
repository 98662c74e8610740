"""One disturbance at a time: beside the chapter's own runs, and each where it should be."""

from __future__ import annotations

import numpy as np
import pytest

from compendium import thesis
from compendium.experiments import section_5_4, servo_explanations

STATION = section_5_4.Workstation(
    saturation={"1X": 390.0, "4X": 172.0},
    jitter=0.12,
    path_speed={"circle": 40.0, "square": 32.0, "sinusoid": 27.0},
    seed=5,
    assumed=section_5_4.Assumed(calibration=0.0),
)


def test_undisturbed_numbers_are_those_of_the_chapter() -> None:
    """Other draws of the same loop: medians of forty and of ten runs, a fiftieth apart."""
    for zoom, name in (("1X", "sinusoid"), ("4X", "square")):
        found = servo_explanations.path_numbers(STATION, zoom, name, {}, 0)
        same = np.median(STATION.path_errors(zoom, name, 10), axis=0)
        assert found == pytest.approx(same, rel=0.05)


def test_disturbances_in_px_scale_with_the_zoom_and_those_of_the_stage_do_not() -> None:
    def spread(zoom: str, **given: float) -> float:
        found = servo_explanations.path_numbers(STATION, zoom, "circle", given, 0)
        return found[1] / thesis.effective_pixel(zoom)

    assert spread("4X", lost=0.15) == pytest.approx(spread("1X", lost=0.15), rel=0.1)
    assert spread("4X", start=15.0) > 3 * spread("1X", start=15.0)
    # What is dropped leaves hardly a trace.
    assert spread("4X", dropped=0.15) < 1.3 * spread("4X")


def test_the_table_has_the_print_beside_each() -> None:
    table = servo_explanations.table(STATION).set_index("path")
    assert list(table.columns) == ["printed", *servo_explanations.TRIED]
    assert table.loc["circle at 4X", "printed"] == "1.57 ± 0.95"
    assert len(table) == 6
