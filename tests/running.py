"""Whether other processes are there, and waiting for what they do: for tests of what ends."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from time import monotonic, sleep


def alive(pid: int) -> bool:
    """Return whether a process goes on; one that ended and that nobody waits for does not."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat")
    return (
        not state.exists() or state.read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
    )


def until(happened: Callable[[], object]) -> None:
    """Wait for what happens soon; the limit is for a busy machine."""
    end = monotonic() + 120
    while not happened():
        assert monotonic() < end
        sleep(0.02)
