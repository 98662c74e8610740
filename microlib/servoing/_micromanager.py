"""Micro-Manager's devices as the camera, stage and clock that `servo` steers."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, as_array


class MicroManager:
    """Camera and stage of a Micro-Manager core, with the interface that `servo` needs.

    Parameters
    ----------
    core : pymmcore_plus.CMMCorePlus or subclass
        A core whose devices are loaded, ``core.loadSystemConfiguration("microscope.cfg")``. Its
        current camera (``getCameraDevice``) and XY stage (``getXYStageDevice``) are used.

    Attributes
    ----------
    core : pymmcore_plus.CMMCorePlus
        The core, for whatever else is to be set.
    camera : object with ``snap()``
        Returns the frame and the middle of its exposure, taken as half the exposure time after the
        call: what the camera waits before it exposes is not known.
    stage : object with ``position()``, ``move_to(position)``, ``moving()``, ``stop()``
        The XY stage, µm.
    clock : object with ``now()``, ``sleep(seconds)``
        The computer's monotonic clock.

    Raises
    ------
    ValueError
        If the core has no camera or no XY stage.

    Notes
    -----
    Whether a drive moves is asked of the device (``deviceBusy``) and not waited for in the core
    (``waitForDevice``), which would let no interrupt through until it times out. A shutter that the
    core would open by itself, and does not have, is switched off (``setAutoShutter``), since
    snapping fails with it.
    """

    def __init__(self, core: Any) -> None:
        if not callable(getattr(core, "getXYStageDevice", None)):
            raise ValueError(f"core must be a CMMCorePlus, got {type(core).__name__}")
        label = core.getXYStageDevice()
        if not core.getCameraDevice() or not label:
            raise ValueError(
                "core must have a camera and an XY stage, got "
                f"camera {core.getCameraDevice()!r} and XY stage {label!r}"
            )
        if not core.getShutterDevice():
            core.setAutoShutter(False)
        self.core = core
        self.clock = SimpleNamespace(now=time.monotonic, sleep=time.sleep)
        self.camera = SimpleNamespace(snap=self._snap)
        self.stage = _CoreStage(core, label)

    def _snap(self) -> tuple[NDArray[Any], float]:
        half = self.core.getExposure() / 2000.0  # of ms
        start = self.clock.now()
        self.core.snapImage()
        return self.core.getImage(), start + half


class _CoreStage:
    def __init__(self, core: Any, label: str) -> None:
        self._core, self._label = core, label

    def position(self) -> Array:
        return np.array(self._core.getXYPosition(self._label), dtype=float)

    def move_to(self, position: Array) -> None:
        x, y = as_array("position", position, shape=(2,))
        self._core.setXYPosition(self._label, float(x), float(y))

    def moving(self) -> bool:
        return bool(self._core.deviceBusy(self._label))

    def stop(self) -> None:
        self._core.stop(self._label)
