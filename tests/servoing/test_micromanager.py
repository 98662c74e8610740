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
    """Two axes, a focus drive and a camera under the names of pymmcore's methods."""

    def __init__(self, camera: str = "Camera", stage: str = "XY", shutter: str = "") -> None:
        self.labels = {"camera": camera, "stage": stage, "shutter": shutter}
        self.done: list[tuple[Any, ...]] = []
        self.busy = {"XY": True, "Z": False}

    def getXYStageDevice(self) -> str:
        return self.labels["stage"]

    def getCameraDevice(self) -> str:
        return self.labels["camera"]

    def getShutterDevice(self) -> str:
        return self.labels["shutter"]

    def getFocusDevice(self) -> str:
        return "Z"

    def setAutoShutter(self, on: bool) -> None:
        self.done.append(("shutter", on))

    def getExposure(self) -> float:
        return 40.0

    def snapImage(self) -> None:
        self.done.append(("snap",))

    def getImage(self) -> np.ndarray:
        self.done.append(("image",))
        return np.arange(6, dtype=np.uint16).reshape(2, 3)

    def deviceBusy(self, label: str) -> int:
        return int(self.busy[label])

    def stop(self, label: str) -> None:
        self.done.append(("stop", label))

    def getXYPosition(self, label: str) -> list[float]:
        assert label == "XY"
        return [3.0, -4.5]

    def getPosition(self, label: str) -> float:
        assert label == "Z"
        return 7.25

    def setXYPosition(self, *arguments: object) -> None:
        self.done.append(("go", *arguments))

    def setPosition(self, *arguments: object) -> None:
        self.done.append(("focus", *arguments))

    def loadSystemConfiguration(self, path: str) -> None:
        if "bad" in path:
            raise RuntimeError("no such device")
        self.done.append(("load", path))


def test_the_stage_and_the_focus_drive_are_those_of_the_core() -> None:
    core = Core()
    scope = MicroManager(core)
    assert scope.core is core
    np.testing.assert_array_equal(scope.stage.position(), [3.0, -4.5])
    np.testing.assert_array_equal(scope.focus.position(), [7.25])
    assert scope.stage.moving() is True
    assert scope.focus.moving() is False
    core.done.clear()
    scope.stage.move_to(np.array([1, -2], np.int16))
    scope.focus.move_to(np.array([5.5], np.float32))
    scope.stage.stop()
    scope.focus.stop()
    assert core.done == [
        ("go", "XY", 1.0, -2.0),
        ("focus", "Z", 5.5),
        ("stop", "XY"),
        ("stop", "Z"),
    ]
    assert all(type(each) in (str, float) for call in core.done for each in call)
    core.done.clear()
    for mover, wrong in (
        (scope.stage, [1.0]),
        (scope.stage, [np.nan, 0]),
        (scope.focus, [1.0, 2.0]),
    ):
        with pytest.raises(ValueError, match="position must"):
            mover.move_to(np.array(wrong))
    assert core.done == []


def test_a_frame_is_exposed_half_the_exposure_after_the_call(monkeypatch) -> None:
    core = Core()
    scope = MicroManager(core)
    core.done.clear()
    times = iter([10.0, 99.0])
    monkeypatch.setattr(scope.clock, "now", lambda: next(times))
    frame, exposed = scope.camera.snap()
    np.testing.assert_array_equal(frame, [[0, 1, 2], [3, 4, 5]])
    assert exposed == pytest.approx(10.02)  # 40 ms of exposure
    assert core.done == [("snap",), ("image",)]


@pytest.mark.parametrize(("shutter", "done"), [("", [("shutter", False)]), ("Lamp", [])])
def test_only_a_shutter_that_is_missing_is_switched_off(shutter: str, done: list) -> None:
    core = Core(shutter=shutter)
    MicroManager(core)
    assert core.done == done


@pytest.mark.parametrize("wrong", [None, 3, object()])
def test_what_is_no_core_is_refused(wrong: object) -> None:
    with pytest.raises(ValueError, match=f"core or a path, got {type(wrong).__name__}"):
        MicroManager(wrong)


def test_a_configuration_is_loaded_into_a_new_core(monkeypatch, tmp_path: Path) -> None:
    module = types.ModuleType("pymmcore_plus")
    module.CMMCorePlus = Core  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "pymmcore_plus", module)
    for name in ("good.cfg", "bad.cfg"):
        (tmp_path / name).touch()
    core = MicroManager(str(tmp_path / "good.cfg")).core
    assert core.done[0] == ("load", str(tmp_path / "good.cfg"))
    with pytest.raises(ValueError, match=r"that loads, got .*bad\.cfg: no such device"):
        MicroManager(tmp_path / "bad.cfg")
