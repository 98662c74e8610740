"""Chapter 3: labels follow from what a type's name says; windows, curvature and depth are right."""

from __future__ import annotations

import pytest

from compendium import ledger
from compendium.experiments import chapter_3
from microlib.curvature import HK_NAMES, curvature_windows


def wrong(claim: str, value: float) -> bool:
    return bool(ledger.appraise(ledger.claim(claim), value, value, value)[1])


def test_each_type_gets_the_label_of_its_name() -> None:
    found = chapter_3.labels_by_name()
    # The names that the book shows beside the labels are the table's.
    assert {label: name for name, label in found.items()} == HK_NAMES
    assert not [n for n, label in found.items() if wrong(f"table-3.1/{n.replace(' ', '-')}", label)]


def test_eight_types_are_possible() -> None:
    assert chapter_3.surface_types() == set(range(1, 10)) - {4}
    assert not wrong("section-3.2.1/surface-types", 8)
    assert wrong("section-3.2.1/surface-types", 9)


def test_the_windows_are_whole_numbers_over_one_divisor(monkeypatch) -> None:
    found = chapter_3.window_divisors()
    assert found == pytest.approx({"s": 64, "d0": 7, "d1": 28, "d2": 42})
    for name, divisor in found.items():
        assert not wrong(f"section-3.2.1/{name}", divisor)
        assert wrong(f"section-3.2.1/{name}", 2 * divisor)
    right = curvature_windows(7)
    twice = type(right)(**(vars(right) | {"slope": 2 * right.slope}))
    monkeypatch.setattr(chapter_3, "curvature_windows", lambda size: twice)
    assert chapter_3.window_divisors()["d1"] == pytest.approx(14)
