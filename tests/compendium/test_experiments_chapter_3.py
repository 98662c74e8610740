"""Chapter 3: labels follow from what a type's name says; windows, curvature and depth are right."""

from __future__ import annotations

import numpy as np
import pytest

from compendium.experiments import chapter_3
from microlib.curvature import HK_NAMES, curvature_windows


def test_each_type_gets_the_label_of_its_name() -> None:
    # The names that the book shows beside the labels are the table's.
    assert {label: name for name, label in chapter_3.labels_by_name().items()} == HK_NAMES


def test_eight_types_are_possible() -> None:
    assert chapter_3.surface_types() == set(range(1, 10)) - {4}


def test_the_windows_are_whole_numbers_over_one_divisor(monkeypatch) -> None:
    found = chapter_3.window_divisors()
    assert found == pytest.approx({"s": 64, "d0": 7, "d1": 28, "d2": 42})
    right = curvature_windows(7)
    twice = type(right)(**(vars(right) | {"slope": 2 * right.slope}))
    monkeypatch.setattr(chapter_3, "curvature_windows", lambda size: twice)
    assert chapter_3.window_divisors()["d1"] == pytest.approx(14)


def test_errors_are_in_steps_of_the_stage() -> None:
    truth = np.full((40, 40), 30.0)
    frames, positions = np.zeros((9, 40, 40)), 10.0 * np.arange(9)
    rng = np.random.default_rng(0)
    texture = rng.uniform(0, 255, (40, 40))
    for k, position in enumerate(positions):  # sharpest at 30 µm
        frames[k] = 128 + (texture - 128) * np.exp(-(((position - 30) / 20) ** 2))
    _, table = chapter_3.depths(frames, positions, truth + 5.0, {"sml": {"measure": "sml"}})
    assert table.loc["sml", "RMS error (frame spacings)"] == pytest.approx(0.5, abs=0.01)
    assert table.loc["sml", "beyond one spacing (%)"] == 0
