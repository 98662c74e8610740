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
from collections.abc import Callable
from threading import current_thread, main_thread
from types import FrameType
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


class InterruptGate:
    """Passes Ctrl-C on to the handler that was there before while `is_open`, and ignores it else.

    A run may be interrupted, and the stop of the stage that follows may not. The gate exists during
    both, so that there is no moment in between at which Ctrl-C leaves the stage moving.
    """

    def __init__(self) -> None:
        self.is_open = False

    def __enter__(self) -> InterruptGate:
        handler = signal.getsignal(signal.SIGINT)
        # Python calls handlers in the main thread only. One that is no Python function could not be
        # restored.
        replaced = callable(handler) and current_thread() is main_thread()
        self._handler: Any = handler if replaced else None
        if replaced:
            signal.signal(signal.SIGINT, self._receive)
        return self

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if self.is_open:
            self._handler(number, frame)

    def __exit__(self, *error: object) -> None:
        if self._handler is not None:
            signal.signal(signal.SIGINT, self._handler)
