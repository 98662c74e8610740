"""The sentences of chapter 6, against numbers typed from the thesis, and the test of two stages."""

from __future__ import annotations

import numpy as np
import pytest

from compendium.experiments import chapter_6
from compendium.ledger import Record
from microlib.membrane import modulus_std


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


def test_sensitivities_are_those_of_the_closed_form():
    found = chapter_6.log_sensitivities()
    values = {"force": 197.24, "dimple_radius": 246.954, "dimple_depth": 121.217}
    values |= {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}
    modulus = 1.32372  # MPa
    for name, by in found.items():
        # With the input's own value as its standard deviation, that of E is E times the exponent.
        assert abs(by) == pytest.approx(modulus_std(values, {name: values[name]}) / modulus, 1e-5)
    assert set(found) == set(values) - {"poisson_ratio"}


@pytest.mark.parametrize("std", [0.05, 0.1, 0.2, 1.0])
def test_power_equals_share_of_detected_simulated_differences(std):
    first, second = np.random.default_rng(1).normal(0, std, (2, 100_000))
    differ = np.abs(first - second + np.log(1.66)) > 1.959964 * np.sqrt(2) * std
    # Four standard errors of a share of 100 000.
    assert float(chapter_6.power(std)) == pytest.approx(differ.mean(), abs=0.0065)
