"""The simulated stage against an integrator, and the loop closed over rendered frames."""

import numpy as np
import pytest

from microlib.servoing import (
    Camera,
    OptimalController,
    Stage,
    simulate,
    step_metrics,
)

INTERVAL = 1 / 33
JACOBIAN = 1.5893 / 9.9 * np.eye(2)
LOOP = {"jacobian": JACOBIAN, "stage": Stage(saturation=400.0), "camera": Camera(INTERVAL)}


def controller():
    weights = {"feature_weight": (0.9, 0.9), "control_weight": (0.025e-6, 0.05e-6)}
    return OptimalController(JACOBIAN, interval=INTERVAL, **weights)


def test_positions_come_in_increments():
    quantized = Stage(saturation=1.0).rounded(np.array([0.024, 0.026, -1.31]))
    np.testing.assert_allclose(quantized, [0.0, 0.05, -1.3], atol=1e-12)


def test_a_command_takes_effect_after_the_latency():
    seen = []

    def pulse(k, measured, reference):
        seen.append(measured.copy())
        return np.array([330.0, 0.0]) if k == 0 else np.zeros(2)

    stage, camera = Stage(saturation=1e3, step=0.0), Camera(INTERVAL, latency=1.25 * INTERVAL)
    run = simulate(pulse, np.zeros((5, 2)), jacobian=np.eye(2), stage=stage, camera=camera, rng=0)
    # 10 µm in all: three quarters of them in the second interval, the rest in the third.
    np.testing.assert_allclose(run.position[:, 0], [0, 0, 7.5, 10, 10], atol=1e-9)
    np.testing.assert_array_equal(seen, run.measured)


def test_a_seed_does_for_a_generator_and_shakes_the_image_by_the_jitter():
    def shaken(rng):
        loop = {"stage": Stage(saturation=1.0), "camera": Camera(interval=0.5, jitter=0.3)}
        still = lambda *_: np.zeros(2)  # noqa: E731
        return simulate(still, np.zeros((2000, 2)), jacobian=np.eye(2), rng=rng, **loop)

    run = shaken(4)
    np.testing.assert_array_equal(run.measured, shaken(np.random.default_rng(4)).measured)
    assert not run.feature.any()
    # 2,000 numbers an axis know a standard deviation to 1.6 %; three times that.
    np.testing.assert_allclose(run.measured.std(axis=0), 0.3, rtol=0.05)
    np.testing.assert_allclose(run.time[[0, 1, -1]], [0.0, 0.5, 999.5])


def test_the_start_is_saturated_and_the_end_is_not():
    run = simulate(controller(), np.full((60, 2), 50.0), start=(0, 0), rng=0, **LOOP)
    metrics = step_metrics(run.time, run.feature, (50, 50))
    # 311 µm at 400 µm/s are 0.78 s; the last sample before is within the band of 5 %.
    assert metrics.settling_time == pytest.approx(0.95 * 311.5 / 400, abs=INTERVAL)
    slow = int(np.flatnonzero(~run.saturated)[0])
    assert run.saturated[:slow].all()
    assert not run.saturated[slow:].any()
    assert np.abs(run.command).max() == 400.0
    np.testing.assert_allclose(run.feature[-1], (50, 50), atol=0.01)  # an increment is 0.008 px


def test_refuses_a_reference_beyond_the_travel_and_a_command_that_is_none():
    loop = {"jacobian": np.eye(2), "stage": Stage(1.0), "camera": Camera(0.1), "rng": 0}
    with pytest.raises(ValueError, match="reference must lie within"):
        simulate(controller(), np.full((3, 2), 9e4), start=(0, 0), **loop)
    with pytest.raises(ValueError, match="camera must have a latency of at most 200 intervals"):
        simulate(controller(), np.zeros((3, 2)), **loop | {"camera": Camera(0.1, latency=21.0)})
    with pytest.raises(ValueError, match="command must be finite"):
        simulate(lambda *_: np.full(2, np.nan), np.zeros((3, 2)), **loop)
