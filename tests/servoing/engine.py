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
    """Return a core whose camera and XY stage are those of a simulated workstation."""
    from pymmcore_plus.experimental.unicore import SimpleCameraDevice, UniMMCore, XYStageDevice

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

    class XY(XYStageDevice):
        def busy(self) -> bool:
            catch_up()
            return workstation.stage.moving()

        def stop(self) -> None:
            catch_up()
            workstation.stage.stop()

        def home(self) -> None:
            workstation.stage.move_to(np.zeros(2))

        def get_position_um(self) -> tuple[float, float]:
            catch_up()
            x, y = workstation.stage.position()
            return float(x), float(y)

        def set_position_um(self, x: float, y: float) -> None:
            catch_up()
            workstation.stage.move_to(np.array([x, y]))

        def set_origin_x(self) -> None:
            raise NotImplementedError

        set_origin_y = set_origin_x

    core = UniMMCore()
    for label, device in (("Camera", Camera()), ("XY", XY())):
        core.loadPyDevice(label, device)
        core.initializeDevice(label)
    core.setCameraDevice("Camera")
    core.setXYStageDevice("XY")
    return core
