"""Microscopes without hardware, and runs of `microlib.servoing.servo` on them.

Nothing of this is in the thesis: it shows that the loop of chapter 2 holds over a microscope.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib.servoing import CameraTiming, MicroManager, SimulatedWorkstation, StageModel, servo
from microlib.synthetic import gripper_scene
from microlib.tracking import ESMTracker

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


def load_microscope(configuration: Path) -> MicroManager:
    """Return the microscope of a configuration file of Micro-Manager.

    Raises
    ------
    ImportError
        If ``pymmcore-plus`` is not installed.
    """
    from pymmcore_plus import CMMCorePlus

    core = CMMCorePlus()
    core.loadSystemConfiguration(str(configuration))
    return MicroManager(core)


def demo_microscope() -> MicroManager:
    """Return Micro-Manager's demo microscope, in the mode whose picture depends on the stage.

    Returns
    -------
    MicroManager
        512 × 512 px of fluorescent beads, 1 µm/px, the same in every run.

    Raises
    ------
    ImportError
        If ``pymmcore-plus`` and ``mm-test-adapters`` are not installed.
    """
    from pymmcore_plus import find_micromanager

    microscope = load_microscope(Path(find_micromanager() or "") / "MMConfig_demo.cfg")
    microscope.core.setProperty("Camera", "Mode", "Fluorescent Beads")
    return microscope


def make_scope(seed: int | None, **options: Any) -> Scope:
    """Return a simulated workstation, or Micro-Manager's demo.

    Parameters
    ----------
    seed : int or None
        Of the gripper's grain, the noise, and the camera's turn, mirror and scale; None for the
        demo.
    **options
        Of `SimulatedWorkstation`, instead of those drawn.

    Returns
    -------
    Scope
        With the stage at zero.
    """
    if seed is None:
        x, y, width, height = BEADS
        home = np.array([x + (width - 1) / 2, y + (height - 1) / 2])
        return Scope(demo_microscope(), None, home, BEADS)
    rng = np.random.default_rng([seed, 18])
    scene = gripper_scene(rng, pixel_size=PIXEL_SIZE, shape=SHAPE)

    scale = float(np.exp(rng.uniform(*np.log([0.08, 0.6]))))
    settings: dict[str, Any] = {
        "jacobian": turned(rng.uniform(0, 2 * np.pi), scale, bool(rng.random() < 0.5)),
        "stage": StageModel(saturation=4000.0),
        "camera": CameraTiming(interval=0.005, latency=0.002),
        "home": scene.home,
        "rng": rng,
    }
    truth = SimulatedWorkstation(
        lambda feature: scene.frame(feature - scene.home, rng), **(settings | options)
    )
    box = scene.box(WINDOW)
    return Scope(truth, truth, np.array(box[:2]) + (WINDOW - 1) / 2, box)


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
    if configuration == "demo":
        return demo_microscope(), None
    if configuration:
        return load_microscope(Path(configuration)), None
    scope = make_scope(1, jacobian=turned(2.2, 0.2, mirrored=True))
    return scope.workstation, scope.truth


def reach(seed: int | None) -> dict[str, Any]:
    """Calibrate and go to one target within 50 px of the start.

    Parameters
    ----------
    seed : int or None
        Of the microscope and the target; None for the demo.

    Returns
    -------
    dict
        ``reached``, the true ``error`` in px, and the number of moves to the target.
    """
    scope = make_scope(seed)
    away = np.random.default_rng([seed or 0, 19]).uniform(-50, 50, 2)
    before = scope.moved()
    run = servo(
        scope.workstation,
        scope.tracker(),
        scope.home + away,
        travel=150.0 / scope.scale,
        test_move=10.0 / scope.scale,
    )
    return {
        "reached": bool(run.reached.all()),
        "error": float(np.linalg.norm(scope.moved() - before - away)),
        "moves": int((run.log["phase"] == "servo").sum()) - 1,
    }
