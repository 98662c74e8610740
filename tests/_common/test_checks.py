"""Argument checks: what passes unchanged, and that a refusal names the argument and what came."""

from __future__ import annotations

import numpy as np
import pytest

from microlib._common import (
    as_array,
    as_image,
    between,
    flag,
    generator,
    image_shape,
    items,
    of_kind,
    one_of,
    positive,
    refuse_masks,
    same_length,
    scalar,
    whole,
)


def test_what_is_right_passes():
    array = np.arange(6.0).reshape(2, 3)
    assert as_array("x", array, shape=(None, 3)) is array
    assert np.isnan(as_array("x", [np.nan], finite=False)).all()
    assert as_image("x", np.zeros((3, 4), np.uint8), smallest=3).dtype == np.float32
    assert between("x", [0.0, 1.0], 0, 1, closed=True).tolist() == [0.0, 1.0]
    assert positive("x", [0.0, 2.0], zero=True).tolist() == [0.0, 2.0]
    assert whole("x", np.int64(3), least=3, odd=True, most=3) == 3
    assert flag("x", np.False_) is False
    # NumPy's generator of the same seed draws the same; zero is a seed.
    assert generator("x", 0).random() == np.random.default_rng(0).random()
    assert items("x", range(2), 2) == (0, 1)
    assert image_shape("x", [65536, np.int64(4096)]) == (65536, 4096)
    assert scalar("x", 1.0, within=(0, 1), closed=True) == scalar("x", 1, least=1, most=1) == 1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: as_array("x", "ab"), "x must hold real numbers, got str"),
        (lambda: as_array("x", [[1.0], [1.0, 2.0]]), "x must hold real numbers, got list"),
        (
            lambda: as_array("x", [1.0], shape=(None, 2)),
            r"x must have shape \(any, 2\), got \(1,\)",
        ),
        (lambda: as_array("x", np.zeros((0, 2))), r"x must not be empty, got shape \(0, 2\)"),
        (
            lambda: as_array("x", [1, np.nan, np.inf]),
            "x must be finite, got 2 NaN or infinite of 3",
        ),
        (lambda: as_image("x", np.zeros((2, 2, 3))), "x must be a grey image .* got 3"),
        (
            lambda: as_image("x", np.zeros((9, 3)), smallest=4),
            r"x must be at least 4 px .*\(9, 3\)",
        ),
        (lambda: between("x", [0.5, 1.0], 0, 1), r"x must lie in \(0, 1\), got 1"),
        (lambda: between("x", 1.5, 0, 1, closed=True), r"x must lie in \[0, 1\], got 1.5"),
        (lambda: positive("x", [1.0, 0.0]), "x must be positive, got 0"),
        (lambda: positive("x", -1.0, zero=True), "x must be zero or positive, got -1"),
        (lambda: whole("x", 2.0, least=1), r"x must be a whole number, got 2\.0"),
        (lambda: whole("x", True, least=1), "x must be a whole number, got True"),
        (lambda: whole("x", 2, least=3), "x must be a whole number of at least 3, got 2"),
        (lambda: whole("x", 4, least=3, odd=True), "an odd whole number of at least 3, got 4"),
        (lambda: one_of("x", "c", ("a", "b")), "x must be one of a, b, got 'c'"),
        (lambda: same_length(("x", "y"), np.zeros(2), np.zeros(3)), "x and y .* got 2 and 3"),
        (lambda: as_image("x", np.full((2, 2), 2e10)), r"x must lie within ±1e\+10, got 2e\+10"),
        (lambda: positive("x", [1.0, 1e-70]), "x must be at least 1e-60, got 1e-70"),
        (lambda: refuse_masks("x", [0, np.ma.array([1.0])]), "x must be without a mask"),
        (lambda: as_array("x", (np.ma.array([1.0]),)), "x must be without a mask"),
        (lambda: of_kind("x", 3, str, bytes), "x must be of the kind str or bytes, got int"),
        (lambda: flag("x", "a" * 1000), "x must be True or False, got 'a{79}$"),
        (lambda: flag("x", 10**5000), "got a huge number$"),
        (lambda: whole("x", 10**400, least=1, most=5), "x must be at most 5"),
        (lambda: generator("x", -1), "x must be a numpy.random.Generator or a seed .* got -1"),
        (lambda: items("x", "ab", 2), "x must be 2 numbers, got 'ab'"),
        (lambda: items("x", np.ma.array([1, 2]), 2), "x must be 2 numbers, got masked"),
        (lambda: items("x", np.zeros((2, 2)), 2), "x must be 2 numbers, got array"),
        (lambda: items("x", [1], 2), "x must be 2 numbers, got 1"),
        (lambda: image_shape("x", (3, 4, 5)), "x must be 2 numbers, got 3"),
        (lambda: image_shape("x", (0, 4)), "x must be a whole number of at least 1, got 0"),
        (lambda: image_shape("x", (65537, 1)), "x must be at most 65536 px a side .* got 65537×1"),
        (lambda: image_shape("x", (16385, 16384)), "and 268435456 px in all, got 16385×16384"),
    ],
)
def test_a_refusal_says_what_is_wrong(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2), np.uint8(2), np.array(2.0)])
def test_a_single_number_becomes_a_float(value):
    number = scalar("x", value, above=0, most=3)
    assert type(number) is float
    assert number == 2


@pytest.mark.parametrize(
    "value", [True, np.True_, "2", None, [2.0], np.ones(1), 2j, np.ma.array(2.0), {}, 10**400]
)
def test_what_is_no_single_number_is_refused(value):
    with pytest.raises(
        ValueError, match=r"x must (be a single number|hold|lie within|be without a mask)"
    ):
        scalar("x", value)


@pytest.mark.parametrize(
    ("value", "bounds", "message"),
    [
        (0.0, {"above": 0}, "x must be positive, got 0"),
        (1.0, {"above": 1}, "x must be above 1, got 1"),
        (-1.0, {"least": 0}, "x must be zero or positive, got -1"),
        (1.5, {"least": 2}, "x must be at least 2, got 1.5"),
        (3.5, {"most": 3}, "x must be at most 3, got 3.5"),
        (1e-70, {"above": 0}, "x must be at least 1e-60"),
        (-1.0, {"above": 0, "least": 1e-5}, "x must be positive"),
        (1e-6, {"above": 0, "least": 1e-5}, "x must be at least 1e-05"),
        (np.nan, {}, "x must be finite, got nan"),
        (1e61, {}, r"x must lie within ±1e\+60, got 1e\+61"),
        (0.0, {"within": (0, 1)}, r"x must lie in \(0, 1\), got 0"),
        (1.0, {"within": (0, 1)}, r"x must lie in \(0, 1\), got 1"),
        (1.1, {"within": (0, 1), "closed": True}, r"x must lie in \[0, 1\], got 1.1"),
    ],
)
def test_a_number_out_of_bounds_is_refused(value, bounds, message):
    with pytest.raises(ValueError, match=message):
        scalar("x", value, **bounds)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_finite_numbers_that_leave_the_range_when_squared_are_refused(dtype):
    most = 1e60 if dtype == np.float64 else 1e18
    taken = np.array([most, -most], dtype) * dtype(0.99)
    np.testing.assert_array_equal(as_array("x", taken, dtype=dtype), taken)
    for wrong in (1.01, -1.01):
        with pytest.raises(ValueError, match="x must lie within ±"):
            as_array("x", np.array([1.0, wrong * most]), dtype=dtype)
    np.testing.assert_array_equal(as_array("x", [1.0, np.nan], finite=False), [1.0, np.nan])
    with pytest.raises(ValueError, match="x must be finite, got 1 NaN or infinite of 2"):
        as_array("x", [1.0, np.inf])
