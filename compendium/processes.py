"""Processes that end with the one that began them, and runs that do not work side by side."""

from __future__ import annotations

import fcntl
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import sleep

from microlib._common import end_with_starter

__all__ = ["alone_in", "end_with_make", "end_with_parent"]

#: Between looks at the parent, s: short beside what a person notices.
_PAUSE = 0.2


def end_with_make() -> None:
    """End this process as soon as the make that began it has ended: killed, make ends nothing.

    The Makefile says which it is. Whose parent this process is does not: it may be a shell between
    them, and another process altogether if make ended while this one was starting.
    """
    maker = os.environ.get("MAKE_PID")
    if maker:
        _end_unless(lambda: _is_alive(int(maker)))


def end_with_parent() -> None:
    """End this process as soon as its parent has ended, even if that was killed."""
    parent = os.getppid()
    if not end_with_starter():
        _end_unless(lambda: os.getppid() == parent)


def _end_unless(goes_on: Callable[[], bool]) -> None:
    def watch() -> None:
        while goes_on():
            sleep(_PAUSE)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold a folder while the block runs; wait, and say so, while another process holds it.

    Parameters
    ----------
    folder : pathlib.Path
        Made if it is missing. The system gives it free when its holder ends, however it ends.
    """
    folder.mkdir(parents=True, exist_ok=True)
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            text = f"Another run is at work in {folder}; this one waits until it has ended."
            print(text, file=sys.stderr, flush=True)
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
