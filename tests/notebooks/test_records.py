"""Recorded numbers of a few lines of a notebook, against a calculation of their own."""

from __future__ import annotations

from math import sqrt
from pathlib import Path

import pytest

from compendium import ledger


@pytest.fixture(scope="module")
def recorded(claims_folder: Path) -> dict[str, float]:
    return {id: record.value for id, record in ledger.read_records(claims_folder).items()}


def test_a_wet_grain_sticks_below_six_millimeters(recorded) -> None:
    """4πRγ = 4/3 πR³ρg: water on silicon, at its diameter in mm; five digits are stored."""
    diameter = 2e3 * sqrt(3 * 0.073 / (2330 * 9.81))
    assert recorded["section-2.1/part-size"] == pytest.approx(diameter, abs=5e-5)


def test_the_zoom_goes_from_three_quarters_to_eleven_and_a_quarter(recorded) -> None:
    assert recorded["section-5.1/zoom-ratio"] == pytest.approx(11.25 / 0.75, rel=1e-12)


def test_the_magnification_is_of_the_pattern_that_is_further_off(recorded) -> None:
    """Table 5.1 has 1.5893 (circles) and 1.6236 (squares) for 1.6, 6.3859 and 6.444 for 6.4."""
    assert recorded["section-5.2/magnification-1X"] == 1.6236
    assert recorded["section-5.2/magnification-4X"] == 6.444
