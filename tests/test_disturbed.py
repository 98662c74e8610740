"""Inputs that differ by one part in 10¹⁵ lead to the same conclusions: rounding decides nothing.

Another processor rounds otherwise, by about as much. Every callable of the library is given its
valid call of `tests/fuzz.py`, and again with each number moved to a neighboring one.
"""

import numpy as np
import pytest

from tests import fuzz
from tests.laws import unlike

#: What draws or stores, and so concludes nothing; and what takes minutes.
LEFT_OUT = ("synthetic.", "io.", "embryo.read_outline")
NAMES = [name for name in fuzz.names() if not name.startswith(LEFT_OUT)]
#: What is exact: names, counts of pixels, ν = 0.5 of what keeps its volume; a device's own state.
WHOLE = {"self", "labels", "radius", "poisson_ratio"}
#: Two results are the same within this, of the largest number beside it: far above 10¹⁵ times a
#: condition number of 10⁸, far below what any result here can tell.
RELATIVE = 1e-6
#: Of the pixels of a map so many may lie at a threshold, where either side is right.
UNDECIDED = 0.002


def moved(value: object, rng: np.random.Generator) -> object:
    """Return a value with each number that is not whole moved to one of its neighbors."""
    if isinstance(value, dict):
        return {key: moved(each, rng) for key, each in value.items()}
    if isinstance(value, float):
        return float(np.nextafter(value, 0.0))  # ν = 0.5 has no neighbor above
    if not isinstance(value, np.ndarray) or value.dtype != np.float64:
        return value
    there = np.where(rng.random(value.shape) < 0.5, -np.inf, np.inf)
    return np.where(value == 0, value, np.nextafter(value, there))


def floats(value: object) -> object:
    """Return images as floats, so that only the last bits differ from those that are moved."""
    image = isinstance(value, np.ndarray) and value.dtype == np.uint8 and value.ndim > 1
    return np.asarray(value, np.float64) if image else value


@pytest.mark.parametrize("name", NAMES)
def test_changing_last_bit_of_inputs_changes_no_conclusion(name):
    rng = np.random.default_rng(0)
    given = {key: floats(v) for key, v in fuzz.valid_call(name).items() if key not in WHOLE}
    near = {key: moved(value, rng) for key, value in given.items()}
    # Devices have a state: each call is given its own.
    changed = [key for key, value in near.items() if value is not given[key]]
    expected, wrong = fuzz.answer(name, {key: given[key] for key in changed})
    assert wrong is None
    found, wrong = fuzz.answer(name, {key: near[key] for key in changed})
    assert wrong is None
    assert isinstance(found, fuzz.Refused) == isinstance(expected, fuzz.Refused)
    assert not [*unlike(expected, found, within=RELATIVE, undecided=UNDECIDED)]
