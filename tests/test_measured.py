"""The benchmarks' tables of constants speak of the values that the library has.

A comment says what a constant is worth and names the table that shows it. A constant that changes
takes the ground from under both: the benchmark has to run again.
"""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.focus import CONSTANTS, _shown

RESULTS = Path(__file__).resolve().parent.parent / "benchmarks" / "results"


def table(file: str, title: str) -> list[dict[str, Any]]:
    tables = json.loads((RESULTS / file).read_text(encoding="utf-8"))["tables"]
    (found,) = [content for name, content in tables.items() if name.startswith(title)]
    return [dict(zip(found["columns"], row, strict=True)) for row in found["data"]]


def value_of(package: str, name: str) -> Any:
    module, constant = name.split(".")
    return getattr(importlib.import_module(f"microlib.{package}.{module}"), constant)


@pytest.mark.parametrize(
    "title", ["Other values of the constants (", "Other values of the constants of eight Gaussians"]
)
def test_constants_of_the_embryo_have_the_values_that_were_measured(title: str) -> None:
    rows = table("embryo.json", title)
    assert len(rows) >= 8
    for row in rows:
        value = np.atleast_1d(value_of("embryo", row["constant"]))
        if " by " in row["value"]:
            ends, step = row["value"].split(" by ")
            first, last = map(float, ends.split(" to "))
            expected = np.arange(first, last + 0.5 * float(step), float(step))
        else:
            expected = np.array([float(part) for part in row["value"].split(" and ")])
        # Written with six digits.
        assert value == pytest.approx(expected, rel=1e-5), row["constant"]


def test_constants_of_the_depth_have_the_values_that_were_measured() -> None:
    rows = table("focus_depth.json", "One constant changed")
    assert len(rows) >= 20
    for row in rows:
        assert str(value_of("focus", row["constant"])) == row["is"], row["constant"]
    places = {(title, _shown(getattr(module, name))) for title, module, name, _ in CONSTANTS}
    rows = table("focus.json", "Default depth with one constant changed")
    assert {(row["constant"], row["is"]) for row in rows} == places
