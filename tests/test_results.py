"""Every public callable works on a valid call and returns what it returned before.

A text that differs says which number. It holds what is, not what is right: if a result was to
change, write the texts anew (``make results``) and say in the commit why.
"""

from __future__ import annotations

import pytest

from tests import fuzz, results
from tests.snapshots import describe_data, others_than_locked

OTHERS = others_than_locked(*results.PACKAGES)


@pytest.mark.parametrize("name", [name for name in fuzz.CALLS if name not in fuzz.SLOW])
def test_a_valid_call_works_as_before(name: str) -> None:
    if extra := fuzz.EXTRAS.get(name):
        pytest.importorskip(extra, reason=f"{extra} is not installed")
    result, wrong = fuzz.answer(name, {})
    assert wrong is None
    assert result is not fuzz.REFUSED
    if name in results.names() and not OTHERS:
        # What returns nothing writes a file, or changes its object.
        lines = [] if result is None else describe_data(result, "returns")
        check(name, "\n".join(lines) if lines else results.told(name))


@pytest.mark.skipif(bool(OTHERS), reason="other packages round or draw noise otherwise")
@pytest.mark.parametrize("name", [name for name in results.names() if "-" in name])
def test_other_arguments_give_what_they_gave(name: str) -> None:
    check(name, results.told(name))


def check(name: str, text: str) -> None:
    if lines := results.differences(name, results.kept(results.FOLDER, name), text):
        pytest.fail("\n".join([*lines, "", "`make results` writes it anew"]), pytrace=False)


def test_every_text_is_of_a_call() -> None:
    kept = [name for path in results.FOLDER.glob("*.txt") for name in results.sections(path)]
    assert sorted(kept) == results.names()
