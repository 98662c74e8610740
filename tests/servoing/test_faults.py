"""Whatever fails, the run ends with the stage standing within its travel, and says why."""

from __future__ import annotations

import importlib.util
import os
import signal
import threading

import numpy as np
import pytest

from compendium.experiments.microscope import make_scope, reach, reach_on
from microlib.servoing import Stage, servo
from tests.servoing.faults import FAULTS, WAY, engine_scope, run_with

HERE = importlib.util.find_spec("pymmcore_plus") is not None
ENGINE = pytest.mark.skipif(not HERE, reason="pymmcore-plus is not installed")
FEW = ("camera hangs", "frozen", "move hangs", "never arrives", "reversed", "stop fails twice")


def check(outcome) -> None:
    run = outcome.run
    assert run.reached.all() or run.reason
    assert run.log["event"].iloc[-1] == (run.reason or "done")
    assert outcome.still
    assert outcome.stops > 0
    assert outcome.excursion <= 1.0
    # A move that was begun by a call that had been given up is stopped as it begins: 1000 µm/s are
    # some 0.3 px/ms here, a whole move is 10 px.
    assert outcome.coasted < 2.0


@pytest.mark.parametrize(("fault", "frame"), FAULTS)
def test_a_fault_ends_the_run_with_the_stage_standing(fault, frame) -> None:
    outcome = run_with(fault, frame)
    check(outcome)
    assert outcome.run.still == (fault != "never arrives")
    if fault.startswith("Ctrl-C"):
        assert outcome.run.reason == "interrupted by the user"
    if fault.endswith("error") or fault.endswith("hangs"):
        assert outcome.run.error is not None or "did not answer" in outcome.run.reason


@ENGINE
@pytest.mark.parametrize("fault", FEW)
def test_a_fault_of_the_engine_does_so_too(fault) -> None:
    check(run_with(fault, 10, engine=True))


@pytest.mark.parametrize("delay", [0.0, 0.013, 0.04, 0.09])
def test_ctrl_c_may_come_at_any_time(delay) -> None:
    scope = make_scope(0, stage=Stage(saturation=1000.0))
    tracker = scope.tracker()
    timer = threading.Timer(delay, lambda: os.kill(os.getpid(), signal.SIGINT))
    # Before and after the run the signal does nothing, so that it cannot end the test.
    before = signal.signal(signal.SIGINT, lambda *_: None)
    ended = None
    try:
        timer.start()
        servo(scope.workstation, tracker, scope.home + WAY, travel=400.0, test_move=20.0)
    except KeyboardInterrupt as interrupt:
        ended = interrupt.run
    finally:
        timer.cancel()
        timer.join()
        signal.signal(signal.SIGINT, before)
    assert not scope.workstation.stage.moving()
    assert ended is None or (ended.still and ended.reason == "interrupted by the user")


def check_runs(runs) -> None:
    assert all(run["reached"] for run in runs)
    # The tolerance of 0.05 px and what the tracker is wrong.
    assert max(run["error"] for run in runs) <= 0.12
    assert np.mean([run["error"] for run in runs]) <= 0.05
    assert max(run["steps"] for run in runs) <= 3


def test_targets_are_reached_whatever_the_turn_the_mirror_and_the_scale() -> None:
    check_runs([reach(seed) for seed in range(100, 108)])


@ENGINE
def test_they_are_so_behind_the_engine_and_on_its_demo() -> None:
    check_runs([reach_on(engine_scope(seed), seed) for seed in range(100, 103)])
    check_runs([reach(None)])
