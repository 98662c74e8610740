"""Where the tests find what `make html` built."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


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
