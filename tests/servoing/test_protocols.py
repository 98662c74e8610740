"""The calls that a loop makes, answered alike by the simulation and by Micro-Manager."""

import numpy as np
import pytest

from compendium.experiments.microscope import SHAPE, make_scope
from microlib.servoing import Camera, Stage
from tests.servoing.faults import engine_scope

BOTH = pytest.mark.parametrize("kind", ["simulated", "engine"])


def workstation(kind="simulated", **options):
    """Return what is to be steered, and the simulation that knows the truth behind it."""
    if kind != "simulated":
        pytest.importorskip("pymmcore_plus", reason="pymmcore-plus is not installed")
    scope = (engine_scope if kind == "engine" else make_scope)(0, **options)
    return scope.workstation, scope.truth


def wait(scope, mover) -> None:
    end = scope.clock.now() + 5.0
    while mover.moving() and scope.clock.now() < end:
        scope.clock.sleep(0.001)


@BOTH
def test_stage_reports_a_move_until_it_arrives(kind) -> None:
    scope, truth = workstation(kind, stage=Stage(saturation=500.0))
    scope.stage.move_to(np.array([50.0, -20.0]))
    assert scope.stage.moving()
    wait(scope, scope.stage)
    np.testing.assert_allclose(scope.stage.position(), (50.0, -20.0), atol=0.05)  # increments
    moved = truth.feature - truth._home
    np.testing.assert_allclose(moved, truth._jacobian @ (50.0, -20.0), atol=0.03)
    frame, exposed = scope.camera.snap()
    assert frame.shape == SHAPE
    assert exposed <= scope.clock.now()


@BOTH
def test_stop_ends_a_move_at_the_current_position(kind) -> None:
    scope, _ = workstation(kind, stage=Stage(saturation=100.0))
    scope.stage.move_to(np.array([300.0, 0.0]))
    scope.clock.sleep(0.1)
    scope.stage.stop()
    where = scope.stage.position()
    assert not scope.stage.moving()
    assert 5.0 < where[0] < 150.0  # 10 µm after 0.1 s, with room for a slow machine
    scope.clock.sleep(0.05)
    np.testing.assert_array_equal(scope.stage.position(), where)


def test_simulated_feature_drifts_and_stage_stays_within_travel() -> None:
    scope, _ = workstation(stage=Stage(saturation=50.0, step=0.0, travel=20.0), drift=(1.0, -2.0))
    scope.stage.move_to(np.array([2.0, -400.0]))
    scope.clock.sleep(0.2)
    np.testing.assert_allclose(scope.stage.position(), (2.0, -10.0))
    drifted = scope.feature - scope._home - scope._jacobian @ (2.0, -10.0)
    np.testing.assert_allclose(drifted, (0.2, -0.4))
    assert scope.stage.moving()
    scope.clock.sleep(10.0)
    np.testing.assert_allclose(scope.stage.position(), (2.0, -20.0))
    assert not scope.stage.moving()


def test_exposures_are_one_interval_apart_and_frames_return_after_the_latency() -> None:
    scope, _ = workstation(camera=Camera(interval=0.25, latency=0.1))
    times = [scope.camera.snap()[1] for _ in range(3)]
    np.testing.assert_allclose(times, [0.0, 0.25, 0.5])
    assert scope.clock.now() == pytest.approx(0.6)
