"""The sentences of chapter 6, against numbers typed from the thesis."""

from __future__ import annotations

import pytest

from compendium.experiments import chapter_6
from compendium.ledger import Record


def test_sentences_are_held_against_the_printed_numbers() -> None:
    assert chapter_6.of_printed_numbers() == pytest.approx(
        {
            "abstract/modulus-obtained": 121.22 / 246.95,
            "section-5.2/lenses-precise": (8.4 + 2.1) / 8.4,
            # In px: 0.95, 1.24, 0.77 at 1X; 0.95, 1.01, 0.72 at 4X.
            "section-5.4/tracked-accurately": 4 / 6,
            "section-6/precise-and-accurate": 1.12,
        }
    )


def test_sentences_are_held_against_the_records() -> None:
    values = {
        "section-5.5/crest-convex-cylindric": 0.41,
        "section-5.5/sides-planar": 0.97,
        "5.5/ridge-thesis": 10.0,
    }
    records = {name: Record(name, v, v, v, "", "result", 2) for name, v in values.items()}
    assert chapter_6.of_records(records) == pytest.approx(
        {"section-6/reconstruction-synthetic": 10 / 25, "section-6/homogeneous-patches": 0.59}
    )
