"""Results as flat rows that JSON can hold."""

import json
from dataclasses import dataclass

import numpy as np

from microlib._common import FlatResult


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


def test_to_dict_gives_a_flat_row_that_json_can_hold():
    inner, covariance = Inner((3.0, 4.0), np.inf), np.array([[1.0, np.nan], [0.5, 2.0]])
    given = {"force": np.float32(0.5)}
    row = Outer(np.ones(9), inner, covariance, given, ("f", "M"), np.bool_(True)).to_dict()
    assert json.loads(json.dumps(row, allow_nan=False)) == {
        "inner_center_x": 3.0, "inner_center_y": 4.0, "inner_misfit": None, "covariance_0_0": 1.0,
        "covariance_0_1": None, "covariance_1_0": 0.5, "covariance_1_1": 2.0, "given_force": 0.5,
        "names": "f, M", "lost": True,
    }  # fmt: skip
