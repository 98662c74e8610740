"""What must hold over a microscope: a selection of what `benchmarks.microscope` runs in full."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from compendium.experiments.microscope import (
    FAULTS,
    Fault,
    Injected,
    _Faulty,
    inject,
    interrupt_after,
    make_scope,
    reach,
)

HERE = importlib.util.find_spec("pymmcore_plus") is not None
ENGINE = pytest.mark.skipif(not HERE, reason="pymmcore-plus is not installed")
FEW = ("camera hangs", "frozen", "move hangs", "never arrives", "reversed", "stop fails twice")


@pytest.mark.parametrize(
    ("kind", "seeds"),
    [
        ("simulated", range(100, 108)),
        pytest.param("engine", range(100, 103), marks=ENGINE),
        pytest.param("demo", range(100, 102), marks=ENGINE),
    ],
)
def test_targets_are_reached_whatever_the_turn_the_mirror_and_the_scale(kind, seeds) -> None:
    runs = [reach(kind, seed) for seed in seeds]
    errors = [run["error"] for run in runs]
    assert all(run["reached"] for run in runs)
    # The limits of the benchmark's 40 runs: the tolerance of 0.05 px and what the tracker is wrong.
    assert np.max(errors) <= 0.12
    assert np.mean(errors) <= 0.05
    assert max(run["steps"] for run in runs) <= 3


def test_both_stages_behind_one_truth_log_the_same() -> None:
    pytest.importorskip("pymmcore_plus")
    logs = [reach(kind, 100)["run"].log for kind in ("simulated", "engine")]
    assert (logs[0].dtypes == logs[1].dtypes).all()
    assert logs[0]["phase"].tolist() == logs[1]["phase"].tolist()
    # The same frames but for their noise, which is that of another draw.
    names = ["measured_x_px", "measured_y_px"]
    np.testing.assert_allclose(logs[0][names][:9], logs[1][names][:9], atol=0.3)


def spoiled(name, first=0) -> _Faulty:
    """Return a microscope with a fault from that frame on; its next frame is the first."""
    faulty = _Faulty(make_scope("simulated", 3), Fault(name, "stage", first))
    faulty.frames = 0
    return faulty


def test_pictures_are_spoiled_from_their_frame_on() -> None:
    frame, exposed = spoiled("none").snap()
    assert exposed > 0
    assert not spoiled("black").snap()[0].any()
    assert spoiled("black", first=2).snap()[0].any()
    noise = spoiled("noise").snap()[0]
    assert (noise.shape, noise.dtype) == (frame.shape, frame.dtype)
    # Of even levels: 255/√12.
    assert noise.std() == pytest.approx(73.6, rel=0.02)
    assert spoiled("other size").snap()[0].shape == (frame.shape[0] - 2, frame.shape[1])
    frozen = spoiled("frozen", first=2)
    before = frozen.snap()[0]
    assert frozen.snap()[0] is before


def test_the_stage_and_what_is_asked_are_spoiled() -> None:
    for name, call in (
        ("camera error", lambda faulty: faulty.snap()),
        ("tracker error", lambda faulty: faulty.track(np.zeros((9, 9)))),
        ("position error", lambda faulty: faulty.position()),
        ("move error", lambda faulty: faulty.move_to(np.zeros(2))),
    ):
        with pytest.raises(Injected):
            call(spoiled(name))
    stuck = spoiled("stuck")
    stuck.move_to(stuck.position() + 5.0)
    assert not stuck.moving()
    back = spoiled("reversed")
    here = back.position()
    back.move_to(np.add(here, [3.0, -2.0]))
    back.clock.sleep(2.0)
    np.testing.assert_allclose(back.position(), here - [3.0, -2.0], atol=0.1)
    assert spoiled("never arrives").moving()
    stops = spoiled("stop fails twice")
    for _ in range(2):
        with pytest.raises(Injected):
            stops.stop()
    stops.stop()
    assert stops.stops == 3


def check(result) -> None:
    assert result["complete"] or result["reason"] != "done", result
    assert result["still"], result
    assert result["excursion"] <= 1.0, result
    # A move that was begun by a call that had been given up is stopped as it begins: 1000 µm/s are
    # some 0.3 px/ms here, a whole move is 10 px.
    assert result.get("coasted", 0.0) < 2.0, result


@pytest.mark.parametrize("fault", [f for f in FAULTS if f.where != "user"], ids=str)
def test_a_fault_ends_the_run_with_the_stage_standing(fault) -> None:
    result = inject("simulated", fault)
    check(result)
    assert result["run"].still == (fault.name != "never arrives")
    assert result["stopped"]


@ENGINE
@pytest.mark.parametrize("fault", [f for f in FAULTS if f.name in FEW and f.frame >= 9], ids=str)
def test_a_fault_of_the_engine_does_so_too(fault) -> None:
    check(inject("engine", fault))


@pytest.mark.parametrize("fault", [f for f in FAULTS if f.name in FEW and f.frame >= 9], ids=str)
def test_a_fault_under_a_velocity_does_so_too(fault) -> None:
    check(inject("simulated", fault, drive="velocity"))


@pytest.mark.parametrize("fault", [f for f in FAULTS if f.where == "user"], ids=str)
def test_ctrl_c_ends_the_run_with_the_stage_standing(fault) -> None:
    result = inject("simulated", fault)
    check(result)
    assert result["reason"] == "interrupted by the user"


@pytest.mark.parametrize("delay", [0.0, 0.013, 0.04, 0.09])
def test_ctrl_c_may_come_at_any_time(delay) -> None:
    check(interrupt_after("simulated", delay))
