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


@pytest.mark.parametrize(
    ("pitch", "depth"), [(np.array([9.9, 7.4]), np.array([300.0, 350.0, 280.0])), (9.9, 310.0)]
)
def test_jacobian_is_the_derivative_of_the_projection(pitch, depth):
    m, world = 6.4, np.array([[120.0, -80, 0], [-40, 210, 0], [15, 25, 0]])
    world[:, 2] = depth
    project = lambda p: m * p[:, :2] / pitch  # noqa: E731  (2.22)
    jacobian = servoing.point_jacobian(
        project(world), depth=depth, magnification=m, pixel_pitch=pitch
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
    stable, unstable = (np.abs(servoing.loop_poles(gain, 1.0))[0] for gain in (0.999, 1.001))
    assert stable < 1 < unstable
    np.testing.assert_allclose(np.abs(servoing.loop_poles(1.8)), [0.8, 0])  # largest first


@pytest.mark.parametrize("delay", [0.0, 0.3, 0.8, 1.0, 1.4, 2.0])
@pytest.mark.parametrize("gain", [0.3, 0.7])
def test_simulated_loop_decays_as_its_poles(gain, delay):
    weight = (INTERVAL * JACOBIAN[0, 0]) ** 2 * (1 / gain - 1)  # L for this loop gain
    controller = servoing.OptimalController(
        JACOBIAN, interval=INTERVAL, feature_weight=(1.0, 1.0), control_weight=(weight, weight)
    )
    camera = servoing.CameraTiming(interval=INTERVAL, latency=delay * INTERVAL)
    stage = servoing.StageModel(saturation=1e9, increment=0.0)
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
    camera = servoing.CameraTiming(interval=INTERVAL, latency=0.8 * INTERVAL, jitter=jitter)
    stage = servoing.StageModel(saturation=saturation)
    run = {"jacobian": JACOBIAN, "stage": stage, "camera": camera, "rng": seed} | options
    return servoing.simulate(controller, reference, **run)


def optimal():
    return servoing.OptimalController(JACOBIAN, interval=INTERVAL, **WEIGHTS)


def test_velocity_is_zero_in_a_lost_frame_and_leads_to_the_next_reference_else():
    ahead = np.outer(np.arange(4.0), [1.0, -2.0])  # the reference of the next samples
    for lost in ((np.nan, np.nan), (7.0, np.nan)):
        assert not optimal()(1, lost, ahead).any()
    for k, wanted in enumerate(ahead[[1, 2, 3, 3]]):
        np.testing.assert_allclose(optimal()(k, np.zeros(2), ahead), optimal().gain @ wanted)


def test_jitter_has_the_stated_standard_deviation_and_seed_equals_generator():
    path = np.linspace((3.0, -2.0), (5.0, 4.0), 2000)

    def shaken(rng, **options):
        camera = servoing.CameraTiming(interval=0.5, jitter=0.3)
        still = lambda *_: np.zeros(2)  # noqa: E731
        return loop(still, path, camera=camera, rng=rng, **options)

    run, seen = shaken(4), shaken(np.random.default_rng(4), observer=lambda feature: 2 * feature)
    np.testing.assert_array_equal(2 * run.measured, seen.measured)
    np.testing.assert_array_equal(run.feature, path[[0] * 2000])  # where the path begins
    # 2000 numbers per axis determine a standard deviation to 1.6 %; three times that is allowed.
    np.testing.assert_allclose((run.measured - path[0]).std(axis=0), 0.3, rtol=0.05)
    np.testing.assert_allclose(run.time[[0, 1, -1]], [0.0, 0.5, 999.5])


def test_command_is_clipped_on_each_axis_and_rejected_if_not_finite():
    asked = np.array([[500.0, 0.0], [0.0, -900.0], [300.0, -300.0]])
    run = loop(lambda k, *_: asked[k], np.zeros((3, 2)))
    np.testing.assert_array_equal(run.command, asked.clip(-400, 400))
    np.testing.assert_array_equal(run.saturated, [True, True, False])
    # A fifth of a frame at 400 µm/s, in increments of 0.05 µm.
    assert run.position[1, 0] == pytest.approx(2.4)
    with pytest.raises(ValueError, match="command must be finite"):
        loop(lambda *_: np.full(2, np.nan), np.zeros((3, 2)))
    with pytest.raises(ValueError, match="within ±7500 µm of the start, got 7501 µm"):
        loop(optimal(), [[9.0, 9.0], [9.0, 9.0 - 7501 * JACOBIAN[1, 1]]])


def test_log_and_reference_stay_where_a_controller_works_in_place():
    wanted = np.full((5, 2), 5.0)

    def in_place(k, measured, reference):
        measured -= reference[k]
        return -10 * measured

    run = loop(in_place, wanted, jacobian=np.eye(2), start=(0, 0))
    np.testing.assert_array_equal(run.measured, run.feature)  # a camera without jitter
    np.testing.assert_array_equal(run.command[0], [50.0, 50.0])
    wanted[:] = 7.0
    np.testing.assert_array_equal(run.reference, np.full((5, 2), 5.0))

    def overwriting(k, measured, reference):
        reference[:] = 0.0

    with pytest.raises(ValueError, match="read-only"):
        loop(overwriting, wanted)


def test_runs_simulated_at_once_equal_those_simulated_alone():
    """The delay is more than a frame, and the feature is lost in some frames."""
    law = optimal()
    path = np.cumsum(np.random.default_rng(1).normal(0, 2, (40, 2)), axis=0)
    matrices = JACOBIAN * np.array([0.9, 1.0, 1.2])[:, None, None]
    starts = path[0] + [[3.0, 0.0], [0.0, 0.0], [-40.0, 9.0]]
    lost = np.random.default_rng(2).random((40, 3)) < 0.2
    lost[0, 1] = True

    def simulated(runs, **options):
        frames = iter(lost)

        def look(feature):
            return np.where(next(frames)[runs, None], np.nan, feature)

        camera = servoing.CameraTiming(INTERVAL, latency=1.4 * INTERVAL, jitter=0.1)
        given = {"stage": servoing.StageModel(saturation=400.0), "start": starts[runs]} | options
        given |= {"camera": camera, "jacobian": matrices[runs], "observer": look}
        return servoing.simulate(law, path, **given)

    together = simulated(np.arange(3), rng=[np.random.default_rng(k) for k in range(3)])
    for k in range(3):
        alone = simulated([k], rng=[np.random.default_rng(k)])
        for name in ("feature", "measured", "position", "command", "saturated"):
            both = getattr(together, name)[k], getattr(alone, name)[0]
            np.testing.assert_allclose(*both, atol=1e-9)
    np.testing.assert_array_equal(np.isnan(together.measured[..., 0]), lost.T)
