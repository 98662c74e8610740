"""Micro-Manager's engine with the simulated workstation for devices, in real time.

The engine snaps, moves and locks as it does with hardware, and the truth is still known.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib.servoing import SimulatedWorkstation


def rendered_core(workstation: SimulatedWorkstation, shape: tuple[int, int]) -> Any:
    """Return a core whose camera, XY stage and focus drive are those of a simulated workstation."""
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
