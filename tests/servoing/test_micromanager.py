"""The adapter for Micro-Manager against a core that keeps account of its calls."""

from __future__ import annotations

import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from microlib.servoing import MicroManager


class Core:
    """Two axes and a camera under the names of pymmcore's methods."""

    def __init__(self, shutter: str = "") -> None:
        self.done: list[tuple[Any, ...]] = []
        self.answers = {
            "getXYStageDevice": "XY", "getCameraDevice": "Camera", "getFocusDevice": "Z",
            "getShutterDevice": shutter, "getExposure": 40.0, "snapImage": None,
            "getImage": np.arange(6, dtype=np.uint16).reshape(2, 3),
            "getXYPosition": [3.0, -4.5], "getPosition": 7.25, "stop": None,
            "setXYPosition": None, "setPosition": None, "setAutoShutter": None,
        }  # fmt: skip

    def __getattr__(self, name: str) -> Any:
        answer = self.answers[name]

        def call(*arguments: Any) -> Any:
            self.done.append((name, *arguments))
            return answer

        return call

    def deviceBusy(self, label: str) -> int:
        return {"XY": 1, "Z": 0}[label]

    def loadSystemConfiguration(self, path: str) -> None:
        if "bad" in str(path):
            raise RuntimeError("no such device")
        self.done.append(("load", path))


def test_stage_of_micromanager_is_the_xy_stage_of_the_core() -> None:
    core = Core()
    scope = MicroManager(core)
    assert scope.core is core
    np.testing.assert_array_equal(scope.stage.position(), [3.0, -4.5])
    assert core.done[-1] == ("getXYPosition", "XY")
    assert scope.stage.moving() is True
    core.done.clear()
    scope.stage.move_to(np.array([1, -2], np.int16))
    scope.stage.stop()
    assert core.done == [("setXYPosition", "XY", 1.0, -2.0), ("stop", "XY")]
    assert all(type(each) in (str, float) for call in core.done for each in call)
    core.done.clear()
    for wrong in ([1.0], [np.nan, 0]):
        with pytest.raises(ValueError, match="position must"):
            scope.stage.move_to(np.array(wrong))
    assert core.done == []


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
    for wrong in (None, 3):
        with pytest.raises(ValueError, match=f"core or a path, got {type(wrong).__name__}"):
            MicroManager(wrong)
    for device in ("getXYStageDevice", "getCameraDevice"):
        core.answers = Core().answers | {device: ""}
        with pytest.raises(ValueError, match="core must have a camera and an XY stage"):
            MicroManager(core)


def test_configuration_file_is_loaded_into_a_new_core(monkeypatch, tmp_path: Path) -> None:
    module = types.ModuleType("pymmcore_plus")
    module.CMMCorePlus = Core  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "pymmcore_plus", module)
    for name in ("good.cfg", "bad.cfg"):
        (tmp_path / name).touch()
    core = MicroManager(str(tmp_path / "good.cfg")).core
    assert core.done[0] == ("load", str(tmp_path / "good.cfg"))
    with pytest.raises(ValueError, match=r"that loads, got .*bad\.cfg: no such device"):
        MicroManager(tmp_path / "bad.cfg")
