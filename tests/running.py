"""What other processes do, whether they are there, and waiting: for tests of what ends.

Processes import this file, which is quick.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from time import monotonic, sleep

#: Each process may use one thread, unless the user says how many.
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")


def measure(path: Path, *, factor: float = 1.0, log: Path | None = None) -> dict[str, object]:
    """Read a number; fail, die or wait where the file says so."""
    with open(log or os.devnull, "a", errors="surrogateescape") as file:
        file.write(f"{path.name}\n")
    text = path.read_text()
    if text == "die":
        os._exit(3)
    if text.startswith("wait"):
        sleep(0.15)
        text = text[4:]
    value = float(text)
    threads = "-".join(os.environ.get(name, "") for name in THREADS)
    about = {"pid": os.getpid(), "threads": threads}
    return {"value": factor * value, "odd": value % 2 == 1, **about}


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
