"""Every constant and default of the library has the value that was written down.

If one is to change, write them anew (``make results``) and say in the commit why: a number of an
algorithm is derived, measured or documented, and what was measured with it has to run again.
"""

from __future__ import annotations

import pytest

from tests.constants import FOLDER, changes, modules
from tests.results import sections


@pytest.mark.parametrize("module", modules("microlib"), ids=lambda name: f"{name}.")
def test_constants_and_defaults_are_those_that_were_written(module: str) -> None:
    assert not (lines := changes(module)), "\n".join(lines)


def test_every_text_is_of_a_module() -> None:
    known = [name for path in FOLDER.glob("*.txt") for name in sections(path)]
    assert set(known) <= {*modules("microlib"), *modules("compendium")}
    assert len(known) > 100
