"""The devices that Micro-Manager's engine is given, with a core that only keeps them."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from compendium import rendered_microscope
from compendium.rendered_microscope import demo_microscope, rendered_core
from microlib.servoing import Camera, SimulatedWorkstation, Stage


class Core:
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.devices: dict[str, Any] = {}
        self.ready: list[str] = []
        self.roles: dict[str, str] = {}
        for role in ("Camera", "XYStage", "Focus"):
            name = f"set{role}Device"
            setattr(self, name, lambda label, role=role: self.roles.update({role: label}))

    def loadPyDevice(self, label: str, device: Any) -> None:
        self.devices[label] = device

    def initializeDevice(self, label: str) -> None:
        self.ready.append(label)


@pytest.fixture
def engine(monkeypatch):
    """Put the names that are imported in the place of the engine's, and time in our hands."""
    names = [f"pymmcore_plus{part}" for part in ("", ".experimental", ".experimental.unicore")]
    modules = [ModuleType(name) for name in names]
    for kind in ("SimpleCameraDevice", "StageDevice", "XYStageDevice"):
        setattr(modules[2], kind, type(kind, (), {}))
    modules[2].UniMMCore = Core
    for name, module in zip(names, modules, strict=True):
        monkeypatch.setitem(sys.modules, name, module)
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(rendered_microscope, "time", SimpleNamespace(monotonic=lambda: clock.now))
    return SimpleNamespace(package=modules[0], clock=clock)


def workstation() -> SimulatedWorkstation:
    return SimulatedWorkstation(
        lambda feature, z: np.full((6, 9), 10.0 + feature[0] + z),
        jacobian=np.eye(2), home=(3.0, 0.0), stage=Stage(100.0, step=0.0),
        camera=Camera(0.01), rng=0, focus_drive=Stage(50.0, step=0.0),
    )  # fmt: skip


def test_the_devices_are_those_of_the_workstation_in_real_time(engine) -> None:
    rig = workstation()
    core = rendered_core(rig, (6, 9))
    assert core.roles == {"Camera": "Camera", "XYStage": "XY", "Focus": "Z"}
    assert core.ready == list(core.devices) == ["Camera", "XY", "Z"]
    camera, stage, focus = (core.devices[label] for label in ("Camera", "XY", "Z"))
    assert camera.sensor_shape() == (6, 9)
    assert camera.dtype() is np.uint8
    assert camera.get_exposure() == 1.0
    camera.set_exposure(5.0)
    assert camera.get_exposure() == 5.0
    stage.set_position_um(10.0, -20.0)
    assert stage.busy()
    engine.clock.now += 0.1  # at 100 µm/s
    assert stage.get_position_um() == pytest.approx((10.0, -10.0))
    assert not focus.busy()
    engine.clock.now += 0.2
    assert stage.get_position_um() == pytest.approx((10.0, -20.0))
    assert not stage.busy()
    focus.set_position_um(4.0)
    engine.clock.now += 0.04
    assert focus.get_position_um() == pytest.approx(2.0)
    focus.stop()
    engine.clock.now += 1.0
    assert focus.get_position_um() == pytest.approx(2.0)
    assert rig.clock.now() == pytest.approx(engine.clock.now - 100.0)
    buffer = np.zeros((6, 9), np.uint8)
    assert camera.snap(buffer) == {}
    assert (buffer == 10 + 3 + 10 + 2).all()
    stage.home()
    focus.home()
    engine.clock.now += 5.0
    assert stage.get_position_um() == pytest.approx((0.0, 0.0))
    assert focus.get_position_um() == pytest.approx(0.0)
    for ask in (stage.set_origin_x, stage.set_origin_y, focus.set_origin):
        with pytest.raises(NotImplementedError):
            ask()


def test_the_clock_never_goes_back(engine) -> None:
    rig = workstation()
    core = rendered_core(rig, (6, 9))
    rig.clock.sleep(3.0)
    engine.clock.now += 1.0
    core.devices["XY"].busy()
    assert rig.clock.now() == pytest.approx(3.0)


def test_the_demo_shows_beads(engine, monkeypatch) -> None:
    told = []
    core = SimpleNamespace(setProperty=lambda *words: told.append(words))
    monkeypatch.setattr(
        rendered_microscope, "MicroManager", lambda path: SimpleNamespace(core=core, path=path)
    )
    engine.package.find_micromanager = lambda: "/somewhere"
    assert str(demo_microscope().path) == "/somewhere/MMConfig_demo.cfg"
    assert told == [("Camera", "Mode", "Fluorescent Beads")]
