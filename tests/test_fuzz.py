"""A sample of the hostile calls of `tests/fuzz.py`; `make fuzz` makes all of them."""

from __future__ import annotations

import random
import time
import warnings

from tests import fuzz

#: Callables that need tenths of a second for one valid call: `make fuzz` has them.
SLOW = (
    "calibration.",
    "embryo.extract",
    "embryo.fit",
    "embryo.force",
    "embryo.measure",
    "embryo.modulus",
    "focus.depth",
    "focus.FocusResult",
    "synthetic.",
    "tracking.ESM",
    "optics.BlurLadder",
)
#: Calls of the sample for each callable, and the time that it may take in all, s.
SHARE, BUDGET = 12, 15.0


def test_the_table_has_every_public_callable_and_argument() -> None:
    assert set(fuzz.CALLS) == set(fuzz.public())
    assert not any(word in fuzz.CALLS for word in fuzz.NOT_CALLED)


def test_the_known_faults_do_not_grow() -> None:
    assert len(fuzz.KNOWN) <= fuzz.MOST_KNOWN


def test_hostile_values_are_refused_by_name() -> None:
    begin, found = time.monotonic(), []
    names = [name for name in fuzz.CALLS if not name.startswith(SLOW)]
    for name in names:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            drawn = list(fuzz.cases(name))
        drawn = random.Random(name).sample(drawn, min(SHARE, len(drawn)))
        for case in drawn:
            if time.monotonic() - begin > BUDGET:
                break
            if case.key in fuzz.KNOWN:
                continue
            if said := fuzz.fault(case):
                found.append(f"{case.key}: {said}")
    assert not found, "\n".join(found)
