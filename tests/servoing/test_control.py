"""The Jacobian, the control law and the loop against derivatives, a minimizer and the poles."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from microlib import servoing

INTERVAL = 1 / 33
#: px/µm at 1X: magnification over pixel size (Table 5.1); the weights of §5.4, from mm to µm.
JACOBIAN = 1.5893 / 9.9 * np.eye(2)
WEIGHTS = {"feature_weight": (0.9, 0.9), "control_weight": (0.025e-6, 0.05e-6)}


def test_jacobian_is_the_derivative_of_the_projection():
    m, cell = 6.4, np.array([9.9, 7.4])
    world = np.array([[120.0, -80, 300], [-40, 210, 350], [15, 25, 280]])
    project = lambda p: m * p[:, :2] / cell  # noqa: E731  (2.22)
    jacobian = servoing.point_jacobian(
        project(world), depth=world[:, 2], magnification=m, pixel_size=cell
    )
    step = 1e-6
    for axis in range(6):
        screw = np.zeros(6)
        screw[axis] = step
        turned = [Rotation.from_rotvec(s * screw[3:]).apply(world) + s * screw[:3] for s in (1, -1)]
        numeric = (project(turned[0]) - project(turned[1])).ravel() / (2 * step)
        # Central differences of values near 200 over 1e-6: rounding 1e-7.
        np.testing.assert_allclose(jacobian[:, axis], numeric, atol=1e-6)


@pytest.mark.parametrize("seed", range(12))
def test_optimal_control_minimizes_the_one_step_cost(seed):
    rng = np.random.default_rng(seed)
    m, n = 2 * rng.integers(1, 4), rng.integers(1, 3)
    jacobian = rng.normal(size=(m, n))
    q, weight = (a @ a.T + 0.1 * np.eye(len(a)) for a in (rng.normal(size=(k, k)) for k in (m, n)))
    feature, target = rng.normal(0, 5, (2, m))
    interval = rng.uniform(0.1, 1.0)

    def cost(u):  # (2.27) with (2.26)
        error = feature + interval * jacobian @ u - target
        return error @ q @ error + u @ weight @ u

    given = {"interval": interval, "feature_weight": q, "control_weight": weight}
    ours = servoing.optimal_control(jacobian, feature, target, **given)
    theirs = minimize(cost, np.zeros(n), method="BFGS", options={"gtol": 1e-9})
    # The minimizer stops where rounding dominates its numerical gradient, about 1e-8·cost away.
    assert cost(ours) <= theirs.fun + 1e-9 * abs(theirs.fun)
    np.testing.assert_allclose(ours, theirs.x, atol=1e-4 * (1 + np.abs(theirs.x).max()))


def test_ibvs_error_decays_exponentially_and_drift_is_compensated():
    rng = np.random.default_rng(0)
    jacobian = rng.normal(size=(4, 3))
    error = jacobian @ rng.normal(size=3)  # reachable
    drift = jacobian @ rng.normal(size=3)
    change = jacobian @ servoing.ibvs_control(jacobian, error, gain=2.5, drift=drift) + drift
    np.testing.assert_allclose(change, -2.5 * error, rtol=1e-10)


def test_loop_with_one_sample_of_delay_is_stable_below_gain_one():
    stable, unstable = (np.abs(servoing.loop_poles(gain, 1.0)).max() for gain in (0.999, 1.001))
    assert stable < 1 < unstable


@pytest.mark.parametrize("delay", [0.0, 0.3, 0.8, 1.0, 1.4, 2.0])
@pytest.mark.parametrize("gain", [0.3, 0.7])
def test_simulated_loop_decays_as_its_poles(gain, delay):
    weight = (INTERVAL * JACOBIAN[0, 0]) ** 2 * (1 / gain - 1)  # L for this loop gain
    controller = servoing.OptimalController(
        JACOBIAN, interval=INTERVAL, feature_weight=(1.0, 1.0), control_weight=(weight, weight)
    )
    camera = servoing.Camera(interval=INTERVAL, latency=delay * INTERVAL)
    stage = servoing.Stage(saturation=1e9, step=0.0)
    run = loop(controller, np.zeros((160, 2)), camera=camera, stage=stage, start=(1.0, 1.0))
    error = run.feature[:, 0]

    def remainder(poles):
        """Return the largest residual of the simulated error in the recurrence with these poles."""
        return np.abs(np.convolve(error, np.poly(poles).real, mode="valid")).max()

    # A linear recurrence annihilates its own solutions, up to rounding.
    assert remainder(servoing.loop_poles(gain, delay)) < 1e-12
    assert remainder(servoing.loop_poles(gain, delay + 0.05)) > 1e-3
    assert remainder(servoing.loop_poles(1.05 * gain, delay)) > 1e-3


def loop(controller, reference, saturation=400.0, jitter=0.0, seed=0, **options):
    """Close the loop with commands that take effect 0.8 samples late."""
    camera = servoing.Camera(interval=INTERVAL, latency=0.8 * INTERVAL, jitter=jitter)
    stage = servoing.Stage(saturation=saturation)
    run = {"jacobian": JACOBIAN, "stage": stage, "camera": camera, "rng": seed} | options
    return servoing.simulate(controller, reference, **run)


def optimal():
    return servoing.OptimalController(JACOBIAN, interval=INTERVAL, **WEIGHTS)


def predictive(saturation=400.0, delay=0.8 * INTERVAL):
    given = {"interval": INTERVAL, "delay": delay, "saturation": saturation}
    return servoing.PredictiveController(JACOBIAN, **given, **WEIGHTS)


def test_predictive_controller_removes_ringing_under_delay():
    rings, calm = (
        loop(one, np.full((80, 2), 50.0), saturation=1e4, start=(0, 0))
        for one in (optimal(), predictive(1e4))
    )
    assert servoing.step_metrics(rings.time, rings.feature, (50, 50)).overshoot > 0.5
    calmed = servoing.step_metrics(calm.time, calm.feature, (50, 50))
    # Increments of 50 nm are 0.008 px of 50 px; the control weight leaves 1 to 2 ‰ of the step.
    assert calmed.overshoot < 0.005
    assert calmed.settling_time == pytest.approx(2 * INTERVAL)


def test_lost_frame_stops_optimal_and_is_bridged_by_predictive_controller():
    reference, lost = np.full((4, 2), 30.0), np.full(2, np.nan)
    assert not optimal()(1, lost, reference).any()
    ahead = np.outer(np.arange(4.0), [1.0, -2.0])  # the reference of the next samples
    for k, wanted in enumerate(ahead[[1, 2, 3, 3]]):
        np.testing.assert_allclose(optimal()(k, np.zeros(2), ahead), optimal().gain @ wanted)
    bridging = predictive(delay=0)
    assert not bridging(0, lost, reference).any()
    bridging(1, np.zeros(2), reference)
    assert (bridging(2, lost, reference) > 0).all()


def test_second_run_equals_that_of_a_new_controller():
    used, reference = predictive(delay=1.5 * INTERVAL), np.full((30, 2), 5.0)
    loop(used, np.full((30, 2), 300.0), start=(0, 0))
    runs = [loop(one, reference, start=(0, 0)) for one in (used, predictive(delay=1.5 * INTERVAL))]
    np.testing.assert_allclose(runs[0].feature, runs[1].feature, atol=1e-9)


def test_predictive_controller_accepts_several_points():
    """Three points that move alike give the command of one point of three times the weight."""
    for delay in (0.0, 0.8, 1.7):
        options = {"interval": INTERVAL, "delay": delay * INTERVAL, "saturation": 300.0}
        options["control_weight"] = (1e-6, 1e-6)
        one = servoing.PredictiveController(JACOBIAN, feature_weight=(3.0, 3.0), **options)
        stacked = np.vstack([JACOBIAN] * 3)
        three = servoing.PredictiveController(stacked, feature_weight=np.ones(6), **options)
        goals = np.tile([50.0, -20.0], (9, 1))
        for k, seen in enumerate(np.linspace([0.0, 0.0], [40.0, -10.0], 8)):
            command = one(k, seen, goals)
            assert command.shape == (2,)
            assert np.abs(command).max() <= 300.0
            np.testing.assert_allclose(
                three(k, np.tile(seen, 3), np.tile(goals, 3)), command, rtol=1e-9
            )


def test_jitter_has_the_stated_standard_deviation_and_seed_equals_generator():
    def shaken(rng):
        camera = servoing.Camera(interval=0.5, jitter=0.3)
        still = lambda *_: np.zeros(2)  # noqa: E731
        return loop(still, np.zeros((2000, 2)), camera=camera, rng=rng)

    run = shaken(4)
    np.testing.assert_array_equal(run.measured, shaken(np.random.default_rng(4)).measured)
    assert not run.feature.any()
    # 2000 numbers per axis determine a standard deviation to 1.6 %; three times that is allowed.
    np.testing.assert_allclose(run.measured.std(axis=0), 0.3, rtol=0.05)
    np.testing.assert_allclose(run.time[[0, 1, -1]], [0.0, 0.5, 999.5])


def test_command_that_is_not_finite_is_rejected():
    with pytest.raises(ValueError, match="command must be finite"):
        loop(lambda *_: np.full(2, np.nan), np.zeros((3, 2)))


@pytest.mark.parametrize("predicts", [False, True])
def test_runs_simulated_at_once_equal_those_simulated_alone(predicts):
    """With a delay of more than a frame, and frames in which the feature is lost."""
    law = predictive(delay=1.4 * INTERVAL) if predicts else optimal()
    path = np.cumsum(np.random.default_rng(1).normal(0, 2, (40, 2)), axis=0)
    matrices = JACOBIAN * np.array([0.9, 1.0, 1.2])[:, None, None]
    starts = path[0] + [[3.0, 0.0], [0.0, 0.0], [-40.0, 9.0]]
    lost = np.random.default_rng(2).random((40, 3)) < 0.2
    lost[0, 1] = True

    def simulated(runs, **options):
        frames = iter(lost)

        def look(feature):
            return np.where(next(frames)[runs, None], np.nan, feature)

        camera = servoing.Camera(INTERVAL, latency=1.4 * INTERVAL, jitter=0.1)
        given = {"stage": servoing.Stage(saturation=400.0), "camera": camera, "start": starts[runs]}
        return servoing.simulate(
            law, path, jacobian=matrices[runs], observer=look, **given, **options
        )

    together = simulated(np.arange(3), rng=[np.random.default_rng(k) for k in range(3)])
    for k in range(3):
        alone = simulated([k], rng=[np.random.default_rng(k)])
        for name in ("feature", "measured", "position", "command", "saturated"):
            both = getattr(together, name)[k], getattr(alone, name)[0]
            np.testing.assert_allclose(*both, atol=1e-9)
    np.testing.assert_array_equal(np.isnan(together.measured[..., 0]), lost.T)
