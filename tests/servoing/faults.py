"""A microscope that fails on purpose, between the loop and the simulation."""

from __future__ import annotations

import os
import signal
import threading
import time
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compendium.experiments.microscope import Scope, make_scope
from microlib.servoing import MicroManager, Stage, servo
from tests.servoing.engine import rendered_core

#: How long a device may take in these runs, s: on a busy machine a sound one takes half a second.
TIMEOUT = 1.0
#: From home to the target, px.
WAY = (-35.0, 30.0)
#: In the middle of the calibration, and on the way to the target: frames 1 to 8 are calibrated on.
MOMENTS = (2, 10)
FAULTS = [
    (name, frame)
    for name in (
        "snap error", "snap hangs", "black", "noise", "frozen", "other size", "move error",
        "move hangs", "position error", "stuck", "never arrives", "reversed", "track error",
    )
    for frame in MOMENTS
] + [
    ("stop fails twice", 10), ("progress error", 10),
    ("target beyond the travel", 9), ("Jacobian a quarter turn wrong", 1),
    ("Jacobian mirrored", 1), ("Ctrl-C during snap", 2), ("Ctrl-C during snap", 10),
    ("Ctrl-C during moving", 2), ("Ctrl-C during moving", 9), ("Ctrl-C during track", 10),
]  # fmt: skip


class Injected(Exception):
    """Raised by a device that fails on purpose."""


def engine_scope(seed: int, **options: Any) -> Scope:
    """Return the simulated workstation behind Micro-Manager's engine."""
    scope = make_scope(seed, **options)
    assert scope.truth is not None
    core = rendered_core(scope.truth, (240, 320))
    return Scope(MicroManager(core), scope.truth, scope.home, scope.box)


class Faulty:
    """Stands between the loop and a workstation, and spoils one of its parts from a frame on."""

    def __init__(self, scope: Scope, fault: str, frame: int) -> None:
        self.workstation, self.fault, self.first = scope.workstation, fault, frame
        self.frames = -1  # the tracker's first frame is not of the run
        self.stops = 0
        self.farthest = 0.0  # from the start along either axis, µm
        self.given_up = threading.Event()
        self._last: NDArray | None = None
        self._tracker = scope.tracker()
        self._rng = np.random.default_rng(0)
        self.camera = SimpleNamespace(snap=self.snap)
        self.stage = SimpleNamespace(
            position=self.position, move_to=self.move_to, moving=self.moving, stop=self.stop
        )
        self.clock = self.workstation.clock

    def now(self, name: str) -> bool:
        return self.fault == name and self.frames >= self.first

    def begin(self, call: str) -> None:
        """Fail, hang or be interrupted in a call."""
        if self.now(f"Ctrl-C during {call}") and self.frames == self.first:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.001)  # lets the signal arrive while the call is under way
        if self.now(f"{call} error"):
            raise Injected(call)
        if self.now(f"{call} hangs"):
            self.given_up.wait()

    def snap(self) -> tuple[NDArray, float]:
        self.frames += 1
        self.begin("snap")
        frame, exposed = self.workstation.camera.snap()
        if self.now("black"):
            frame = np.zeros_like(frame)
        if self.now("noise"):
            frame = self._rng.integers(0, 255, frame.shape).astype(frame.dtype)
        if self.now("frozen") and self._last is not None:
            frame = self._last
        if self.now("other size"):
            frame = frame[:-2]
        self._last = frame
        return frame, exposed

    def track(self, frame: NDArray) -> Any:
        self.begin("track")
        return self._tracker.track(frame)

    def position(self) -> NDArray:
        self.begin("position")
        return self.workstation.stage.position()

    def move_to(self, position: NDArray) -> None:
        self.begin("move")
        if self.now("stuck"):
            return
        if self.now("reversed"):
            position = 2 * self.workstation.stage.position() - position
        self.workstation.stage.move_to(position)

    def moving(self) -> bool:
        self.begin("moving")
        self.farthest = max(self.farthest, *np.abs(self.workstation.stage.position()))
        return self.now("never arrives") or self.workstation.stage.moving()

    def stop(self) -> None:
        self.stops += 1
        if self.now("stop fails twice") and self.stops <= 2:
            raise Injected("stop")
        self.workstation.stage.stop()

    def progress(self, row: dict[str, Any]) -> None:
        self.begin("progress")


@dataclass(frozen=True)
class Outcome:
    """How a run with a fault ended: truly, and by what it says."""

    run: Any
    stops: int
    still: bool
    excursion: float
    coasted: float


def run_with(fault: str, frame: int, *, engine: bool = False) -> Outcome:
    """Let one thing go wrong on the way to a target."""
    # Slow enough that moves take time, which an interrupt can come in.
    scope = (engine_scope if engine else make_scope)(0, stage=Stage(saturation=1000.0))
    assert scope.truth is not None
    truth = scope.truth._jacobian
    wrong = {
        "Jacobian a quarter turn wrong": [[0, -1], [1, 0]],
        "Jacobian mirrored": [[1, 0], [0, -1]],
    }
    faulty = Faulty(scope, fault, frame)
    travel = 60.0 / scope.scale
    beyond = fault == "target beyond the travel"
    threads = threading.active_count()
    try:
        run = servo(
            faulty,
            faulty,
            scope.home + ((200.0, 0.0) if beyond else WAY),
            travel=travel,
            test_move=10.0 / scope.scale,
            jacobian=wrong[fault] @ truth if fault in wrong else None,
            step=10.0 / scope.scale,  # so that the faults on the way come before the target
            timeout=TIMEOUT,
            progress=faulty.progress,
        )
    except KeyboardInterrupt as interrupt:
        run = interrupt.run  # type: ignore[attr-defined]
    else:  # who called must not go on
        assert not fault.startswith("Ctrl-C")
    ended = scope.truth.stage.position()
    faulty.given_up.set()
    while threading.active_count() > threads:  # until the call that was given up has returned
        time.sleep(0.01)
    scope.workstation.clock.sleep(0.05)
    before = scope.truth.stage.position()
    scope.workstation.clock.sleep(0.1)
    after = scope.truth.stage.position()
    coasted = float(np.linalg.norm(after - ended)) * scope.scale
    still = bool((after == before).all())
    return Outcome(run, faulty.stops, still, float(faulty.farthest / travel), coasted)
