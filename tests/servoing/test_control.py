"""The Jacobian, the control law and the loop against derivatives, a minimizer and the poles."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from microlib.servoing import (
    Camera,
    OptimalController,
    PredictiveController,
    Stage,
    ibvs_control,
    loop_poles,
    optimal_control,
    path_metrics,
    point_jacobian,
    simulate,
    step_metrics,
)

INTERVAL = 1 / 33
#: px/µm at 1X: magnification over cell (Table 5.1), and the weights of §5.4 turned from mm to µm.
JACOBIAN = 1.5893 / 9.9 * np.eye(2)
WEIGHTS = {"feature_weight": (0.9, 0.9), "control_weight": (0.025e-6, 0.05e-6)}


def gain_of(jacobian, **options):
    return OptimalController(jacobian, **options).gain


def test_jacobian_is_the_derivative_of_the_projection():
    m, cell = 6.4, np.array([9.9, 7.4])
    world = np.array([[120.0, -80, 300], [-40, 210, 350], [15, 25, 280]])
    project = lambda p: m * p[:, :2] / cell  # noqa: E731  (2.22)
    jacobian = point_jacobian(project(world), depth=world[:, 2], magnification=m, pixel_size=cell)
    step = 1e-6
    for axis in range(6):
        screw = np.zeros(6)
        screw[axis] = step
        turned = [Rotation.from_rotvec(s * screw[3:]).apply(world) + s * screw[:3] for s in (1, -1)]
        numeric = (project(turned[0]) - project(turned[1])).ravel() / (2 * step)
        # Central differences of values near 200 over 1e-6: rounding 1e-7.
        np.testing.assert_allclose(jacobian[:, axis], numeric, atol=1e-6)


def test_one_depth_does_for_many_points():
    points = [(1.0, 2.0), (3.0, 4.0), (5.0, 7.0)]
    optics = {"magnification": 2.0, "pixel_size": 8.0}
    np.testing.assert_array_equal(
        point_jacobian(points, depth=60.0, **optics),
        point_jacobian(points, depth=(60.0, 60.0, 60.0), **optics),
    )


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 10**6), points=st.integers(1, 3), motions=st.integers(1, 2))
def test_the_control_minimizes_the_cost(seed, points, motions):
    rng = np.random.default_rng(seed)
    m, n = 2 * points, motions
    jacobian = rng.normal(size=(m, n))
    q, weight = (a @ a.T + 0.1 * np.eye(len(a)) for a in (rng.normal(size=(k, k)) for k in (m, n)))
    feature, target = rng.normal(0, 5, (2, m))
    interval = rng.uniform(0.1, 1.0)

    def cost(u):  # (2.27) with (2.26)
        error = feature + interval * jacobian @ u - target
        return error @ q @ error + u @ weight @ u

    ours = optimal_control(
        jacobian, feature, target, interval=interval, feature_weight=q, control_weight=weight
    )
    theirs = minimize(cost, np.zeros(n), method="BFGS", options={"gtol": 1e-9})
    # The minimizer stops where its numerical gradient drowns in rounding, about 1e-8·cost away.
    assert cost(ours) <= theirs.fun + 1e-9 * abs(theirs.fun)
    np.testing.assert_allclose(ours, theirs.x, atol=1e-4 * (1 + np.abs(theirs.x).max()))


def test_scalar_pole_is_that_of_the_derivation():
    t, j, q, weight = 0.03, 5.0, 0.9, 0.01
    gain = gain_of([[j]], interval=t, feature_weight=[q], control_weight=[weight])
    pole = 1 - t * j * gain[0, 0]
    assert pole == pytest.approx(weight / (t**2 * j**2 * q + weight), rel=1e-12)


def test_the_printed_weights_mean_a_dead_beat_in_mm_and_minutes_in_um():
    def pole(scale):
        gain = gain_of(
            scale * JACOBIAN,
            interval=INTERVAL,
            feature_weight=(0.9, 0.9),
            control_weight=(0.025, 0.05),
        )
        return (1 - INTERVAL * scale * JACOBIAN @ gain)[0, 0]

    assert pole(1000.0) == pytest.approx(0.00117, abs=2e-5)  # px/mm: gone in one sample
    slow = INTERVAL / -np.log(pole(1.0))
    assert slow == pytest.approx(35.5, abs=0.2)  # px/µm: a time constant of half a minute


def test_ibvs_decays_exponentially_and_compensates_a_drift():
    rng = np.random.default_rng(0)
    jacobian = rng.normal(size=(4, 3))
    error = jacobian @ rng.normal(size=3)  # reachable
    drift = jacobian @ rng.normal(size=3)
    change = jacobian @ ibvs_control(jacobian, error, gain=2.5, drift=drift) + drift
    np.testing.assert_allclose(change, -2.5 * error, rtol=1e-10)


def test_one_sample_of_delay_is_stable_below_a_gain_of_one():
    assert np.abs(loop_poles(0.999, 1.0)).max() < 1 < np.abs(loop_poles(1.001, 1.0)).max()
    assert abs(loop_poles(0.3)[0]) == pytest.approx(0.7)


@pytest.mark.parametrize("delay", [0.0, 0.3, 0.8, 1.0, 1.4, 2.0])
@pytest.mark.parametrize("gain", [0.3, 0.7])
def test_the_simulated_loop_obeys_its_poles(gain, delay):
    weight = (INTERVAL * JACOBIAN[0, 0]) ** 2 * (1 / gain - 1)  # the L that makes this loop gain
    controller = OptimalController(
        JACOBIAN, interval=INTERVAL, feature_weight=(1.0, 1.0), control_weight=(weight, weight)
    )
    run = simulate(
        controller,
        np.zeros((160, 2)),
        jacobian=JACOBIAN,
        stage=Stage(saturation=1e9, step=0.0),
        camera=Camera(interval=INTERVAL, latency=delay * INTERVAL),
        rng=np.random.default_rng(0),
        start=(1.0, 1.0),
    )
    error = run.feature[:, 0]

    def remainder(poles):
        """What the recurrence with these poles leaves of the simulated error."""
        return np.abs(np.convolve(error, np.poly(poles).real, mode="valid")).max()

    # A linear recurrence annihilates its own solutions, up to rounding.
    assert remainder(loop_poles(gain, delay)) < 1e-12
    assert remainder(loop_poles(gain, delay + 0.05)) > 1e-3
    assert remainder(loop_poles(1.05 * gain, delay)) > 1e-3


def step_run(controller, *, latency=0.0, jitter=0.0, seed=0, saturation=400.0, count=80):
    return simulate(
        controller,
        np.full((count, 2), 50.0),
        jacobian=JACOBIAN,
        stage=Stage(saturation=saturation),
        camera=Camera(interval=INTERVAL, latency=latency, jitter=jitter),
        rng=np.random.default_rng(seed),
        start=(0, 0),
    )


def test_prediction_removes_the_ringing_of_a_delay():
    latency = 0.8 * INTERVAL
    plain = OptimalController(JACOBIAN, interval=INTERVAL, **WEIGHTS)
    knowing = PredictiveController(
        JACOBIAN, interval=INTERVAL, **WEIGHTS, delay=latency, saturation=1e4
    )
    rings = step_run(plain, latency=latency, saturation=1e4)
    calm = step_run(knowing, latency=latency, saturation=1e4)
    ringing = step_metrics(rings.time, rings.feature, (50, 50))
    calmed = step_metrics(calm.time, calm.feature, (50, 50))
    assert ringing.overshoot > 0.5
    # Increments of 50 nm are 0.008 px of 50; the rest of the gain, 1 ‰ of a step.
    assert calmed.overshoot < 0.005
    assert calmed.settling_time == pytest.approx(2 * INTERVAL)


def test_prediction_follows_a_noisy_path_closer():
    latency = 0.8 * INTERVAL
    arc = np.arange(0, 320, 40 * INTERVAL)  # once around a square of 80 px at 40 px/s
    corners = 60 + np.array([[0, 0], [80, 0], [80, 80], [0, 80], [0, 0]])
    path = np.column_stack([np.interp(arc, 80 * np.arange(5), x) for x in corners.T])
    errors = {}
    for name in ("plain", "knowing"):
        runs = []
        for seed in range(5):
            controller = (
                OptimalController(JACOBIAN, interval=INTERVAL, **WEIGHTS)
                if name == "plain"
                else PredictiveController(
                    JACOBIAN, interval=INTERVAL, **WEIGHTS, delay=latency, saturation=400.0
                )
            )
            run = simulate(
                controller,
                path,
                jacobian=JACOBIAN,
                stage=Stage(saturation=400.0),
                camera=Camera(interval=INTERVAL, latency=latency, jitter=0.1),
                rng=np.random.default_rng(seed),
            )
            runs.append(path_metrics(run.feature, run.reference).accuracy)
        errors[name] = np.mean(runs)
    assert errors["knowing"] < 0.5 * errors["plain"]


def test_a_lost_frame_stops_the_one_and_is_bridged_by_the_other():
    reference = np.full((4, 2), 30.0)
    lost = np.full(2, np.nan)
    plain = OptimalController(JACOBIAN, interval=INTERVAL, **WEIGHTS)
    assert not plain(1, lost, reference).any()
    knowing = PredictiveController(JACOBIAN, interval=INTERVAL, **WEIGHTS, delay=0, saturation=400)
    assert not knowing(0, lost, reference).any()
    knowing(1, np.zeros(2), reference)
    assert (knowing(2, lost, reference) > 0).all()


def test_prediction_of_several_points_needs_as_many_rows_and_two_velocities():
    """Three points that move alike are one point three times: the same command, whatever the
    delay."""
    for delay in (0.0, 0.8, 1.7):
        options = {"interval": INTERVAL, "delay": delay * INTERVAL, "saturation": 300.0}
        one = PredictiveController(
            JACOBIAN, feature_weight=(3.0, 3.0), control_weight=(1e-6, 1e-6), **options
        )
        three = PredictiveController(
            np.vstack([JACOBIAN] * 3),
            feature_weight=np.ones(6), control_weight=(1e-6, 1e-6), **options,
        )  # fmt: skip
        goals = np.tile([50.0, -20.0], (9, 1))
        for k, seen in enumerate(np.linspace([0.0, 0.0], [40.0, -10.0], 8)):
            command = one(k, seen, goals)
            assert command.shape == (2,)
            np.testing.assert_allclose(
                three(k, np.tile(seen, 3), np.tile(goals, 3)), command, rtol=1e-9
            )


@pytest.mark.parametrize("weight", [(0.9, 0.0), (0.9, -1.0), [[1.0, 2.0], [2.0, 1.0]]])
@pytest.mark.parametrize("name", ["feature_weight", "control_weight"])
def test_refuses_weights_that_are_not_positive(name, weight):
    given = {"interval": 0.03, "feature_weight": (1, 1), "control_weight": (1, 1), name: weight}
    with pytest.raises(ValueError, match=f"{name} must be positive definite"):
        optimal_control(np.eye(2), (0, 0), (1, 1), **given)


@pytest.mark.parametrize("jacobian", [[[1, 2], [2, 4]], np.zeros((2, 2))])
def test_refuses_a_jacobian_that_does_not_show_a_motion(jacobian):
    with pytest.raises(ValueError, match="jacobian must have full rank"):
        ibvs_control(jacobian, (1, 1), gain=1.0)
    with pytest.raises(ValueError, match="jacobian must have full rank"):
        gain_of(jacobian, interval=1.0, feature_weight=(1, 1), control_weight=(1, 1))
