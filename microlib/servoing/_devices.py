"""The interface of a controlled microscope, and how its stage is stopped.

The simulated workstation and the adapter for Micro-Manager have these attributes. Another
microscope needs three small classes with these methods, and no base class:

=================  ===============================================================================
``camera``         ``snap()`` returns a grey frame and the middle of its exposure, s of the clock
``stage``          ``position()`` returns the position by the encoder, µm, one number per axis;
                   ``move_to(position)`` starts towards a position and returns at once;
                   ``moving()`` returns whether a move is under way; ``stop()`` ends it at once
``clock``          ``now()`` returns the time, s from any origin; ``sleep(seconds)`` waits
=================  ===============================================================================
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread
from typing import Any

#: Time between two polls of a moving stage, s: moves of some milliseconds are common.
POLL = 0.002

#: Methods that a run calls.
CALLS = (
    *("camera.snap", "stage.position", "stage.move_to", "stage.moving", "stage.stop"),
    *("clock.now", "clock.sleep"),
)


def check_devices(workstation: object) -> None:
    """Raise if a part of the workstation lacks a method that a run calls."""
    for call in CALLS:
        part, method = call.split(".")
        if not callable(getattr(getattr(workstation, part, None), method, None)):
            got = type(workstation).__name__
            raise ValueError(f"workstation must have {call}(), got {got}")


class EndRun(Exception):
    """The run ends for the reason that is its message."""


def wait_until_still(
    workstation: Any, timeout: float, watch: Callable[[], object] = lambda: None
) -> None:
    """Wait until the stage stands, and call `watch` repeatedly meanwhile."""
    clock = workstation.clock
    end = clock.now() + timeout
    while workstation.stage.moving():
        if clock.now() > end:
            raise EndRun(f"the stage still moves after {timeout:g} s")
        watch()
        clock.sleep(POLL)


def stop_stage(workstation: Any, timeout: float) -> str:
    """Stop the stage; return why it may still move, or an empty text."""
    trouble = ""
    for _ in range(3):  # a driver can be busy with the call before
        try:
            workstation.stage.stop()
            wait_until_still(workstation, timeout)
            return ""
        except Exception as error:
            trouble = f"the stage may not stand still: {error}"
    return trouble


@contextmanager
def ignored_interrupts() -> Iterator[None]:
    """Ignore Ctrl-C, which only the main thread receives."""
    if current_thread() is not main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before or signal.SIG_DFL)
