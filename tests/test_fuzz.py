"""A sample of the hostile calls of `tests/fuzz.py`; `make fuzz` makes all of them."""

from __future__ import annotations

import random

import pytest

from tests import fuzz
from tests.laws import public

#: One case in so many runs here, and at least so many of every callable.
ONE_IN, LEAST = 20, 6
QUICK = [name for name in fuzz.names() if name not in fuzz.SLOW]


def test_every_public_callable_is_called():
    """What has no valid call in its room's table needs one in `CALLS`; every argument is tried."""
    assert set(public()) <= set(fuzz.names())
    assert set(fuzz.names()) >= fuzz.MAY_BE_UNKNOWN
    for name in fuzz.names():
        # An observer is called, not checked; further properties are those of the class.
        left = set(fuzz.parameters(name, {})) - {"self", "cls", "observer", "properties"}
        assert left <= fuzz.valid_call(name).keys(), name


@pytest.mark.parametrize("name", QUICK)
def test_hostile_values_are_refused_by_name(name):
    every = [*fuzz.cases(name), *fuzz.pairs(name, fuzz.PAIRS)]
    drawn = random.Random(name).sample(every, min(len(every), max(LEAST, len(every) // ONE_IN)))
    found = [f"{case.key}: {said}" for case in drawn if (said := fuzz.fault(case))]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("name", ["tracking.ESMTracker.track", "servoing.simulate"])
def test_numbers_in_another_form_give_the_same(name):
    assert not list(fuzz.differences(name))
