"""Each law fails for a function with the fault that it is for."""

import numpy as np
import pytest

from tests import laws
from tests.laws import SAME, VIEWS, Row, covariance, hold_coverage, hold_sigma, s, um, uN
from tests.test_microscope import SCOPE

UNITS = {"speed": um / s, "covariance": covariance(um, s), "name": SAME}


def fall(way, time, *, power=1, shift=0.0, calls=None):
    """Return a speed from a way and its times, right but for what the options spoil."""
    more = 0.0 if calls is None else float(len(calls))
    if calls is not None:
        calls.append(1)
    length, lasts = way[1] - way[0], time[1] - time[0] + shift * time[0]
    variances = np.outer([length, lasts], [length, lasts])
    return {"speed": length**power / lasts + more, "covariance": variances, "name": "fall"}


def row(unit=UNITS, **options):
    return Row(
        lambda u: {
            "way": u.z0 + np.array([1.0, 6.0]) * u.um,
            "time": u.t0 + np.array([0.2, 0.7]) * u.s,
        },
        unit,
        call=lambda way, time: fall(way, time, **options),
    )


@pytest.mark.parametrize(
    ("law", "wrong", "message"),
    [
        (laws.scales_with_units, row(power=2), "fall.speed"),
        (laws.follows_origins, row(shift=0.1), "fall.speed"),
        (laws.second_call_gives_the_same, row(calls=[]), "fall.speed"),
        (laws.scales_with_units, row(UNITS | {"speed": um}), "fall.speed"),
        (laws.scales_with_units, row(UNITS | {"speed": uN}), "the unit {'uN'}"),
        (laws.scales_with_units, row({"speed": um / s}), "has no unit for"),
    ],
)
def test_law_names_what_breaks_it(law, wrong, message):
    law("fall", row())
    with pytest.raises(AssertionError, match=message):
        law("fall", wrong)


def test_hold_sigma_fails_with_wrong_degrees_of_freedom():
    """Of means of three numbers; numpy's `std` divides by three, not by two."""
    drawn = np.random.default_rng(0).normal(0.0, 1.7, (1000, 3))
    means, sigma = drawn.mean(axis=1), drawn.std(axis=1, ddof=1) / 3**0.5
    hold_sigma(means, sigma, 2)
    with pytest.raises(AssertionError, match="on average, not 1 ±"):
        hold_sigma(means, drawn.std(axis=1) / 3**0.5, 2)
    hold_coverage(np.abs(drawn[:, 0]) < 1.7 * 0.6745, 0.5)
    with pytest.raises(AssertionError, match="of 1000, not"):
        hold_coverage(np.abs(drawn[:, 0]) < 1.7 * 0.6745, 0.6)


def test_hold_same_as_new_fails_for_object_with_memory():
    with pytest.raises(AssertionError, match="instead of"):
        laws.hold_same_as_new(list, len, lambda kept: kept.append(1))
    laws.hold_same_as_new(dict, len, lambda kept: kept.get(1))


def test_view_transforms_points_with_image():
    picture = np.arange(12).reshape(3, 4)
    for view in VIEWS:
        x, y = view.points([3, 1], picture.shape).astype(int)
        assert view.image(picture)[y, x] == picture[1, 3]


def test_laws_hold_for_properties_too():
    assert {"tx", "rotation"} <= set(laws.held(SCOPE))
