"""Every constant and default of the experiments has the value that was written down."""

from __future__ import annotations

import pytest

from tests.constants import changes, modules

MODULES = [name for name in modules("compendium") if "experiments" in name]


@pytest.mark.parametrize("module", MODULES)
def test_constants_and_defaults_are_those_that_were_written(module: str) -> None:
    assert not (lines := changes(module)), "\n".join(lines)
