"""The injection's experiment: its truth, its faults one by one, and what it says of a run."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from compendium.experiments import injection
from compendium.experiments.injection import (
    FAULTS,
    Injected,
    Rig,
    _Faulty,
    make_rig,
    press,
    spoil,
)

#: A small egg, as in the tests of `inject`.
EGG = {"radius": 300.0, "probe_half_width": 20.0, "pixel_size": 3.5, "shape": (220, 230)}


@pytest.fixture
def rig() -> Rig:
    return make_rig(3, **EGG)


def test_the_truth_is_the_scenes_at_the_pipettes_place(rig: Rig) -> None:
    scene = rig.scene
    down = np.array([0.0, 1.0]) / scene.pixel_size
    stage = np.linalg.solve(rig.jacobian, scene.contact + 12.0 * down - scene.home)
    truth = rig.truth(stage)
    assert truth["approach"] == pytest.approx(12.0)
    assert truth["depth"] == pytest.approx(scene.depth(scene.contact + 12.0 * down))
    assert truth["force"] == pytest.approx(scene.force(scene.contact + 12.0 * down))
    log = pd.DataFrame({"stage_x_um": [0.0, stage[0]], "stage_y_um": [0.0, stage[1]]})
    pd.testing.assert_frame_equal(rig.truths(log), pd.DataFrame([rig.truth([0, 0]), truth]))
    # One px of the camera is one px of the scene: the stage's Jacobian is a turn over its size.
    np.testing.assert_allclose(
        rig.jacobian @ rig.jacobian.T, np.eye(2) / scene.pixel_size**2, atol=1e-12
    )
    np.testing.assert_array_equal(rig.workstation.feature, scene.home)


class Scene:
    """An egg whose dimple is half of the way deep and whose force goes as its square, µN."""

    def __init__(self, rng, **settings) -> None:
        self.settings, self.pixel_size, self.deepest = settings, 4.0, 200.0
        self.home, self.contact = np.array([50.0, 20.0]), np.array([50.0, 60.0])

    def way(self, tip) -> float:
        return max((tip[1] - self.contact[1]) * self.pixel_size, 0.0)

    def depth(self, tip) -> float:
        return 0.5 * self.way(tip)

    def force(self, tip) -> float:
        return 0.01 * self.way(tip) ** 2


def test_eggs_are_of_the_sizes_and_laws_that_are_drawn(monkeypatch) -> None:
    monkeypatch.setattr(injection, "InjectionScene", Scene)
    rigs = [make_rig(seed) for seed in range(60)]
    drawn = pd.DataFrame([rig.scene.settings for rig in rigs])
    for name, low, high in (
        ("modulus", 0.5, 2.0),
        ("radius", 520.0, 660.0),
        ("probe_half_width", 18.0, 32.0),
        ("inflation", 1.01, 1.08),
    ):
        # Of 60 the ends are within a tenth of the range but for one time in five hundred.
        assert low <= drawn[name].min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < drawn[name].max() <= high
    assert set(drawn["law"]) == {"neo-hooke", "mooney-rivlin"}
    assert (drawn["thickness"] == 3.0).all()
    np.testing.assert_allclose(drawn["strongest"], 0.06 * 3.0 * drawn["radius"])
    assert {np.sign(np.linalg.det(rig.jacobian)) for rig in rigs} == {-1.0, 1.0}
    depths = np.array([0.5 * np.sqrt(rig.target / 0.01) for rig in rigs])
    # From the shallowest that can be measured to that of 0.85 of the deepest way.
    assert 18.0 - 0.2 < depths.min() < 25
    assert 78 < depths.max() <= 85.0
    for rig in rigs[:3]:
        names = ("modulus", "thickness", "probe_half_width", "law")
        known = {name: rig.scene.settings[name] for name in names}
        assert rig.known == known | {"pixel_size": 4.0}
        assert rig.scene._rupture == pytest.approx(1.1 * rig.target)
    assert not hasattr(make_rig(0, rupture=False).scene, "_rupture")
    assert make_rig(0, radius=300.0).scene.settings["radius"] == 300.0


def run_of(rig: Rig, ways: list[float], **changes):
    """A run that went so far beyond contact, µm, in its phase of pressing."""
    down = np.array([0.0, 1.0]) / rig.scene.pixel_size
    tips = [rig.scene.contact + way * down for way in ways]
    places = np.array([np.linalg.solve(rig.jacobian, tip - rig.scene.home) for tip in tips])
    log = pd.DataFrame(places, columns=["stage_x_um", "stage_y_um"])
    log["phase"] = ["press"] * (len(ways) - 1) + ["end"]
    given = {
        "log": log, "reached": True, "reason": "", "contact": places[0], "force": 2.0,
        "depth": 30.0,
    }  # fmt: skip
    return SimpleNamespace(**given | changes)


def test_a_run_is_held_against_the_truth(monkeypatch) -> None:
    made = []

    def inject(workstation, **settings):
        rig = made[-1]
        asked.update(settings)
        return run_of(rig, [1.5, 40.0, 30.0])

    def rigged(seed, **options):
        made.append(make_rig(seed, **options))
        return made[-1]

    asked: dict = {}
    monkeypatch.setattr(injection, "inject", inject)
    monkeypatch.setattr(injection, "make_rig", rigged)
    found = press(3, egg=EGG, hold=2.0)
    rig = made[0]
    truths = rig.truths(found["run"].log)
    assert found["late"] == pytest.approx(1.5)
    assert found["force error"] == pytest.approx(2.0 / truths["force"][1] - 1)
    assert found["depth error"] == pytest.approx(30.0 / truths["depth"][1] - 1)
    assert found["strongest"] == pytest.approx(truths["force"].max() / rig.target)
    assert (found["reached"], found["reason"], found["frames"]) == (True, "", 2)
    assert asked == {"force": rig.target, "travel": 600.0, **rig.known, "hold": 2.0}

    def inject_none(workstation, **settings):
        return run_of(made[-1], [1.5, 2.0], reached=False, contact=np.full(2, np.nan))

    monkeypatch.setattr(injection, "inject", inject_none)
    none = press(3, egg=EGG)
    assert all(np.isnan(none[name]) for name in ("late", "force error", "depth error"))


def spoiled(rig: Rig, fault: str, first: int = 1) -> _Faulty:
    faulty = _Faulty(rig, fault, first)
    faulty.snap()
    return faulty


@pytest.mark.parametrize(
    ("fault", "call", "argument"),
    [
        ("camera error", "snap", ()),
        ("move error", "move_to", (np.zeros(2),)),
        ("position error", "position", ()),
    ],
)
def test_a_device_that_fails_does_so_from_its_frame_on(rig, fault, call, argument) -> None:
    faulty = spoiled(rig, fault, first=2)
    getattr(faulty, call)(*argument)
    faulty.frames = 2
    with pytest.raises(Injected):
        getattr(faulty, call)(*argument)
    other = spoiled(rig, "black", first=0)
    getattr(other, call)(*argument)


def test_pictures_are_spoiled(rig) -> None:
    plain = spoiled(rig, "none")
    frame, exposed = plain.snap()
    later, then = plain.snap()
    assert frame.shape == (220, 230)
    assert then > exposed
    assert (frame != later).any()  # noise
    assert not spoiled(rig, "black").snap()[0].any()
    noise = spoiled(rig, "noise").snap()[0]
    assert noise.dtype == frame.dtype
    assert noise.std() > 60
    frozen = spoiled(rig, "frozen")
    first = frozen._last
    assert frozen.snap()[0] is first
    lost = spoiled(rig, "pipette lost").snap()[0]
    x = round(float(rig.scene.home[0]))
    assert lost[:10, x].mean() > frame[:10, x].mean() + 50


def test_the_stage_is_spoiled(rig) -> None:
    stage = rig.workstation.stage
    stuck = spoiled(rig, "stuck", first=0)
    stuck.move_to(np.array([5.0, 5.0]))
    assert not stuck.moving()
    slips = spoiled(rig, "slips", first=0)
    np.testing.assert_array_equal(slips.position(), stage.position())
    slips.move_to(np.array([5.0, 7.0]))
    assert not stage.moving()
    np.testing.assert_array_equal(slips.position(), [5.0, 7.0])
    reverse = spoiled(rig, "reversed", first=0)
    here = stage.position()
    reverse.move_to(np.add(here, [3.0, -2.0]))
    rig.workstation.clock.sleep(1.0)
    np.testing.assert_allclose(stage.position(), here - [3.0, -2.0], atol=0.05)
    assert not reverse.moving()
    assert spoiled(rig, "never arrives", first=0).moving()
    stops = spoiled(rig, "stop fails twice", first=0)
    for _ in range(2):
        with pytest.raises(Injected):
            stops.stop()
    stops.stop()
    assert stops.stops == 3


def test_the_egg_is_spoiled(rig) -> None:
    before = rig.scene.contact.copy()
    moves = spoiled(rig, "egg moves", first=1)
    np.testing.assert_array_equal(rig.scene.contact, before)
    moves.snap()
    moves.snap()
    np.testing.assert_allclose(rig.scene.contact - before, [0.0, 1.5])
    gives = spoiled(rig, "wall gives way", first=0)
    assert gives.rig.scene._rupture == pytest.approx(0.1 * rig.target)


def test_how_a_spoiled_run_ended_is_seen_from_outside(monkeypatch) -> None:
    asked: dict = {}

    def inject(faulty, **settings):
        asked.update(settings)
        rig = faulty.rig
        run = run_of(rig, [1.0, 20.0, 10.0], reached=False, reason="lost")
        faulty.move_to(run.log[["stage_x_um", "stage_y_um"]].to_numpy()[0])
        if stops:
            faulty.clock.sleep(5.0)
            faulty.stop()
        return run

    monkeypatch.setattr(injection, "inject", inject)
    for stops in (True, False):
        found = spoil(3, "black", 9, egg=EGG, press_step=4.0)
        rig = make_rig(3, rupture=False, **EGG)
        assert found["stopped"] == stops
        assert found["still"] == stops
        assert (found["fault"], found["reason"], found["reached"]) == ("black", "lost", False)
        forces = rig.truths(run_of(rig, [1.0, 20.0, 10.0]).log)["force"]
        assert found["strongest"] == pytest.approx(forces.max() / rig.target)
    assert asked["press_step"] == 4.0
    assert (asked["travel"], asked["timeout"], asked["force"]) == (600.0, 1.0, rig.target)

    def interrupted(faulty, **settings):
        error = KeyboardInterrupt()
        error.run = run_of(faulty.rig, [1.0, 2.0], reason="interrupted")  # type: ignore[attr-defined]
        raise error

    monkeypatch.setattr(injection, "inject", interrupted)
    assert spoil(3, "Ctrl-C", 9, egg=EGG)["reason"] == "interrupted"


def test_faults_of_every_part_are_named() -> None:
    assert {part: len(names) for part, names in FAULTS.items()} == {
        "camera": 6, "stage": 8, "egg": 2, "user": 1
    }  # fmt: skip
