"""An injection: contact, force and depth beside truth, and how each fault ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compendium.experiments.injection import RUPTURE, TRAVEL, make_rig, press, spoil
from microlib._common import EndRun
from microlib.automation import inject
from microlib.automation._press import COLUMNS, Press
from microlib.automation._sight import see

#: A small egg, whose pictures are quickly made and looked at; the benchmark has usual ones.
EGG = {"radius": 300.0, "probe_half_width": 20.0, "pixel_size": 3.5, "shape": (220, 230)}
SEED = 3


def rig_of(**options):
    return make_rig(SEED, **(EGG | options))


@pytest.fixture(scope="module")
def pressed():
    return press(SEED, egg=EGG, keep_frames=True, approach_step=0.7)


def test_the_target_is_reached_and_the_contact_seen_where_it_is(pressed):
    run = pressed["run"]
    assert run.reached
    assert run.reason == ""
    assert run.still
    # The limits of the task; the benchmark has the distribution over a hundred eggs.
    assert 0 < pressed["late"] < 2
    assert abs(pressed["force error"]) < 0.1
    assert abs(pressed["depth error"]) < 0.1
    assert pressed["strongest"] < RUPTURE
    assert run.force_std < 0.05 * run.force


def test_every_frame_is_logged_in_its_phase(pressed):
    run = pressed["run"]
    log = run.log
    assert {name: str(kind) for name, kind in log.dtypes.items()} == COLUMNS
    assert list(log["phase"].unique()) == [
        "start", "calibration", "line up", "approach", "press", "withdraw", "end"
    ]  # fmt: skip
    assert (np.diff(log["time_s"]) >= 0).all()
    assert len(run.frames) == len(log) - 1
    assert log["event"].iloc[-1] == "done"
    assert (log["event"] == "contact").sum() == 1
    # It hangs where it began to come down, and the egg is free.
    rig = pressed["rig"]
    assert rig.truth(rig.workstation.stage.position())["approach"] < -20
    back = log.query("phase == 'withdraw'")["approach_um"]
    assert (np.diff(back) < 0).all()


def test_force_and_depth_grow_with_the_way_as_the_truth_does(pressed):
    rig = pressed["rig"]
    rows = pressed["run"].log.query("phase == 'press' and force_uN == force_uN")
    places = rows[["stage_x_um", "stage_y_um"]].to_numpy()
    truth = [rig.truth(place) for place in places]
    assert len(rows) >= 2
    # A tenth at a dimple of 4 px, where the outline leaves 2 % open and the fit leans by 5.
    np.testing.assert_allclose(rows["force_uN"], [t["force"] for t in truth], rtol=0.1)
    np.testing.assert_allclose(rows["depth_um"], [t["depth"] for t in truth], rtol=0.1)


def test_a_depth_is_pressed_to_without_a_modulus():
    rig = rig_of()
    known = {name: value for name, value in rig.known.items() if name != "modulus"}
    known |= {"jacobian": rig.jacobian, "travel": TRAVEL, "approach_step": 1.0}
    run = inject(rig.workstation, depth=10.0, **known)
    assert run.reached
    assert np.isnan(run.force)
    true = rig.truth(run.log.query("phase == 'press'")[["stage_x_um", "stage_y_um"]].iloc[-1])
    # Below 4 px it is where the pipette's end is seen below the crests: to a third of a px.
    assert true["depth"] == pytest.approx(10.0, abs=1.5)


@pytest.mark.parametrize(
    ("fault", "moment", "reason"),
    [
        ("black", "approach", "lost: image must show one dark probe"),
        ("frozen", "approach", "got the one before again"),
        ("pipette lost", "start", "lost: image must show"),
        ("stuck", "approach", "the stage stands"),
        ("slips", "approach", "the image does not follow the stage"),
        ("reversed", "approach", "the stage stands"),
        ("egg moves", "approach", "the egg moves before it is touched"),
        ("move error", "approach", "move_to failed: Injected: no power"),
        ("Ctrl-C", "approach", "interrupted by the user"),
    ],
)
def test_a_fault_ends_the_run_with_the_stage_stopped(fault, moment, reason):
    frame = {"start": 1, "approach": 5}[moment]
    jacobian = None if moment == "start" else rig_of().jacobian
    result = spoil(SEED, fault, frame, egg=EGG, jacobian=jacobian, approach_step=1.0)
    assert reason in result["reason"]
    assert not result["reached"]
    assert result["stopped"]
    assert result["still"]
    assert result["strongest"] < 0.2
    assert result["run"].log["event"].iloc[-1] == result["reason"]


def test_an_egg_that_gives_way_is_noticed():
    options = {"jacobian": rig_of().jacobian, "approach_step": 1.0}
    result = spoil(SEED, "wall gives way", 18, egg=EGG, **options)
    assert "springs back" in result["reason"] or "lost" in result["reason"]
    assert not result["reached"]
    assert result["still"]


def test_the_next_step_is_part_of_what_a_power_law_leaves():
    rig = rig_of()
    given = {"press_step": 50.0, "approach_step": 0.5, "target": 8.0, "direction": "top"}
    given["pixel_size"] = 4.0
    plan = type("Plan", (), given)()
    loop = Press(rig.workstation, None, plan)  # type: ignore[arg-type]
    # Nothing known: a pixel, which is more than the dimple can grow by.
    assert loop._next_step([], 0.0) == 4.0
    # 1 at 10 and 2 at 20 is a line: 8 comes at 80.
    assert loop._next_step([(10.0, 1.0), (20.0, 2.0)], 20.0) == pytest.approx(0.7 * 60.0)
    # As the square: 4 at 20, and 8 at 28.3.
    found = loop._next_step([(10.0, 1.0), (20.0, 4.0)], 20.0)
    assert found == pytest.approx(0.7 * (20.0 * np.sqrt(2) - 20.0))
    assert loop._next_step([(20.0, 7.999)], 20.0) == 0.5


def test_a_pixel_size_that_is_not_the_stages_is_noticed():
    rig = rig_of()
    wrong = rig.known | {"pixel_size": 1.2 * rig.known["pixel_size"]}
    run = inject(rig.workstation, force=rig.target, travel=TRAVEL, jacobian=rig.jacobian, **wrong)
    assert "pixel_size is 4.2 µm, but the stage moves 3.5" in run.reason
    assert run.still


def test_travel_is_kept_to_and_a_pipette_too_near_not_moved():
    rig = rig_of()
    run = inject(rig.workstation, force=rig.target, travel=90.0, jacobian=rig.jacobian, **rig.known)
    assert "beyond the travel" in run.reason
    assert np.abs(rig.workstation.stage.position()).max() <= 90.0
    rig = rig_of()
    rig.workstation.stage.move_to(np.linalg.solve(rig.jacobian, [0.0, 25.0]))
    rig.workstation.clock.sleep(2.0)
    before = rig.workstation.stage.position()
    run = inject(rig.workstation, force=rig.target, travel=TRAVEL, **rig.known)
    assert "the pipette must begin at least 23 px above the egg" in run.reason
    np.testing.assert_array_equal(rig.workstation.stage.position(), before)


def test_an_outline_is_seen_to_sink():
    scene = rig_of(rupture=False).scene
    down = np.array([0.0, 1.0]) / scene.pixel_size
    free = see(scene.frame(scene.contact - 20 * down), "top", None)
    pressed = see(scene.frame(scene.contact + 5 * down), "top", None)
    # Half of the way, at least, goes into the top, the rest into the bottom.
    assert 2.5 < pressed.sunk(free) * scene.pixel_size < 5.0
    assert free.radius * scene.pixel_size == pytest.approx(scene._size, rel=1e-3)
    beside = replace(pressed, outline=pressed.outline + 500.0)
    with pytest.raises(ValueError, match="outline near the pipette"):
        beside.sunk(free)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"depth": 5.0}, "depth or force must be given, and only one of them, got both"),
        ({"force": None}, "depth or force must be given, and only one of them, got none"),
        ({"modulus": None}, "modulus must be given for a force"),
        ({"press_step": 0.1}, "press_step must be at least approach_step"),
        ({"travel": -1.0}, "travel must be positive"),
        ({"progress": 3}, "progress must be callable"),
        ({"workstation": None}, r"workstation must have camera\.snap"),
    ],
)
def test_wrong_arguments_are_refused_before_anything_moves(change, message):
    settings = {
        "workstation": rig_of().workstation, "force": 1.0, "modulus": 1.0, "travel": 100.0,
        "pixel_size": 4.0, "probe_half_width": 25.0, "thickness": 3.0,
    } | change  # fmt: skip
    with pytest.raises(ValueError, match=message):
        inject(settings.pop("workstation"), **settings)


def test_end_run_is_not_raised_to_the_caller():
    rig = rig_of()
    run = inject(rig.workstation, force=1e4, travel=1.0, **rig.known)
    assert run.reason
    assert not isinstance(run.error, EndRun)
