"""The engine of the laws notices what it is for; each case is a function with one fault."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from microlib._common import Tidy
from tests.laws import VIEWS, Law, hold, hold_coverage, hold_same_as_new, hold_sigma


@dataclass(frozen=True)
class Fall(Tidy):
    speed: float
    covariance: np.ndarray
    name: str = "fall"

    @property
    def slow(self) -> float:
        return self.speed / 2


UNITS = {"speed": "um/s", "covariance": "outer([um, s], [um, s])", "name": "=", "slow": "um/s"}


def fall(way, time, *, power=1, shift=0.0, calls=None):
    """Return a speed from a way and its times, right but for what the options spoil."""
    more = 0.0 if calls is None else float(len(calls))
    if calls is not None:
        calls.append(1)
    length, lasts = way[1] - way[0], time[1] - time[0] + shift * time[0]
    return Fall(length**power / lasts + more, np.outer([length, lasts], [length, lasts]))


def law(gives=None, **options):
    return Law(
        lambda u: {
            "way": u.z0 + np.array([1.0, 6.0]) * u.um,
            "time": u.t0 + np.array([0.2, 0.7]) * u.s,
        },
        UNITS if gives is None else gives,
        call=lambda way, time: fall(way, time, **options),
    )


def test_what_is_right_passes():
    hold("fall", law())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (law(power=2), "in other units from another origin: .speed is"),
        (law(shift=0.1), "from another origin: .speed is"),
        (law(calls=[]), "called again: .speed is"),
        (law({"speed": "um/s"}), ".covariance has no unit"),
        (law(UNITS | {"covariance": "um**2"}), r"to_dict\(\)\['covariance"),
        (law(UNITS | {"slow": "uN"}), "do not use {'uN'}"),
    ],
)
def test_what_is_wrong_is_named(wrong, message):
    with pytest.raises(AssertionError, match=message):
        hold("fall", wrong)


def test_a_missing_degree_of_freedom_is_noticed():
    """Of means of three numbers; numpy's `std` divides by three, not by two."""
    drawn = np.random.default_rng(0).normal(0.0, 1.7, (1000, 3))
    means, sigma = drawn.mean(axis=1), drawn.std(axis=1, ddof=1) / 3**0.5
    hold_sigma(means, sigma, 2)
    with pytest.raises(AssertionError, match="on average, not 1 ±"):
        hold_sigma(means, drawn.std(axis=1) / 3**0.5, 2)
    hold_coverage(np.abs(drawn[:, 0]) < 1.7 * 0.6745, 0.5)
    with pytest.raises(AssertionError, match="of 1000, not"):
        hold_coverage(np.abs(drawn[:, 0]) < 1.7 * 0.6745, 0.6)


def test_an_object_that_keeps_something_is_noticed():
    with pytest.raises(AssertionError, match="instead of"):
        hold_same_as_new(list, len, lambda kept: kept.append(1))
    hold_same_as_new(dict, len, lambda kept: kept.get(1))


def test_a_view_takes_points_with_the_picture():
    picture = np.arange(12).reshape(3, 4)
    for view in VIEWS:
        x, y = view.points([3, 1], picture.shape).astype(int)
        assert view.image(picture)[y, x] == picture[1, 3]
