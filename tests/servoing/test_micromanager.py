"""The adapter for Micro-Manager against a core that records its calls."""

from typing import Any

import numpy as np
import pytest

from microlib.servoing import MicroManager


class Core:
    """Two axes and a camera under the names of pymmcore's methods."""

    def __init__(self, shutter: str = "") -> None:
        self.done: list[tuple[Any, ...]] = []
        self.answers = {
            "getXYStageDevice": "XY", "getCameraDevice": "Camera", "deviceBusy": 1,
            "getShutterDevice": shutter, "getExposure": 40.0, "snapImage": None,
            "getImage": np.arange(6, dtype=np.uint16).reshape(2, 3), "stop": None,
            "getXYPosition": [3.0, -4.5], "setXYPosition": None, "setAutoShutter": None,
        }  # fmt: skip

    def __getattr__(self, name: str) -> Any:
        answer = self.answers[name]

        def call(*arguments: Any) -> Any:
            self.done.append((name, *arguments))
            return answer

        return call


def test_stage_of_micromanager_is_the_xy_stage_of_the_core() -> None:
    core = Core()
    scope = MicroManager(core)
    assert scope.core is core
    np.testing.assert_array_equal(scope.stage.position(), [3.0, -4.5])
    assert core.done[-1] == ("getXYPosition", "XY")
    assert scope.stage.moving() is True
    assert core.done[-1] == ("deviceBusy", "XY")
    core.done.clear()
    scope.stage.move_to(np.array([1, -2], np.int16))
    scope.stage.stop()
    assert core.done == [("setXYPosition", "XY", 1.0, -2.0), ("stop", "XY")]
    assert all(type(each) in (str, float) for call in core.done for each in call)
    with pytest.raises(ValueError, match="position must be finite"):
        scope.stage.move_to(np.array([np.nan, 0]))
    assert len(core.done) == 2


def test_time_of_a_frame_is_the_middle_of_its_exposure(monkeypatch) -> None:
    core = Core()
    scope = MicroManager(core)
    core.done.clear()
    times = iter([10.0, 99.0])
    monkeypatch.setattr(scope.clock, "now", lambda: next(times))
    frame, exposed = scope.camera.snap()
    np.testing.assert_array_equal(frame, [[0, 1, 2], [3, 4, 5]])
    assert exposed == pytest.approx(10.02)  # 40 ms of exposure
    assert core.done == [("getExposure",), ("snapImage",), ("getImage",)]


def test_autoshutter_is_switched_off_only_without_a_shutter_device() -> None:
    for shutter in ("", "Lamp"):
        core = Core(shutter=shutter)
        MicroManager(core)
        assert (("setAutoShutter", False) in core.done) == (not shutter)


def test_core_without_camera_or_stage_is_rejected() -> None:
    with pytest.raises(ValueError, match="core must be a CMMCorePlus, got str"):
        MicroManager("microscope.cfg")
    core = Core()
    for device in ("getXYStageDevice", "getCameraDevice"):
        core.answers = Core().answers | {device: ""}
        with pytest.raises(ValueError, match="core must have a camera and an XY stage"):
            MicroManager(core)
