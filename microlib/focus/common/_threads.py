"""Work that the threads of a pool may share."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

#: Applies a function to each of some items, as `map` does, perhaps in several threads.
Spread = Callable[..., Iterable[Any]]


def run_jobs(spread: Spread, *jobs: Callable[[], Any]) -> list[Any]:
    """Return the results of functions that do not depend on each other."""
    return list(spread(lambda job: job(), jobs))
