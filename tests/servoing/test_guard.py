"""Calls to devices that raise, hang or do not stop: what is told, and that the stage is stopped."""

from __future__ import annotations

import signal
import time
from threading import Event

import pytest

from microlib.servoing._devices import POLL, DeviceError, EndRun, Guard, interrupts


class Clock:
    """Time that passes when somebody sleeps."""

    def __init__(self) -> None:
        self.time = 100.0
        self.slept: list[float] = []

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.time += seconds


class Stage:
    """Moves, or stands; refuses to stop for so many tries."""

    def __init__(self, moves: bool = False, refusals: int = 0) -> None:
        self.moves, self.refusals, self.stops = moves, refusals, 0

    def moving(self) -> bool:
        return self.moves

    def stop(self) -> None:
        self.stops += 1
        if self.stops <= self.refusals:
            raise OSError("busy")


def guard_of(stage: Stage | None = None, timeout: float = 1.0) -> tuple[Guard, Clock, Stage]:
    clock, stage = Clock(), stage or Stage()
    return Guard(clock, stage, timeout), clock, stage


@pytest.mark.parametrize("why", ["time", "user"])
def test_call_that_hangs_is_given_up_and_the_stage_is_stopped_later(why: str) -> None:
    guard, _, stage = guard_of(timeout=0.05 if why == "time" else 60.0)
    free = Event()

    def move_to() -> None:
        if why == "user":
            guard.interrupted.set()
        free.wait(10.0)

    error, said = {
        "time": (DeviceError, r"^move_to did not answer within 0\.05 s$"),
        "user": (EndRun, "^interrupted by the user$"),
    }[why]
    start = time.monotonic()
    with pytest.raises(error, match=said):
        guard.call(move_to)
    assert (0.05 if why == "time" else 0.0) < time.monotonic() - start < 5.0
    assert stage.stops == 0  # the driver is still busy with the move
    free.set()
    end = time.monotonic() + 5.0
    while not stage.stops and time.monotonic() < end:
        time.sleep(0.001)
    assert stage.stops == 1


def test_pause_lasts_and_can_be_interrupted() -> None:
    guard, clock, _ = guard_of()
    guard.pause(5 * POLL + 0.007)
    assert clock.now() == pytest.approx(100 + 5 * POLL + 0.007)
    assert max(clock.slept) <= POLL
    guard.interrupted.set()
    for waits in (lambda: guard.pause(1.0), lambda: guard.call(divmod, 7, 2), guard.check):
        with pytest.raises(EndRun, match=r"^interrupted by the user$"):
            waits()
    assert len(clock.slept) == 6


@pytest.mark.parametrize(
    ("refusals", "said"), [(0, ""), (2, ""), (3, "stop failed: OSError: busy")]
)
def test_stop_is_tried_three_times(refusals: int, said: str) -> None:
    guard, _, stage = guard_of(Stage(refusals=refusals))
    end = guard.run(lambda: "")
    assert (end.complete, end.still) == (not said, not said)
    assert said in end.reason
    assert stage.stops == min(refusals + 1, 3)


def test_interrupt_after_the_work_is_reported() -> None:
    guard, _, stage = guard_of()

    def work() -> str:
        guard.interrupted.set()  # after the last call to a device
        return "all positions were visited"

    end = guard.run(work)
    assert (end.reason, end.complete, end.still) == ("interrupted by the user", False, True)
    assert stage.stops == 1


def test_ctrl_c_handler_is_restored_after_a_run() -> None:
    def mine(*_: object) -> None:
        """Stand for the handler of the program that calls."""

    before = signal.signal(signal.SIGINT, mine)
    try:
        with interrupts(Event()):
            assert signal.getsignal(signal.SIGINT) is not mine
        assert signal.getsignal(signal.SIGINT) is mine
    finally:
        signal.signal(signal.SIGINT, before)
