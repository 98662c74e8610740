"""Runs of `microlib.servoing.servo` on microscopes without hardware, and what can go wrong in them.

Nothing of this is in the thesis: it shows that the loop of chapter 2 holds over a microscope.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from compendium.rendered_microscope import demo_microscope, rendered_core
from microlib.servoing import Camera, MicroManager, SimulatedWorkstation, Stage, servo
from microlib.synthetic import gripper_scene
from microlib.tracking import ESMTracker

#: The same workstation in virtual time, behind Micro-Manager's engine, and the engine's own demo.
KINDS = ("simulated", "engine", "demo")
#: Rows and columns of the rendered frames.
SHAPE = (240, 320)
#: Of the rendered gripper, µm, and of the tracker's window, px.
PIXEL_SIZE, WINDOW = 6.23, 50
#: Where the demo's beads are tracked: x, y, width, height in px.
BEADS = (220, 220, 64, 64)


@dataclass(frozen=True)
class Scope:
    """A microscope to steer.

    Attributes
    ----------
    workstation : SimulatedWorkstation or MicroManager
        What `servo` steers.
    truth : SimulatedWorkstation or None
        The simulation behind it; the demo has none.
    home : ndarray, shape (2,)
        Where the tracker sees the feature at the start, px.
    box : tuple of int
        Window of the tracker, px.
    """

    workstation: Any
    truth: SimulatedWorkstation | None
    home: NDArray
    box: tuple[int, int, int, int]

    def tracker(self) -> ESMTracker:
        """Begin to track in a new frame."""
        frame, _ = self.workstation.camera.snap()
        return ESMTracker(frame, self.box, "translation")

    @property
    def scale(self) -> float:
        """px/µm."""
        return 1.0 if self.truth is None else float(np.linalg.norm(self.truth._jacobian, 2))

    def moved(self) -> NDArray:
        """Return how far the feature truly is from where it was at the start, px."""
        if self.truth is not None:
            return self.truth.feature - self.truth._home
        # The demo camera moves its beads by 1 px/µm against both axes of the stage.
        return -self.workstation.stage.position()


def turned(angle: float, scale: float, mirrored: bool) -> NDArray:
    """Return the Jacobian of a camera that is mounted at an angle (rad), px/µm.

    Examples
    --------
    >>> turned(np.pi / 2, 0.5, mirrored=True).round(3) + 0.0
    array([[0. , 0.5],
           [0.5, 0. ]])
    """
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return scale * turn @ np.diag([1.0, -1.0 if mirrored else 1.0])


def make_scope(kind: str, seed: int, **options: Any) -> Scope:
    """Return a microscope of one of `KINDS`.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    seed : int
        Of the gripper's grain, the noise, and the camera's turn, mirror and scale.
    **options
        Of `SimulatedWorkstation`, instead of those drawn.

    Returns
    -------
    Scope
        With the stage at zero.
    """
    if kind == "demo":
        demo = demo_microscope()
        x, y, width, height = BEADS
        return Scope(demo, None, np.array([x + (width - 1) / 2, y + (height - 1) / 2]), BEADS)
    rng = np.random.default_rng([seed, 18])
    scene = gripper_scene(rng, pixel_size=PIXEL_SIZE, shape=SHAPE)

    def render(feature: NDArray, focus: float) -> NDArray:
        frame = scene.frame(feature - scene.home, rng)
        return cv2.GaussianBlur(frame, (0, 0), 0.3 * abs(focus)) if abs(focus) > 1.0 else frame

    jacobian = turned(
        rng.uniform(0, 2 * np.pi),
        float(np.exp(rng.uniform(*np.log([0.08, 0.6])))),
        rng.random() < 0.5,
    )
    settings: dict[str, Any] = {
        "jacobian": jacobian,
        "stage": Stage(saturation=4000.0),
        "camera": Camera(interval=0.005, latency=0.002),
        "home": scene.home,
        "rng": rng,
    }
    truth = SimulatedWorkstation(render, **(settings | options))
    box = scene.box(WINDOW)
    home = np.array(box[:2]) + (WINDOW - 1) / 2
    if kind == "simulated":
        return Scope(truth, truth, home, box)
    return Scope(MicroManager(rendered_core(truth, SHAPE)), truth, home, box)


def open_microscope(configuration: str) -> tuple[Any, SimulatedWorkstation | None]:
    """Open what a guide steers.

    Parameters
    ----------
    configuration : str
        Path of a configuration of Micro-Manager, ``demo`` for its own, or empty for a simulated
        workstation.

    Returns
    -------
    workstation : SimulatedWorkstation or MicroManager
        What `servo` steers.
    truth : SimulatedWorkstation or None
        The simulation, if it is one.
    """
    if configuration in ("", "demo"):
        options = {} if configuration else {"jacobian": turned(2.2, 0.2, mirrored=True)}
        scope = make_scope(configuration or "simulated", 1, **options)
        return scope.workstation, scope.truth
    return MicroManager(Path(configuration)), None


def reach(kind: str, seed: int, *, drive: str = "position") -> dict[str, Any]:
    """Calibrate and go to one target within 50 px of the start.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    seed : int
        Of the microscope and the target.
    drive : str
        As for `servo`.

    Returns
    -------
    dict
        ``reached``, the true ``error`` in px, the ``frames`` and the moves to the target
        (``steps``), and the calibration's ``misfit``; ``run`` is the `ServoRun`.
    """
    scope = make_scope(kind, seed)
    away = np.random.default_rng([seed, 19]).uniform(-50, 50, 2)
    scale = scope.scale
    before = scope.moved()
    run = servo(
        scope.workstation,
        scope.tracker(),
        scope.home + away,
        travel=150.0 / scale,
        test_move=10.0 / scale,
        drive=drive,
        speed=100.0 / scale if drive == "velocity" else None,
        interval=0.02,
        most_frames=200,
    )
    steps = run.log.query("phase == 'servo'")
    return {
        "reached": bool(run.reached.all()),
        "error": float(np.linalg.norm(scope.moved() - before - away)),
        "frames": len(run.log) - 1,
        "steps": len(steps) - 1,
        "misfit": run.misfit,
        "run": run,
    }


@dataclass(frozen=True)
class Fault:
    """Something that goes wrong.

    Attributes
    ----------
    name : str
        What it is.
    where : str
        The part that it happens in: ``camera``, ``stage``, ``tracker``, ``loop`` or ``user``.
    frame : int
        The first frame that it concerns, from 0: 1 to 8 are the calibration's.
    """

    name: str
    where: str
    frame: int

    def __str__(self) -> str:
        return f"{self.name} at frame {self.frame}"


#: In the middle of the calibration, and on the way to the target: frames 1 to 8 are calibrated on.
MOMENTS = (2, 10)
#: All kinds of faults, each at its moments.
FAULTS = [
    *(
        Fault(name, where, frame)
        for where, names in {
            "camera": ("camera error", "camera hangs", "black", "noise", "frozen", "other size"),
            "stage": (
                "move error",
                "move hangs",
                "position error",
                "stuck",
                "never arrives",
                "reversed",
            ),
            "tracker": ("tracker error",),
        }.items()
        for name in names
        for frame in MOMENTS
    ),
    Fault("stop fails twice", "stage", 10),
    Fault("progress error", "loop", 10),
    Fault("controller gives NaN", "loop", 9),
    Fault("controller error", "loop", 9),
    Fault("target beyond the travel", "loop", 9),
    Fault("Jacobian a quarter turn wrong", "loop", 1),
    Fault("Jacobian mirrored", "loop", 1),
    *(
        Fault(f"Ctrl-C during {call}", "user", frame)
        for call, frame in (("snap", 2), ("snap", 10), ("moving", 2), ("moving", 9), ("track", 10))
    ),
]
#: From home to the target, px.
WAY = (-35.0, 30.0)
#: How long a device may take in these runs, s, and how long one that hangs does: on a busy machine
#: a sound one takes half a second.
TIMEOUT, HANGS = 1.0, 2.0


class Injected(Exception):
    """Raised by a device that fails on purpose."""


class _Faulty:
    """Stands between the loop and a workstation, and spoils one of its parts."""

    def __init__(self, scope: Scope, fault: Fault) -> None:
        self.workstation, self.fault = scope.workstation, fault
        self.frames = -1  # the tracker's first frame is not of the run
        self.stops = 0
        self._last: NDArray | None = None
        self._tracker = scope.tracker()
        self._rng = np.random.default_rng(0)
        self.camera = SimpleNamespace(snap=self.snap)
        self.stage = SimpleNamespace(
            position=self.position, move_to=self.move_to, moving=self.moving, stop=self.stop
        )
        if hasattr(self.workstation.stage, "move_at"):
            self.stage.move_at = self.move_at
        self.focus, self.clock = self.workstation.focus, self.workstation.clock

    def now(self, name: str) -> bool:
        return self.fault.name == name and self.frames >= self.fault.frame

    def interrupt(self, call: str) -> None:
        if self.fault.name == f"Ctrl-C during {call}" and self.frames == self.fault.frame:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.001)  # lets the signal arrive while the call is under way

    def snap(self) -> tuple[NDArray, float]:
        self.frames += 1
        self.interrupt("snap")
        if self.now("camera error"):
            raise Injected("no trigger")
        if self.now("camera hangs"):
            time.sleep(HANGS)
        frame, exposed = self.workstation.camera.snap()
        spoiled = {
            "black": lambda: np.zeros_like(frame),
            "noise": lambda: self._rng.integers(0, 255, frame.shape).astype(frame.dtype),
            "frozen": lambda: frame if self._last is None else self._last,
            "other size": lambda: frame[:-2],
        }
        if self.now(self.fault.name) and self.fault.name in spoiled:
            frame = spoiled[self.fault.name]()
        self._last = frame
        return frame, exposed

    def track(self, frame: NDArray) -> Any:
        self.interrupt("track")
        if self.now("tracker error"):
            raise Injected("no template")
        return self._tracker.track(frame)

    def position(self) -> NDArray:
        if self.now("position error"):
            raise Injected("no encoder")
        return self.workstation.stage.position()

    def move_to(self, position: NDArray) -> None:
        self._start_move("move_to", position)

    def move_at(self, velocity: NDArray) -> None:
        self._start_move("move_at", velocity)

    def _start_move(self, call: str, value: NDArray) -> None:
        if self.now("move error"):
            raise Injected("no power")
        if self.now("move hangs"):
            time.sleep(HANGS)
        if self.now("stuck"):
            return
        if self.now("reversed"):
            here = self.workstation.stage.position() if call == "move_to" else 0.0
            value = here - (value - here)
        getattr(self.workstation.stage, call)(value)

    def moving(self) -> bool:
        self.interrupt("moving")
        return self.now("never arrives") or self.workstation.stage.moving()

    def stop(self) -> None:
        self.stops += 1
        if self.now("stop fails twice") and self.stops <= 2:
            raise Injected("busy")
        self.workstation.stage.stop()


def inject(kind: str, fault: Fault, seed: int = 0, drive: str = "position") -> dict[str, Any]:
    """Let one thing go wrong on the way to a target, and see how the run ends.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    fault : Fault
        One of `FAULTS`.
    seed : int
        Of the microscope.
    drive : str
        As for `servo`.

    Returns
    -------
    dict
        The ``reason`` in the log's last row, whether the target was reached all the same
        (``complete``), whether ``stopped`` was called and the stage is truly ``still``, the largest
        distance from the start over the travel (``excursion``), how far it went after the run
        (``coasted``, px), and the ``run``.
    """
    # Slow enough that moves take time, which an interrupt can come in.
    options = {} if kind == "demo" else {"stage": Stage(saturation=1000.0)}
    scope = make_scope(kind, seed, **options)
    scale = scope.scale
    faulty = _Faulty(scope, fault)
    travel = 60.0 / scale
    truth = np.eye(2) if scope.truth is None else scope.truth._jacobian
    wrong = {
        "Jacobian a quarter turn wrong": np.array([[0.0, -1.0], [1.0, 0.0]]) @ truth,
        "Jacobian mirrored": np.diag([1.0, -1.0]) @ truth,
    }
    controllers = {
        "controller gives NaN": lambda k, measured, goals: np.full(2, np.nan),
        "controller error": _raise,
    }
    beyond = fault.name == "target beyond the travel"
    farthest = _watch_excursion(scope)
    try:
        run = servo(
            faulty,
            faulty,
            scope.home + ((200.0, 0.0) if beyond else WAY),
            travel=travel,
            test_move=10.0 / scale,
            jacobian=wrong.get(fault.name),
            controller=controllers.get(fault.name),
            # In steps, so that the faults on the way come before the target.
            step=10.0 / scale,
            speed=200.0 / scale if drive == "velocity" else None,
            interval=0.02,
            drive=drive,
            timeout=TIMEOUT,
            progress=_progress(faulty),
        )
    except KeyboardInterrupt as interrupt:
        run = interrupt.run  # type: ignore[attr-defined]
    ended = scope.workstation.stage.position()
    if fault.name.endswith("hangs"):
        time.sleep(HANGS)  # until the call that was given up has returned
    still = _stands(scope)
    coasted = np.linalg.norm(scope.workstation.stage.position() - ended) * scope.scale
    return {
        "fault": str(fault),
        "reason": run.log["event"].iloc[-1],
        "complete": bool(run.reached.all()),
        "stopped": faulty.stops > 0,
        "still": still,
        "excursion": float(np.max(farthest() / travel)),
        "coasted": float(coasted),
        "run": run,
    }


def _raise(*_: object) -> NDArray:
    raise Injected("on purpose")


def _progress(faulty: _Faulty) -> Callable[[dict[str, Any]], None]:
    def progress(row: dict[str, Any]) -> None:
        if faulty.now("progress error"):
            raise Injected("no window")

    return progress


def _stands(scope: Scope) -> bool:
    """Return whether the stage does not move any more."""
    stage, clock = scope.workstation.stage, scope.workstation.clock
    clock.sleep(0.05)
    before = stage.position()
    clock.sleep(0.1)
    return bool((stage.position() == before).all()) and not stage.moving()


def _watch_excursion(scope: Scope) -> Callable[[], NDArray]:
    """Return a function that says how far either axis was from where it is now, µm."""
    stage = scope.workstation.stage if scope.truth is None else scope.truth.stage
    start = stage.position()
    farthest = np.zeros(2)
    if scope.truth is None:
        return lambda: np.abs(stage.position() - start)
    advance = scope.truth.stage.advance

    def watched(duration: float) -> None:
        advance(duration)
        np.maximum(farthest, np.abs(stage.position() - start), out=farthest)

    scope.truth.stage.advance = watched  # type: ignore[method-assign]
    return lambda: farthest


def interrupt_after(kind: str, delay: float, seed: int = 0) -> dict[str, Any]:
    """Send Ctrl-C some seconds into a run, and see how it ends.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    delay : float
        From the call of `servo`, s of real time.
    seed : int
        Of the microscope.

    Returns
    -------
    dict
        As of `inject`; ``complete`` if the signal came too late, and nothing was interrupted.
    """
    scope = make_scope(kind, seed, stage=Stage(saturation=1000.0))
    tracker, travel = scope.tracker(), 60.0 / scope.scale
    farthest = _watch_excursion(scope)
    timer = threading.Timer(delay, lambda: os.kill(os.getpid(), signal.SIGINT))
    complete, reason = False, ""
    # Before and after the run the signal does nothing, so that it cannot end the experiment.
    before = signal.signal(signal.SIGINT, lambda *_: None)
    try:
        timer.start()
        run = servo(
            scope.workstation,
            tracker,
            scope.home + WAY,
            travel=travel,
            test_move=10.0 / scope.scale,
            step=10.0 / scope.scale,
        )
        complete = bool(run.reached.all())
    except KeyboardInterrupt as interrupt:
        reason = interrupt.run.log["event"].iloc[-1]  # type: ignore[attr-defined]
    finally:
        timer.cancel()
        timer.join()
        signal.signal(signal.SIGINT, before)
    return {
        "reason": reason or "done",
        "complete": complete,
        "still": _stands(scope),
        "excursion": float(np.max(farthest() / travel)),
    }
