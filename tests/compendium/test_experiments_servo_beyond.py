"""Disturbances and controllers beyond the thesis: strengths are found again, delay costs less."""

from __future__ import annotations

import numpy as np
import pytest

from compendium import thesis
from compendium.experiments import section_5_4, servo_disturbances


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
    table, numbers = servo_disturbances.compare(station)
    assert table["disturbance"].tolist() == [label, "none"]
    assert table["fitted"].iloc[0].split()[0] in {"10", "14", "20"}
    assert table["misfit"].iloc[0] < 0.1 < 0.3 < table["misfit"].iloc[1]
    logs = np.log(numbers[label]["fitted"] / numbers[label]["printed"])
    assert np.sqrt(np.mean(logs**2)) == pytest.approx(table["misfit"].iloc[0])
