"""Microscopes without hardware, for `microlib.servoing.servo`.

Nothing of this is in the thesis: it shows that the loop of chapter 2 holds over a microscope.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib.servoing import CameraTiming, MicroManager, SimulatedWorkstation, StageModel
from microlib.synthetic import gripper_scene


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
    rng = np.random.default_rng(1)
    scene = gripper_scene(rng, pixel_size=6.23, shape=(240, 320))
    simulated = SimulatedWorkstation(
        lambda feature: scene.frame(feature - scene.home, rng),
        jacobian=turned(2.2, 0.2, mirrored=True),
        stage=StageModel(saturation=4000.0),
        camera=CameraTiming(interval=0.005, latency=0.002),
        home=scene.home,
        rng=rng,
    )
    return simulated, simulated
