"""The interface of a controlled microscope, and calls to it that always stop the stage at the end.

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
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from threading import Event, Thread, current_thread, main_thread
from typing import Any

#: Time between two polls (for an answer, the end of a move or an interrupt), s: about the latency
#: of a serial line, and short compared with a person's reaction.
POLL = 0.02

#: Time after Ctrl-C in which another one is ignored, s: the key may be pressed twice.
DEBOUNCE = 0.3


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


class DeviceError(EndRun):
    """A device raised, or did not answer in time."""


class RunInterrupt(KeyboardInterrupt):
    """Ctrl-C, raised when the stage was stopped; `run` is the result until then."""

    def __init__(self, run: Any) -> None:
        super().__init__(run.reason)
        self.run = run


@dataclass(frozen=True, eq=False)
class Ending:
    """How a run over a device ended.

    Attributes
    ----------
    reason : str
        The return value of the work, or why it ended early.
    complete : bool
        Whether the work returned and the device stands still.
    still : bool
        Whether the device reported, after the stop, that it does not move.
    error : Exception or None
        The exception behind `reason`, if there is one.
    """

    reason: str
    complete: bool
    still: bool
    error: BaseException | None


class Guard:
    """Calls devices in separate threads, so that a device that hangs cannot block the loop.

    A thread cannot be ended from outside. After a timeout its thread stops the stage as soon as the
    call returns, because the call may have started a move.

    Parameters
    ----------
    clock, stage : object
        Of the workstation.
    timeout : float
        Longest time that a call or a move may take, s.
    """

    def __init__(self, clock: Any, stage: Any, timeout: float) -> None:
        self.interrupted = Event()
        self._clock, self._stage, self._timeout = clock, stage, timeout
        self._ending = False

    def run(self, work: Callable[[], str]) -> Ending:
        """Do the work, stop the stage in any case, and return how the work ended.

        An exception of the device or of the work becomes the reason of the end. Ctrl-C, under
        `interrupts`, sets `interrupted`, which is checked at the next call.
        """
        reason, complete, error = "", False, None
        try:
            reason, complete = work(), True
        except EndRun as end:
            reason, error = str(end), end.__cause__
        except Exception as fault:  # of a tracker, a controller or `progress`
            reason, error = f"{type(fault).__name__}: {fault}", fault
        finally:
            trouble = self._halt()
        if self.interrupted.is_set() and complete:
            reason, complete = "interrupted by the user", False
        if trouble:
            trouble = f"the stage may not stand still: {trouble}"
            reason, complete = "; ".join(filter(None, (reason, trouble))), False
        return Ending(reason, complete, not trouble, error)

    def check(self) -> None:
        """End the run after an interrupt."""
        if self.interrupted.is_set() and not self._ending:
            raise EndRun("interrupted by the user")

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return the value of a call to a device."""
        name = getattr(function, "__name__", type(function).__name__)
        answer: list[tuple[Any, BaseException | None]] = []
        done, given_up = Event(), Event()

        def work() -> None:
            try:
                answer.append((function(*arguments), None))
            except BaseException as error:  # any exception of a driver ends the run
                answer.append((None, error))
            done.set()
            if given_up.is_set():
                with suppress(Exception):  # the error has no receiver
                    self._stage.stop()

        self.check()
        Thread(target=work, daemon=True).start()
        end = time.monotonic() + self._timeout
        try:
            while not done.wait(POLL):
                self.check()
                if time.monotonic() > end:
                    raise DeviceError(f"{name} did not answer within {self._timeout:g} s")
        except BaseException:
            given_up.set()
            raise
        value, error = answer[0]
        if error is not None:
            raise DeviceError(f"{name} failed: {type(error).__name__}: {error}") from error
        return value

    def pause(self, seconds: float) -> None:
        """Wait in short steps, so that an interrupt is noticed."""
        end = self._clock.now() + seconds
        while (left := end - self._clock.now()) > 0:
            self.check()
            self._clock.sleep(min(left, POLL))

    def settle(self, watch: Callable[[], object] = lambda: None) -> None:
        """Wait until the stage stands, and call `watch` repeatedly meanwhile."""
        end, real_end = self._clock.now() + self._timeout, time.monotonic() + self._timeout
        while self.call(self._stage.moving):
            if self._clock.now() > end or time.monotonic() > real_end:
                raise DeviceError(f"the stage still moves after {self._timeout:g} s")
            watch()
            # Moves of some milliseconds are common.
            self.pause(POLL / 10)

    def _halt(self) -> str:
        """Stop the stage; return why it may still move, or an empty text."""
        self._ending = True
        trouble = ""
        for _ in range(3):  # a driver can be busy with the previous call
            try:
                self.call(self._stage.stop)
                self.settle()
                return ""
            except DeviceError as error:
                trouble = str(error)
        return trouble


@contextmanager
def interrupts(flag: Event) -> Iterator[None]:
    """Let Ctrl-C only set the flag; only the main thread can be interrupted.

    The caller builds its result and raises `RunInterrupt` in this context, where a second Ctrl-C
    has no effect.
    """
    if current_thread() is not main_thread():
        yield
        return
    first = 0.0

    def note(*_: object) -> None:
        nonlocal first
        first = first or time.monotonic()
        flag.set()

    before = signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        if flag.is_set():
            time.sleep(max(0.0, first + DEBOUNCE - time.monotonic()))
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
