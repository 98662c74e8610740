"""The sentences of chapter 6, against numbers typed from the thesis."""

from __future__ import annotations

import pytest

from compendium.experiments import chapter_6
from compendium.ledger import Record


def test_values_of_sentences_follow_from_printed_numbers() -> None:
    assert chapter_6.of_printed_numbers() == pytest.approx(
        {
            "section-4.1/small-slopes": 121.22 / 246.95,
            "section-5.4/settles-in-a-second": 0.80,
            # In px: 0.95, 1.24, 0.77 at 1X; 0.95, 1.01, 0.72 at 4X.
            "section-5.4/tracked-accurately": 4 / 6,
            "section-6/precise-and-accurate": 1.12,
        }
    )


def test_values_of_sentences_follow_from_records() -> None:
    records = {"5.5/ridge-thesis": Record("5.5/ridge-thesis", 10.0, 10.0, 10.0, "µm", "result", 1)}
    found = chapter_6.of_records(records)
    assert found == pytest.approx({"section-6/reconstruction-synthetic": 10 / 25})
