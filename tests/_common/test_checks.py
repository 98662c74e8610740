"""Argument checks: valid values are returned; an error names argument, requirement and value."""

import pickle

import numpy as np
import pytest

from microlib import _common as check


def test_valid_values_are_returned():
    array = np.arange(6.0).reshape(2, 3)
    assert check.as_array("x", array, shape=(None, 3)) is array
    assert np.isnan(check.as_array("x", [1.0, np.nan], finite=False)[1])
    assert check.as_image("x", np.zeros((3, 4), np.uint8), smallest=3).dtype == np.float32
    assert check.as_integer("x", np.int64(3), least=3, odd=True, most=3) == 3
    # NumPy's generator of the same seed draws the same; zero is a seed.
    assert check.as_generator("x", 0).random() == np.random.default_rng(0).random()
    assert check.as_region("x", range(1, 5), (6, 4)) == (1, 2, 3, 4)
    assert check.as_image_shape("x", [6, np.int64(4)]) == (6, 4)
    for value in (2, 2.0, np.float32(2), np.uint8(2), np.array(2.0)):
        assert type(check.as_scalar("x", value, above=0, least=2, most=2)) is float
    # Of electron microscopes, macro lenses, small and large sensors.
    for name, ends in {"pixel_size": [0.03, 500.0], "pixel_pitch": [0.7, 75.0]}.items():
        assert [check.as_physical(name, value) for value in ends] == ends


@pytest.mark.parametrize(
    ("name", "given", "options", "message"),
    [
        ("as_array", ["ab"], {}, "x must hold real numbers, got str"),
        ("as_positive", [True], {}, "x must hold real numbers, got bool"),
        ("as_array", [np.True_], {}, "x must hold real numbers, got bool"),
        ("as_array", [[1.0]], {"shape": (None, 2)}, r"x must have shape \(any, 2\), got \(1,\)"),
        ("as_array", [np.zeros((0, 2))], {}, r"x must not be empty, got shape \(0, 2\)"),
        ("as_array", [[1, np.nan, np.inf]], {}, "x must be finite, got 2 NaN or infinite of 3"),
        ("as_array", [(np.ma.array([1.0]),)], {}, "x must be without a mask"),
        ("as_array", [[0.5, 1.0]], {"above": 0, "below": 1}, "x must be below 1, got 1"),
        ("as_array", [[1.5, -0.5]], {"least": -1, "most": 1}, "x must be at most 1, got 1.5"),
        ("as_image", [np.zeros((2, 2, 3))], {}, "x must be a grey image .* got 3"),
        ("as_image", [np.zeros((9, 3))], {"smallest": 4}, r"x must be at least 4 px .*\(9, 3\)"),
        ("as_positive", [[1.0, 0.0]], {}, "x must be positive, got 0"),
        ("as_array", [-1.0], {"least": 0}, "x must be zero or positive, got -1"),
        ("as_integer", [2.0], {"least": 1}, r"x must be a whole number, got 2\.0"),
        ("as_integer", [True], {"least": 1}, "x must be a whole number, got True"),
        ("as_integer", [4], {"least": 3, "odd": True}, "x must be odd, got 4"),
        ("as_generator", [-1], {}, "x must be zero or positive, got -1"),
        ("as_image_shape", [(0, 4)], {}, "x must be at least 1, got 0"),
        ("as_region", [(0, 0, 4, 3)], {"least": 4}, "x height must be at least 4, got 3"),
        ("as_choice", ["c", ("a", "b")], {}, "x must be one of a, b, got 'c'"),
        ("as_tuple", ["ab", 2], {}, "x must be 2 numbers, got 'ab'"),
        ("as_tuple", [np.ma.array([1, 2]), 2], {}, "x must be without a mask"),
        ("as_scalar", [1.0], {"above": 1}, "x must be above 1, got 1"),
        ("as_scalar", [1e-6], {"above": 0, "least": 1e-5}, "x must be at least 1e-05"),
        ("as_scalar", [np.nan], {}, "x must be finite, got nan"),
        *(("as_scalar", [value], {}, "x must be a single number") for value in (True, "2", [2.0])),
        *(("as_scalar", [value], {}, "x must hold real numbers") for value in (None, 2j, {})),
    ],
)
def test_error_states_requirement_and_value(name, given, options, message):
    with pytest.raises(ValueError, match=message):
        getattr(check, name)("x", *given, **options)


def test_error_names_both_arrays_of_different_lengths():
    with pytest.raises(ValueError, match=r"x and y .* got 2 and 3"):
        check.check_same_length(("x", "y"), np.zeros(2), np.zeros(3))


def test_pickled_error_keeps_the_name_of_its_argument():
    with pytest.raises(check.ArgumentError, match=r"^box width must be a whole number") as caught:
        check.as_region("box", (0, 0, 2.5, 3))
    again = pickle.loads(pickle.dumps(caught.value))
    assert (again.argument, str(again)) == ("box width", str(caught.value))
