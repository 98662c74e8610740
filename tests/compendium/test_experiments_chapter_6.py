"""The sentences of chapter 6, against numbers typed from the thesis, and the test of two stages."""

from __future__ import annotations

import numpy as np
import pytest

from compendium.experiments import chapter_6
from compendium.ledger import Record


def test_values_of_sentences_follow_from_printed_numbers():
    assert chapter_6.of_printed_numbers() == pytest.approx(
        {
            "section-4.1/small-slopes": 121.22 / 246.95,
            "section-5.4/settles-in-a-second": 0.80,
            # In px: 0.95, 1.24, 0.77 at 1X; 0.95, 1.01, 0.72 at 4X.
            "section-5.4/tracked-accurately": 4 / 6,
            "section-6/precise-and-accurate": 1.12,
        }
    )


def test_values_of_sentences_follow_from_records():
    records = {"5.5/ridge-thesis": Record("5.5/ridge-thesis", 10.0, 10.0, 10.0, "µm", "result", 1)}
    found = chapter_6.of_records(records)
    assert found == pytest.approx({"section-6/reconstruction-synthetic": 10 / 25})


@pytest.mark.parametrize("std", [0.05, 0.1, 0.2, 1.0])
def test_power_equals_share_of_detected_simulated_differences(std):
    first, second = np.random.default_rng(1).normal(0, std, (2, 100_000))
    differ = np.abs(first - second + np.log(1.66)) > 1.959964 * np.sqrt(2) * std
    # Four standard errors of a share of 100 000.
    assert float(chapter_6.power(std)) == pytest.approx(differ.mean(), abs=0.0065)
