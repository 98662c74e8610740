"""Results as flat rows that JSON can hold, and as pickles."""

import inspect
import json
import pickle
import re
from dataclasses import dataclass, is_dataclass

import numpy as np
import pytest

from microlib._common import FlatResult
from tests import fuzz
from tests.laws import unlike

#: Maps, windows and devices: what one row or a row per sample does not fit.
NO_ROWS = {"Curvature", "Windows", "Profile", "PeakFit", "StageModel", "CameraTiming"} | {
    *("Calibration", "ErrorSummary", "Detection", "Micrometer", "StageAffine"),
}


@dataclass(frozen=True)
class Inner(FlatResult):
    center: tuple[float, float]
    inner_misfit: float


@dataclass(frozen=True)
class Outer(FlatResult):
    _large = ("x",)

    x: np.ndarray
    inner: Inner
    covariance: np.ndarray
    given: dict
    names: tuple[str, ...]
    lost: np.bool_


def test_row_is_flat_and_json():
    inner, covariance = Inner((3.0, 4.0), np.inf), np.array([[1.0, np.nan], [0.5, 2.0]])
    given = {"force": np.float32(0.5)}
    row = Outer(np.ones(9), inner, covariance, given, ("f", "M"), np.bool_(True)).to_dict()
    assert json.loads(json.dumps(row, allow_nan=False)) == {
        "inner_center_x": 3.0, "inner_center_y": 4.0, "inner_misfit": None, "covariance_0_0": 1.0,
        "covariance_0_1": None, "covariance_1_0": 0.5, "covariance_1_1": 2.0, "given_force": 0.5,
        "names": "f, M", "lost": True,
    }  # fmt: skip


def results(value: object) -> list[object]:
    """Return the results of the library in what a call returned."""
    if isinstance(value, (tuple, list)):
        return [found for part in value for found in results(part)]
    known = is_dataclass(value) and not inspect.isclass(value)
    return [value] if known and type(value).__module__.startswith("microlib.") else []


@pytest.mark.parametrize("name", fuzz.names())
def test_every_result_has_repr_row_and_pickle(name):
    result, wrong = fuzz.answer(name, {})
    assert wrong is None
    for found in results(result):
        kind = type(found).__name__
        if kind == "Stack":  # which reads a file
            continue
        assert 1 <= len(repr(found).splitlines()) <= 10
        assert found == found
        assert not [*unlike(found, pickle.loads(pickle.dumps(found)))]
        if name.startswith("synthetic.") or kind in NO_ROWS:
            continue
        assert isinstance(found, FlatResult), kind
        row = found.to_dict()
        assert not [n for n in row if re.search(r"_\d", n)]
        assert json.loads(json.dumps(row, allow_nan=False)) == row
        assert all(v is None or isinstance(v, (bool, int, float, str)) for v in row.values())
