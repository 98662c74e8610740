"""Results as rows: flat, whole, and readable by JSON and by a table."""

from __future__ import annotations

import inspect
import json
from dataclasses import dataclass, is_dataclass

import numpy as np
import pandas as pd
import pytest

from microlib._common import Tidy
from tests import fuzz

#: Maps, windows and devices: what one row or a row per sample does not fit.
NO_ROWS = {"Curvature", "Windows", "Profile", "PeakFit", "Stage", "Camera"}


@dataclass(frozen=True)
class Inner(Tidy):
    center: tuple[float, float]
    inner_misfit: float


@dataclass(frozen=True)
class Outer(Tidy):
    _samples = ("x", "points")

    x: np.ndarray
    points: np.ndarray
    inner: Inner
    covariance: np.ndarray
    given: dict
    names: tuple[str, ...]
    count: np.int64
    lost: np.bool_
    nothing: None


def outer() -> Outer:
    return Outer(
        np.array([1.0, 2.0, np.nan]),
        np.arange(6.0).reshape(3, 2),
        Inner((3.0, 4.0), np.inf),
        np.array([[1.0, np.nan], [0.5, 2.0]]),
        {"force": np.float32(0.5)},
        ("f", "M"),
        np.int64(7),
        np.bool_(True),
        None,
    )


def test_a_row_is_flat_and_json() -> None:
    row = outer().to_dict()
    assert json.loads(json.dumps(row, allow_nan=False)) == {
        "inner_center_x": 3.0,
        "inner_center_y": 4.0,
        "inner_misfit": None,
        "covariance_0_0": 1.0,
        "covariance_0_1": None,
        "covariance_1_0": 0.5,
        "covariance_1_1": 2.0,
        "given_force": 0.5,
        "names": "f, M",
        "count": 7,
        "lost": True,
        "nothing": None,
    }


def test_a_table_has_a_row_a_sample() -> None:
    expected = pd.DataFrame({"x": [1, 2, np.nan], "points_x": [0.0, 2, 4], "points_y": [1.0, 3, 5]})
    pd.testing.assert_frame_equal(outer().to_frame(), expected)
    table = Inner((3.0, 4.0), 5.0).to_frame()
    assert table.to_dict("records") == [{"center_x": 3.0, "center_y": 4.0, "inner_misfit": 5.0}]


def results(value: object) -> list[object]:
    """Return the results of the library in what a call returned."""
    if isinstance(value, (tuple, list)):
        return [found for part in value for found in results(part)]
    ours = is_dataclass(value) and type(value).__module__.startswith("microlib.")
    return [value] if ours else []


@pytest.mark.parametrize(
    "name", [n for n in fuzz.CALLS if n not in fuzz.SLOW and not n.startswith("synthetic.")]
)
def test_every_result_of_the_library_can_be_written_down(name: str) -> None:
    result, wrong = fuzz.answer(name, {})
    assert wrong is None
    for found in results(result):
        if type(found).__name__ in NO_ROWS or inspect.isclass(found):
            continue
        assert isinstance(found, Tidy), type(found)
        row, table = found.to_dict(), found.to_frame()
        assert json.loads(json.dumps(row, allow_nan=False)) == row
        assert all(v is None or isinstance(v, (bool, int, float, str)) for v in row.values())
        assert row or len(found._samples)
        assert not any(isinstance(v, (list, dict, np.ndarray)) for v in table.iloc[0])
        assert len(table) == (len(getattr(found, found._samples[0])) if found._samples else 1) or (
            type(found).__name__ in ("ServoRun", "InjectionRun")
        )
