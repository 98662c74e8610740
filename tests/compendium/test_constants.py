"""Every constant and default of the rest of the compendium has the value that was written down."""

from __future__ import annotations

import pytest

from tests.constants import changes, modules

MODULES = [name for name in modules("compendium") if "experiments" not in name]


@pytest.mark.parametrize("module", MODULES)
def test_constants_and_defaults_are_those_that_were_written(module: str) -> None:
    assert not (lines := changes(module)), "\n".join(lines)
