"""Parallel processes: the results of a plain loop, no noise on the terminal, no orphans."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from compendium.experiments._processes import in_processes
from tests.running import alive

ROOT = Path(__file__).resolve().parents[2]


def test_results_come_in_the_order_of_the_arguments() -> None:
    each = [(a, 3) for a in range(20)]
    assert in_processes(divmod, each) == [divmod(*both) for both in each]


def test_arguments_are_taken_one_by_one_in_order() -> None:
    """A generator may draw random numbers between them."""
    rng, same = np.random.default_rng(0), np.random.default_rng(0)
    found = in_processes(float.hex, ((rng.random(),) for _ in range(9)))
    assert found == [same.random().hex() for _ in range(9)]


def test_a_failure_reaches_the_caller() -> None:
    with pytest.raises(ZeroDivisionError):
        in_processes(divmod, [(1, 1), (1, 0)])


SCRIPT = """
import os, sys, time
from compendium.experiments._processes import in_processes
if __name__ == "__main__":
    in_processes(os.write, [(1, b"on the terminal"), (2, b"on the terminal")])
    print(*set(in_processes(os.getpid, [()] * 8)), flush=True)
    time.sleep(float(sys.argv[1]))
"""


@pytest.mark.parametrize("killed", [False, True], ids=["ends", "is killed"])
def test_processes_are_silent_and_end_with_their_parent(tmp_path: Path, killed: bool) -> None:
    path = tmp_path / "script.py"
    path.write_text(SCRIPT)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [sys.executable, str(path), "60" if killed else "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    ) as parent:
        assert parent.stdout is not None
        assert parent.stderr is not None
        workers = [int(pid) for pid in parent.stdout.readline().split()]
        assert workers
        if killed:
            parent.send_signal(signal.SIGKILL)
        parent.wait()
        end = time.monotonic() + 20
        while any(map(alive, workers)) and time.monotonic() < end:
            time.sleep(0.05)
        assert not any(map(alive, workers))
        # Python's own watch over semaphores says that a killed parent left some.
        rest = [parent.stdout.read(), *parent.stderr.read().splitlines()]
        assert not any("on the terminal" in line or "Error" in line for line in rest)
        assert killed or not any(rest)
