"""Call devices so that no fault and no Ctrl-C leaves a stage moving."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event, Thread, current_thread, main_thread
from typing import Any

from microlib._common._devices import Clock, Mover

#: Time between two questions (whether a device answered, still moves, or the user wants an end), s:
#: of the order of what a serial line needs for an answer, and short beside a person's reaction.
POLL = 0.02

#: How often a stop is tried that fails: a driver may be busy with the call before.
_STOPS = 3


class EndRun(Exception):
    """The run ends for the reason that is its message."""


class DeviceError(EndRun):
    """A device raised, or did not answer in time."""


class Guard:
    """Makes each call in a thread of its own, so that a device that hangs cannot hold the loop.

    A thread cannot be ended from outside. One whose call was given up stops the stage as soon as
    the call returns, since that may have been the start of a move.

    Parameters
    ----------
    clock, stage : Clock, Mover
        Of the workstation.
    timeout : float
        Longest time that a call or a move may take, s.
    """

    def __init__(self, clock: Clock, stage: Mover, timeout: float) -> None:
        self.interrupted = Event()
        self._clock, self._stage, self._timeout = clock, stage, timeout
        self._ending = False

    def check(self) -> None:
        """End the run if the user wants that."""
        if self.interrupted.is_set() and not self._ending:
            raise EndRun("interrupted by the user")

    def call(
        self,
        function: Callable[..., Any],
        *arguments: Any,
        waiting: Callable[[], object] = lambda: None,
    ) -> Any:
        """Return what a device answers; `waiting` is called again and again until it does."""
        name = getattr(function, "__name__", type(function).__name__)
        answer: list[tuple[bool, Any]] = []
        done, given_up = Event(), Event()

        def work() -> None:
            try:
                answer.append((True, function(*arguments)))
            except BaseException as error:  # whatever a driver raises ends the run
                answer.append((False, error))
            finally:
                done.set()
            if given_up.is_set():
                with suppress(Exception):  # nobody is left to be told
                    self._stage.stop()

        self.check()
        Thread(target=work, daemon=True).start()
        end = time.monotonic() + self._timeout
        try:
            while not done.wait(POLL):
                self.check()
                waiting()
                if time.monotonic() > end:
                    raise DeviceError(f"{name} did not answer within {self._timeout:g} s")
        except BaseException:
            given_up.set()
            raise
        good, value = answer[0]
        if good:
            return value
        raise DeviceError(f"{name} failed: {type(value).__name__}: {value}") from value

    def pause(self, seconds: float) -> None:
        """Let time pass, in pieces that an interrupt can come between."""
        end = self._clock.now() + seconds
        while (left := end - self._clock.now()) > 0:
            self.check()
            self._clock.sleep(min(left, POLL))

    def settle(self, watch: Callable[[], object] = lambda: None) -> None:
        """Wait until the stage stands, and call `watch` again and again until it does."""
        end, real_end = self._clock.now() + self._timeout, time.monotonic() + self._timeout
        while self.call(self._stage.moving):
            if self._clock.now() > end or time.monotonic() > real_end:
                raise DeviceError(f"the stage still moves after {self._timeout:g} s")
            watch()
            # A tenth: moves of some milliseconds are common, and polling is all that this costs.
            self.pause(POLL / 10)

    def halt(self) -> str:
        """Stop the stage whatever happens; return why it may not stand still, or nothing."""
        self._ending = True
        trouble = ""
        for _ in range(_STOPS):
            try:
                self.call(self._stage.stop)
                self.settle()
                return ""
            except DeviceError as error:
                trouble = str(error)
        return trouble


@contextmanager
def interrupts(flag: Event) -> Iterator[None]:
    """Let Ctrl-C set the flag and nothing else; only the main thread can be interrupted."""
    if current_thread() is not main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, lambda *_: flag.set())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
