"""Runs of `microlib.automation.inject` on simulated eggs, and what can go wrong in them.

Chapter 6 of the thesis names microinjection as what comes next; nothing of this is in the thesis.
"""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from compendium.experiments.microscope import HANGS, TIMEOUT, turned
from microlib.automation import inject
from microlib.servoing import Camera, SimulatedWorkstation, Stage
from microlib.synthetic import InjectionScene

#: The force that a scene can show, over E h R, and the least depth of a target, µm.
STRONGEST, SHALLOWEST = 0.06, 18.0
#: Share of the target's force over it at which the wall gives way.
RUPTURE = 1.1
#: What goes wrong, by the part that it happens in.
FAULTS = {
    "camera": ("camera error", "camera hangs", "black", "noise", "frozen", "pipette lost"),
    "stage": (
        "move error",
        "move hangs",
        "position error",
        "stuck",
        "slips",
        "never arrives",
        "reversed",
        "stop fails twice",
    ),
    "egg": ("egg moves", "wall gives way"),
    "user": ("Ctrl-C",),
}
#: The frames from which on: in the calibration, the approach, and under pressure.
MOMENTS = {"calibration": 4, "approach": 20, "press": 42}
#: Where a stage may go from its start, µm.
TRAVEL = 600.0


@dataclass(frozen=True)
class Rig:
    """An egg under a pipette, with what is known of it.

    Attributes
    ----------
    scene : InjectionScene
        The truth.
    workstation : SimulatedWorkstation
        The pipette on its stage, and the camera.
    jacobian : ndarray, shape (2, 2)
        Of the stage, px/µm.
    known : dict
        What `inject` is told of the egg and the camera.
    target : float
        Force to press to, µN.
    """

    scene: InjectionScene
    workstation: SimulatedWorkstation
    jacobian: NDArray
    known: dict[str, Any]
    target: float

    def truths(self, log: pd.DataFrame) -> pd.DataFrame:
        """Return `truth` for each row of a log of `inject`."""
        places = log[["stage_x_um", "stage_y_um"]].to_numpy()
        return pd.DataFrame([self.truth(place) for place in places])

    def truth(self, stage: NDArray) -> dict[str, float]:
        """Return ``approach`` and ``depth`` (µm) and ``force`` (µN) with the stage there."""
        tip = self.scene.home + self.jacobian @ np.asarray(stage, dtype=float)
        return {
            "approach": self.scene.approach(tip),
            "depth": self.scene.depth(tip),
            "force": self.scene.force(tip),
        }


def make_rig(seed: int, *, rupture: bool = True, **options: Any) -> Rig:
    """Draw an egg, a pipette and a stage.

    Parameters
    ----------
    seed : int
        Of everything.
    rupture : bool
        Whether the wall gives way above the target.
    **options
        Of `InjectionScene`, instead of those drawn.

    Returns
    -------
    Rig
        With the pipette 35 to 45 px above the egg.
    """
    rng = np.random.default_rng([seed, 81])
    radius, thickness = rng.uniform(520.0, 660.0), 3.0
    settings: dict[str, Any] = {
        "modulus": rng.uniform(0.5, 2.0),
        "radius": radius,
        "thickness": thickness,
        "probe_half_width": rng.uniform(18.0, 32.0),
        "inflation": rng.uniform(1.01, 1.08),
        "law": "neo-hooke" if rng.random() < 0.5 else "mooney-rivlin",
        "strongest": STRONGEST * thickness * radius,
    } | options
    scene = InjectionScene(rng, **settings)
    down = np.array([0.0, 1.0]) / scene.pixel_size
    ways = np.linspace(0.0, 0.85 * scene.deepest, 400)
    depths = [scene.depth(scene.contact + way * down) for way in ways]
    way = np.interp(rng.uniform(SHALLOWEST, depths[-1]), depths, ways)
    target = scene.force(scene.contact + way * down)
    if rupture:
        scene._rupture = RUPTURE * target
    angle, mirrored = rng.uniform(0, 2 * np.pi), bool(rng.random() < 0.5)
    jacobian = turned(angle, 1 / scene.pixel_size, mirrored)
    workstation = SimulatedWorkstation(
        lambda tip, focus: scene.frame(tip),
        jacobian=jacobian,
        home=scene.home,
        stage=Stage(saturation=400.0),
        camera=Camera(interval=0.03, latency=0.02),
        rng=rng,
    )
    known = {name: settings[name] for name in ("modulus", "thickness", "probe_half_width", "law")}
    return Rig(scene, workstation, jacobian, known | {"pixel_size": scene.pixel_size}, target)


def press(seed: int, *, egg: dict[str, Any] | None = None, **options: Any) -> dict[str, Any]:
    """Press one egg to its target.

    Parameters
    ----------
    seed : int
        Of the egg.
    egg : dict, optional
        Of `InjectionScene`, instead of what is drawn.
    **options
        Of `inject`.

    Returns
    -------
    dict
        ``reached``, ``reason``; how far after the true contact it was seen (``late``, µm); the
        force's and the depth's error at the target (``force error``, ``depth error``, relative);
        the largest true force over the target (``strongest``); the number of ``frames``; and
        ``run`` and ``rig``.
    """
    rig = make_rig(seed, **(egg or {}))
    settings = {"force": rig.target, "travel": TRAVEL, **rig.known, **options}
    run = inject(rig.workstation, **settings)
    log = run.log
    places = log[["stage_x_um", "stage_y_um"]].to_numpy()
    # Without rupture: what the wall had to bear, whether it did or not.
    rig.scene._rupture = None
    forces = np.array([rig.truth(place)["force"] for place in places])
    result = {"reached": run.reached, "reason": run.reason, "frames": len(log) - 1}
    result |= {"strongest": float(forces.max() / rig.target), "run": run, "rig": rig}
    result |= dict.fromkeys(("late", "force error", "depth error"), float("nan"))
    if np.isfinite(run.contact).all():
        result["late"] = rig.truth(run.contact)["approach"]
    if run.reached:
        true = rig.truth(places[log["phase"] == "press"][-1])
        result["force error"] = run.force / true["force"] - 1
        result["depth error"] = run.depth / true["depth"] - 1
    return result


class Injected(Exception):
    """Raised by a device that fails on purpose."""


class _Faulty:
    """Stands between `inject` and a rig, and spoils one of its parts from some frame on."""

    def __init__(self, rig: Rig, fault: str, frame: int) -> None:
        self.rig, self.fault, self.first = rig, fault, frame
        self.frames, self.stops = -1, 0
        self._last: NDArray | None = None
        self._lie: NDArray | None = None
        self._rng = np.random.default_rng(0)
        self.camera = SimpleNamespace(snap=self.snap)
        self.stage = SimpleNamespace(
            position=self.position, move_to=self.move_to, moving=self.moving, stop=self.stop
        )
        self.focus, self.clock = rig.workstation.focus, rig.workstation.clock

    def now(self, *names: str) -> bool:
        return self.fault in names and self.frames >= self.first

    def snap(self) -> tuple[NDArray, float]:
        self.frames += 1
        if self.now("camera error"):
            raise Injected("no trigger")
        if self.now("camera hangs"):
            time.sleep(HANGS)
        if self.now("Ctrl-C") and self.frames == self.first:
            os.kill(os.getpid(), signal.SIGINT)
        if self.now("egg moves") and self.frames == self.first:
            self.rig.scene.contact[1] += 1.5
            self.rig.scene._draw_still()
        if self.now("wall gives way"):
            self.rig.scene._rupture = 0.1 * self.rig.target
        frame, exposed = self.rig.workstation.camera.snap()
        if self.now("black"):
            frame = np.zeros_like(frame)
        if self.now("noise"):
            frame = self._rng.integers(0, 255, frame.shape).astype(frame.dtype)
        if self.now("frozen") and self._last is not None:
            frame = self._last
        if self.now("pipette lost"):
            frame = self.rig.scene.frame((self.rig.scene.home[0], -20.0))
        self._last = frame
        return frame, exposed

    def position(self) -> NDArray:
        if self.now("position error"):
            raise Injected("no encoder")
        if self.now("slips") and self._lie is not None:
            return self._lie
        return self.rig.workstation.stage.position()

    def move_to(self, position: NDArray) -> None:
        if self.now("move error"):
            raise Injected("no power")
        if self.now("move hangs"):
            time.sleep(HANGS)
        self._lie = np.array(position)
        if self.now("stuck", "slips"):
            return
        if self.now("reversed"):
            here = self.rig.workstation.stage.position()
            position = 2 * here - position
        self.rig.workstation.stage.move_to(position)

    def moving(self) -> bool:
        return self.now("never arrives") or self.rig.workstation.stage.moving()

    def stop(self) -> None:
        self.stops += 1
        if self.now("stop fails twice") and self.stops <= 2:
            raise Injected("busy")
        self.rig.workstation.stage.stop()


def spoil(
    seed: int, fault: str, frame: int, *, egg: dict[str, Any] | None = None, **options: Any
) -> dict[str, Any]:
    """Let one thing go wrong on the way to the target, and see how the run ends.

    Parameters
    ----------
    seed : int
        Of the egg.
    fault : str
        One of those in `FAULTS`.
    frame : int
        The first frame that it concerns, such as one of `MOMENTS`.
    egg : dict, optional
        Of `InjectionScene`, instead of what is drawn.
    **options
        Of `inject`.

    Returns
    -------
    dict
        The ``fault``; the ``reason``; whether the target was ``reached``; whether the stage
        was ``stopped`` and is truly ``still``; the largest true force over the target
        (``strongest``); and the ``run``.
    """
    rig = make_rig(seed, rupture=False, **(egg or {}))
    faulty: Any = _Faulty(rig, fault, frame)
    settings = {"force": rig.target, "travel": TRAVEL, "timeout": TIMEOUT, **rig.known, **options}
    try:
        run = inject(faulty, **settings)
    except KeyboardInterrupt as interrupt:
        run = interrupt.run  # type: ignore[attr-defined]
    if fault.endswith("hangs"):
        time.sleep(HANGS)  # until the call that was given up has returned
    stage, clock = rig.workstation.stage, rig.workstation.clock
    before = stage.position()
    clock.sleep(0.1)
    still = bool((stage.position() == before).all()) and not stage.moving()
    rig.scene._rupture = None
    places = run.log[["stage_x_um", "stage_y_um"]].dropna().to_numpy()
    forces = [rig.truth(place)["force"] for place in (*places, before)]
    return {
        "fault": fault,
        "reason": run.reason,
        "reached": run.reached,
        "stopped": faulty.stops > 0,
        "still": still,
        "strongest": float(max(forces) / rig.target),
        "run": run,
    }
