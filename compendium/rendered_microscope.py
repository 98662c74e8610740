"""Microscopes without hardware on Micro-Manager's engine: its own demo, and a rendered one.

The rendered one has the simulated workstation for devices, in real time: the engine then snaps,
moves and locks as it does with hardware, and the truth is still known.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib.servoing import MicroManager, SimulatedWorkstation

__all__ = ["demo_microscope", "rendered_core"]


def demo_microscope() -> MicroManager:
    """
    Return Micro-Manager's demo microscope, in the mode whose picture depends on the stage.

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

    microscope = MicroManager(Path(find_micromanager() or "") / "MMConfig_demo.cfg")
    microscope.core.setProperty("Camera", "Mode", "Fluorescent Beads")
    return microscope


def rendered_core(workstation: SimulatedWorkstation, shape: tuple[int, int]) -> Any:
    """
    Return a core whose camera, XY stage and focus drive are those of a simulated workstation.

    Parameters
    ----------
    workstation : SimulatedWorkstation
        Its virtual time is moved on as real time passes.
    shape : tuple of int
        Rows and columns of a frame, which are of eight bits.

    Returns
    -------
    pymmcore_plus.experimental.unicore.UniMMCore
        With the devices ``Camera``, ``XY`` and ``Z``.

    Raises
    ------
    ImportError
        If ``pymmcore-plus`` is not installed.
    """
    from pymmcore_plus.experimental.unicore import (
        SimpleCameraDevice,
        StageDevice,
        UniMMCore,
        XYStageDevice,
    )

    start = time.monotonic()

    def catch_up() -> None:
        clock = workstation.clock
        clock.sleep(max(0.0, time.monotonic() - start - clock.now()))

    class Camera(SimpleCameraDevice):
        _exposure = 1.0

        def get_exposure(self) -> float:
            return self._exposure

        def set_exposure(self, exposure: float) -> None:
            self._exposure = exposure

        def dtype(self) -> type:
            return np.uint8

        def sensor_shape(self) -> tuple[int, int]:
            return shape

        def snap(self, buffer: NDArray[Any]) -> Mapping[str, Any]:
            catch_up()
            buffer[:], _ = workstation.camera.snap()
            return {}

    class Drive:
        """What both drives share; `drive` is the one behind the device."""

        drive = workstation.stage

        def busy(self) -> bool:
            catch_up()
            return self.drive.moving()

        def stop(self) -> None:
            catch_up()
            self.drive.stop()

        def home(self) -> None:
            self.drive.move_to(np.zeros_like(self.drive.position()))

        def read(self) -> NDArray:
            catch_up()
            return self.drive.position()

        def go(self, *position: float) -> None:
            catch_up()
            self.drive.move_to(np.array(position))

    class XY(Drive, XYStageDevice):
        def get_position_um(self) -> tuple[float, float]:
            x, y = self.read()
            return float(x), float(y)

        def set_position_um(self, x: float, y: float) -> None:
            self.go(x, y)

        def set_origin_x(self) -> None:
            raise NotImplementedError

        set_origin_y = set_origin_x

    class Z(Drive, StageDevice):
        drive = workstation.focus

        def get_position_um(self) -> float:
            return float(self.read()[0])

        def set_position_um(self, val: float) -> None:
            self.go(val)

        def set_origin(self) -> None:
            raise NotImplementedError

    core = UniMMCore()
    for label, device in (("Camera", Camera()), ("XY", XY()), ("Z", Z())):
        core.loadPyDevice(label, device)
        core.initializeDevice(label)
    core.setCameraDevice("Camera")
    core.setXYStageDevice("XY")
    core.setFocusDevice("Z")
    return core
