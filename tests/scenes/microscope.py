"""A microscope to steer: a simulated one with a gripper in view, or Micro-Manager's demo."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib.servoing import CameraTiming, MicroManager, SimulatedWorkstation, StageModel
from microlib.synthetic import gripper_scene
from microlib.tracking import ESMTracker

#: Rows and columns of the rendered frames, and side of the tracker's window, px.
SHAPE, WINDOW = (240, 320), 50


def turned(angle: float, scale: float, *, mirrored: bool) -> NDArray:
    """Return the Jacobian of a camera that is mounted at an angle (rad), px/µm."""
    cosine, sine = scale * np.cos(angle), scale * np.sin(angle)
    side = -1.0 if mirrored else 1.0
    return np.array([[cosine, -side * sine], [sine, side * cosine]])


@dataclass(frozen=True)
class Scope:
    """A workstation, the window of its tracker (x, y, width, height), and its Jacobian, px/µm."""

    workstation: Any
    box: tuple[int, int, int, int]
    jacobian: NDArray

    @property
    def home(self) -> NDArray:
        """Where the tracker sees the feature at the start, px."""
        return np.array(self.box[:2]) + (self.box[2] - 1) / 2

    @property
    def scale(self) -> float:
        return float(np.linalg.norm(self.jacobian, 2))

    def tracker(self) -> ESMTracker:
        """Begin to track in a new frame."""
        return ESMTracker(self.workstation.camera.snap()[0], self.box, "translation")


def simulated_scope(seed: int = 0, **options: Any) -> Scope:
    """Return a simulated workstation whose camera is turned, mirrored and scaled by chance.

    The options are those of `SimulatedWorkstation`.
    """
    rng = np.random.default_rng([seed, 18])
    scene = gripper_scene(rng, pixel_size=6.23, shape=SHAPE)
    scale = float(np.exp(rng.uniform(*np.log([0.08, 0.6]))))
    jacobian = turned(rng.uniform(0, 2 * np.pi), scale, mirrored=bool(rng.random() < 0.5))
    settings: dict[str, Any] = {
        "jacobian": jacobian,
        "stage": StageModel(saturation=4000.0),
        "camera": CameraTiming(interval=0.005, latency=0.002),
        "home": scene.home,
        "rng": rng,
        **options,
    }
    workstation = SimulatedWorkstation(
        lambda feature: scene.frame(feature - scene.home, rng), **settings
    )
    return Scope(workstation, scene.box(WINDOW), settings["jacobian"])


def demo_scope() -> Scope:
    """Return Micro-Manager's demo, whose camera moves its beads against both axes of the stage."""
    from pymmcore_plus import CMMCorePlus, find_micromanager

    core = CMMCorePlus()
    core.loadSystemConfiguration(str(Path(find_micromanager() or "") / "MMConfig_demo.cfg"))
    core.setProperty("Camera", "Mode", "Fluorescent Beads")
    return Scope(MicroManager(core), (220, 220, 64, 64), -np.eye(2))
