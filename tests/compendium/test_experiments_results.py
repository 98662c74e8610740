"""Every experiment finds on a small input what it found before.

A text that differs says which number. It holds what is, not what is right: if a result was to
change, write the texts anew (``make results``) and say in the commit why.
"""

from __future__ import annotations

import pytest

from tests import results
from tests.compendium.experiment_cases import CASES, FOLDER, told
from tests.snapshots import others_than_locked

OTHERS = others_than_locked(*results.PACKAGES)


@pytest.mark.skipif(bool(OTHERS), reason="other packages round or draw noise otherwise")
@pytest.mark.parametrize("name", CASES)
def test_an_experiment_finds_what_it_found(name: str) -> None:
    if lines := results.differences(name, results.kept(FOLDER, name), told(name)):
        pytest.fail("\n".join([*lines, "", "`make results` writes it anew"]), pytrace=False)


def test_every_text_is_of_an_experiment() -> None:
    kept = [name for path in FOLDER.glob("*.txt") for name in results.sections(path)]
    assert sorted(kept) == sorted(CASES)
