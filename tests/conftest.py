"""Where the tests find what `make html` built; property tests draw the same examples each time."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).resolve().parent.parent

# The same commit gives the same verdict twice; --hypothesis-profile=default looks for more.
settings.register_profile("same", derandomize=True)
settings.load_profile("same")


def built(path: Path) -> Path:
    if not path.exists():
        pytest.fail(
            f"{path.relative_to(ROOT)} is missing; run `make html` first, as `make test` does"
        )
    return path


@pytest.fixture(scope="session")
def root() -> Path:
    return ROOT


@pytest.fixture(scope="session")
def claims_folder() -> Path:
    return built(ROOT / "build" / "claims")


@pytest.fixture(scope="session")
def html() -> Path:
    return built(ROOT / "build" / "html").resolve()
