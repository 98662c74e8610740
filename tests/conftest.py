"""Where the tests find what `make html` built; what each test leaves as it was."""

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
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


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    """Close what a test drew: with more than 20 figures open, Matplotlib warns the next test."""
    yield
    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")


def process_state() -> dict[str, object]:
    """Return what a call must leave as it was, also after an error and after Ctrl-C."""
    style = sys.modules.get("matplotlib")
    # What OpenCV, Micro-Manager and our own command set as they are loaded is no fault.
    loading = ("PYTEST_", "KMP_", "OPENCV_", "LD_LIBRARY_PATH", "PATH", "MICROMANAGER")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(loading)}
    return {
        "handlers of signals": {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)},
        "style of Matplotlib": dict(style.rcParams) if style else None,
        "environment": environment,
        "folder": Path.cwd(),
        "floating-point errors": np.geterr(),
    }


@pytest.fixture(autouse=True)
def _process_is_as_before(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail if a test of the library, and thus a call in it, changed the state of the process."""
    before = process_state()
    yield
    if request.path.parent.name in ("compendium", "notebooks", "book"):
        return  # notebooks set the style of their figures
    after = process_state()
    changed = [name for name, value in before.items() if value not in (None, after[name])]
    assert not changed, f"the test changed {changed}, from {before} to {after}"


@pytest.fixture(scope="session")
def claims_folder() -> Path:
    return built(ROOT / "build" / "claims")


@pytest.fixture(scope="session")
def html() -> Path:
    return built(ROOT / "build" / "html").resolve()
