"""Nothing outlives a killed run, and two runs in one tree do not work side by side."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from time import monotonic, sleep

import pytest

from tests.running import alive

ROOT = Path(__file__).resolve().parents[2]
HOLD = """
import sys
from pathlib import Path
from compendium.processes import alone_in
with alone_in(Path(sys.argv[1])):
    print("holds", flush=True)
    sys.stdin.read()
"""
# A parent with two workers, the first of which has a child that watches, too.
CHILD = r"""
import os, time
from compendium.processes import end_with_parent
end_with_parent()
os.write(1, b"%d\n" % os.getpid())
time.sleep(60)
"""
FAMILY = r"""
import os, subprocess, sys
from concurrent.futures import ProcessPoolExecutor
from time import sleep
from compendium.processes import end_with_parent

def work(child):
    os.write(1, b"%d\n" % os.getpid())
    if child:
        subprocess.run([sys.executable, "-c", sys.argv[1]])
    sleep(60)

with ProcessPoolExecutor(2, initializer=end_with_parent) as pool:
    list(pool.map(work, [True, False]))
"""


def start(code: str, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_no_worker_outlives_its_parent(how: signal.Signals) -> None:
    parent = start(FAMILY, CHILD)
    assert parent.stdout
    family = [int(parent.stdout.readline()) for _ in range(3)]
    assert all(alive(pid) for pid in family)
    parent.send_signal(how)
    parent.wait()
    begun = monotonic()
    while any(alive(pid) for pid in family) and monotonic() - begun < 10:
        sleep(0.05)
    left = [pid for pid in family if alive(pid)]
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    assert not left
    parent.communicate()


MADE = """
import time
from compendium.processes import end_with_make
print("begins", flush=True)
end_with_make()
time.sleep(float(__import__("sys").argv[1]))
print("ends")
"""


@pytest.mark.parametrize("when", ["before", "while"])
def test_nothing_outlives_make(when: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not even what had hardly begun when make was killed, whose parent is another one by then."""
    maker = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    monkeypatch.setenv("MAKE_PID", str(maker.pid))
    if when == "before":
        maker.kill()
        maker.wait()
    made = start(MADE, "30")
    assert made.stdout
    assert made.stdout.readline() == "begins\n"
    maker.kill()
    maker.wait()
    assert made.communicate(timeout=10)[0] == ""
    assert made.returncode == 1


def test_what_make_began_goes_on_while_make_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAKE_PID", str(os.getpid()))
    assert start(MADE, "0.5").communicate()[0] == "begins\nends\n"


def test_a_second_run_waits_and_says_so(tmp_path: Path) -> None:
    first = start(HOLD, str(tmp_path))
    assert first.stdout
    assert first.stdout.readline() == "holds\n"
    second = start(HOLD, str(tmp_path))
    assert second.stderr
    assert second.stdout
    line = second.stderr.readline()
    assert line == f"Another run is at work in {tmp_path}; this one waits until it has ended.\n"
    first.kill()  # the system gives the folder free, whatever ended the holder
    assert second.stdout.readline() == "holds\n"
    first.communicate()
    _, errors = second.communicate("")
    assert second.returncode == 0
    assert errors == ""
