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
    is_in_memory,
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
    assert as_array("x", [True, False]).tolist() == [1.0, 0.0]
    assert np.isnan(as_array("x", [np.nan], finite=False)).all()
    assert as_image("x", np.zeros((3, 4), np.uint8), smallest=3).dtype == np.float32
    assert as_image("x", [[7.0]]).shape == (1, 1)
    assert between("x", [0.0, 1.0], 0, 1, closed=True).tolist() == [0.0, 1.0]
    assert positive("x", [0.0, 2.0], zero=True).tolist() == [0.0, 2.0]
    assert whole("x", np.int64(3), least=3, odd=True) == 3
    assert one_of("x", "b", ("a", "b")) == "b"
    same_length(("x", "y"), np.zeros((2, 3)), np.zeros(2))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: as_array("x", "ab"), "x must hold real numbers, got str"),
        (lambda: as_array("x", np.array([1j])), "x must hold real numbers, got complex128"),
        (lambda: as_array("x", [[1.0], [1.0, 2.0]]), "x must hold real numbers, got list"),
        (
            lambda: as_array("x", [1.0], shape=(None, 2)),
            r"x must have shape \(any, 2\), got \(1,\)",
        ),
        (lambda: as_array("x", np.zeros((2, 3)), shape=(2, 2)), r"\(2, 2\), got \(2, 3\)"),
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
        (lambda: between("x", [0.5, 0.0], 0, 1), r"x must lie in \(0, 1\), got 0"),
        (lambda: between("x", 1.5, 0, 1, closed=True), r"x must lie in \[0, 1\], got 1.5"),
        (lambda: between("x", -0.5, 0, 1, closed=True), r"x must lie in \[0, 1\], got -0.5"),
        (lambda: positive("x", [1.0, 0.0]), "x must be positive, got 0"),
        (lambda: positive("x", -1.0, zero=True), "x must be zero or positive, got -1"),
        (lambda: whole("x", 2.0, least=1), r"x must be a whole number, got 2\.0"),
        (lambda: whole("x", True, least=1), "x must be a whole number, got True"),
        (lambda: whole("x", 2, least=3), "x must be a whole number of at least 3, got 2"),
        (lambda: whole("x", 4, least=3, odd=True), "an odd whole number of at least 3, got 4"),
        (lambda: one_of("x", "c", ("a", "b")), "x must be one of a, b, got 'c'"),
        (lambda: one_of("x", 1, ("a", "b")), "x must be one of a, b, got 1"),
        (lambda: same_length(("x", "y"), np.zeros(2), np.zeros(3)), "x and y .* got 2 and 3"),
        (lambda: same_length(("x", "y"), np.zeros(3), np.zeros(2)), "x and y .* got 3 and 2"),
        (lambda: as_image("x", np.full((2, 2), 2e10)), r"x must lie within ±1e\+10, got 2e\+10"),
        (
            lambda: as_image("x", np.zeros((3, 9)), smallest=4),
            r"x must be at least 4 px .*\(3, 9\)",
        ),
        (lambda: positive("x", [1.0, 1e-70]), "x must be at least 1e-60, got 1e-70"),
        (lambda: positive("x", [1.0, -3.0], zero=True), "x must be zero or positive, got -3"),
        (lambda: refuse_masks("x", np.ma.array([1.0])), "x must be without a mask"),
        (lambda: refuse_masks("x", [0, np.ma.array([1.0])]), "x must be without a mask"),
        (lambda: as_array("x", (np.ma.array([1.0]),)), "x must be without a mask"),
        (lambda: of_kind("x", 3, str, bytes), "x must be of the kind str or bytes, got int"),
        (lambda: flag("x", 1), "x must be True or False, got 1"),
        (lambda: flag("x", None), "x must be True or False, got None"),
        (lambda: generator("x", -1), "x must be a numpy.random.Generator or a seed .* got -1"),
        (lambda: generator("x", True), "x must be a numpy.random.Generator .* got True"),
        (lambda: generator("x", 1.0), r"x must be a numpy.random.Generator .* got 1\.0"),
        (lambda: items("x", "ab", 2), "x must be 2 numbers, got 'ab'"),
        (lambda: items("x", b"ab", 2), "x must be 2 numbers, got b'ab'"),
        (lambda: items("x", np.ma.array([1, 2]), 2), "x must be 2 numbers, got masked"),
        (lambda: items("x", {1, 2}, 2), "x must be 2 numbers, got {1, 2}"),
        (lambda: items("x", np.zeros((2, 2)), 2), "x must be 2 numbers, got array"),
        (lambda: items("x", [1], 2), "x must be 2 numbers, got 1"),
        (lambda: items("x", [1, 2, 3], 2), "x must be 2 numbers, got 3"),
        (lambda: image_shape("x", (3, 4, 5)), "x must be 2 numbers, got 3"),
        (lambda: image_shape("x", (0, 4)), "x must be a whole number of at least 1, got 0"),
        (lambda: image_shape("x", (4, 0)), "x must be a whole number of at least 1, got 0"),
        (lambda: image_shape("x", (5, 4), least=5), "x must be a whole number of at least 5"),
        (lambda: image_shape("x", (65537, 1)), "x must be at most 65536 px a side .* got 65537×1"),
        (lambda: image_shape("x", (1, 65537)), "x must be at most 65536 px a side .* got 1×65537"),
        (lambda: image_shape("x", (16385, 16384)), "and 268435456 px in all, got 16385×16384"),
    ],
)
def test_a_refusal_says_what_is_wrong(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_what_is_right_passes_the_other_checks():
    assert flag("x", np.False_) is False
    assert flag("x", True) is True
    rng = np.random.default_rng(7)
    assert generator("x", rng) is rng
    # NumPy's generator of the same seed draws the same; zero is a seed.
    for seed in (0, np.int64(3)):
        assert generator("x", seed).random() == np.random.default_rng(int(seed)).random()
    assert items("x", [1, "a"], 2) == (1, "a")
    assert items("x", np.arange(3), 3) == (0, 1, 2)
    assert items("x", range(2), 2) == (0, 1)
    assert image_shape("x", [3, np.int64(4)]) == (3, 4)
    assert image_shape("x", (1, 1)) == (1, 1)
    assert image_shape("x", (16384, 16384)) == (16384, 16384)
    assert image_shape("x", (65536, 4096)) == (65536, 4096)
    of_kind("x", "a", str, bytes)
    of_kind("x", b"a", str, bytes)
    refuse_masks("x", [np.ones(2), 3, None])
    assert whole("x", 4, least=1) == 4
    assert whole("x", (1 << 31), least=0) == 1 << 31


def test_what_came_is_told_in_80_characters():
    with pytest.raises(ValueError, match=r"got 'a{79}$"):
        flag("x", "a" * 1000)
    with pytest.raises(ValueError, match=r"got a huge number$"):
        flag("x", 10**5000)


def test_counts_end_at_31_bits():
    with pytest.raises(ValueError, match="x must be at most 2147483648, got a larger one"):
        whole("x", (1 << 31) + 1, least=0)


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2), np.uint8(2), np.array(2.0)])
def test_a_single_number_becomes_a_float(value):
    number = scalar("x", value, above=0, most=3)
    assert type(number) is float
    assert number == 2


@pytest.mark.parametrize(
    "value", [True, np.True_, "2", None, [2.0], np.ones(1), 2j, np.ma.array(2.0), {}, 10**400]
)
def test_what_is_no_single_number_is_refused(value):
    with pytest.raises(ValueError, match=r"x must (be a single number|hold|lie within)"):
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


def test_bounds_themselves_are_taken():
    assert scalar("x", 1.0, within=(0, 1), closed=True) == 1
    assert scalar("x", 0, least=0) == 0
    assert scalar("x", 3, most=3) == 3
    assert whole("x", 5, least=1, most=5) == 5


def test_large_counts_are_refused():
    for wrong in (6, 10**400):
        with pytest.raises(ValueError, match="x must be at most 5"):
            whole("x", wrong, least=1, most=5)


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


@pytest.mark.parametrize("closed", [False, True])
def test_a_value_on_either_side_of_an_interval_is_refused(closed):
    for wrong in (-0.5, 1.5, -1e50, [0.5, -0.5], [0.5, 1.5]):
        with pytest.raises(ValueError, match=r"x must lie in"):
            between("x", wrong, 0.0, 1.0, closed=closed)
    for end in (0.0, 1.0):
        if closed:
            assert between("x", end, 0.0, 1.0, closed=True) == end
        else:
            with pytest.raises(ValueError, match=r"x must lie in"):
                between("x", end, 0.0, 1.0)


def test_only_an_array_whose_frames_are_views_is_in_memory():
    frames = np.zeros((3, 4, 5), np.uint8)
    assert is_in_memory(frames)
    assert not is_in_memory(list(frames))
    assert not is_in_memory(iter(frames))
    assert not is_in_memory(frames.astype(float))
    assert not is_in_memory(frames[:, ::2])
