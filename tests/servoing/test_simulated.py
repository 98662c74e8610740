"""The simulated workstation answers as a microscope does."""

import numpy as np
import pytest

from microlib.servoing import CameraTiming, StageModel
from tests.scenes.microscope import simulated_scope


def workstation(**options):
    return simulated_scope(0, **options).workstation


def test_stage_reports_a_move_until_it_arrives():
    scope = workstation(stage=StageModel(saturation=500.0))
    home = scope.feature
    scope.stage.move_to(np.array([50.0, -20.0]))
    scope.clock.sleep(0.099)
    assert scope.stage.moving()
    scope.clock.sleep(0.002)
    assert not scope.stage.moving()
    np.testing.assert_allclose(scope.stage.position(), (50.0, -20.0), atol=0.05)  # increments
    rounded = StageModel(saturation=1.0).rounded(np.array([0.024, 0.026, -1.31]))
    np.testing.assert_allclose(rounded, [0.0, 0.05, -1.3], atol=1e-12)
    moved = scope.feature - home
    np.testing.assert_allclose(moved, scope._jacobian @ (50.0, -20.0), atol=0.03)
    scope.stage.move_to(np.array([9e3, -9e3]))
    scope.clock.sleep(99.0)
    np.testing.assert_array_equal(scope.stage.position(), (7500.0, -7500.0))  # 15 mm in all


def test_simulated_feature_drifts_and_stage_stops_at_once_and_stays_within_travel():
    scope = workstation(
        stage=StageModel(saturation=50.0, increment=0.0, travel=20.0), drift=(1.0, -2.0)
    )
    scope.stage.move_to(np.array([2.0, -400.0]))
    scope.clock.sleep(0.2)
    np.testing.assert_allclose(scope.stage.position(), (2.0, -10.0))
    drifted = scope.feature - scope._home - scope._jacobian @ (2.0, -10.0)
    np.testing.assert_allclose(drifted, (0.2, -0.4))
    assert scope.stage.moving()
    scope.clock.sleep(10.0)
    np.testing.assert_allclose(scope.stage.position(), (2.0, -20.0))
    scope.stage.move_to(np.array([300.0, 0.0]))
    scope.clock.sleep(0.1)
    scope.stage.stop()
    assert not scope.stage.moving()
    scope.clock.sleep(0.05)
    np.testing.assert_allclose(scope.stage.position(), (7.0, -15.0))


def test_exposures_are_one_interval_apart_and_frames_return_after_the_latency():
    scope = workstation(camera=CameraTiming(interval=0.25, latency=0.1))
    times = [scope.camera.snap()[1] for _ in range(3)]
    np.testing.assert_allclose(times, [0.0, 0.25, 0.5])
    assert scope.clock.now() == pytest.approx(0.6)


def test_jitter_of_frames_has_the_stated_standard_deviation():
    seen, camera = [], CameraTiming(interval=0.1, jitter=0.3)
    scope = workstation(camera=camera)
    scope._render = lambda feature: (seen.append(feature), np.zeros((9, 9)))[1]
    for _ in range(1000):
        scope.camera.snap()
    # 1000 numbers per axis determine a standard deviation to 2.2 %; three times that is allowed.
    np.testing.assert_allclose(np.std(seen, axis=0), 0.3, rtol=0.07)
