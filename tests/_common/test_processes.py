"""A worker ends with what began it, however that ended."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from multiprocessing.connection import Connection

import pytest

from microlib._common import end_with_starter
from tests.running import alive


def worker(tell: Connection) -> None:
    end_with_starter()
    tell.send(os.getpid())
    time.sleep(60)


def starter(tell: Connection) -> None:
    multiprocessing.get_context("spawn").Process(target=worker, args=(tell,)).start()
    time.sleep(60)


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_a_worker_ends_with_its_killed_starter() -> None:
    spawn = multiprocessing.get_context("spawn")
    hear, tell = spawn.Pipe(duplex=False)
    first = spawn.Process(target=starter, args=(tell,))
    first.start()
    assert hear.poll(30)
    pid = hear.recv()
    assert alive(pid)
    os.kill(first.pid, signal.SIGKILL)
    first.join()
    # At once; the limit is for a busy machine.
    end = time.monotonic() + 20
    while alive(pid) and time.monotonic() < end:
        time.sleep(0.02)
    assert not alive(pid)
