"""The simulated stage against an integrator, and the loop closed over rendered frames."""

import numpy as np
import pytest

from microlib.servoing import (
    Camera,
    OptimalController,
    PredictiveController,
    Stage,
    simulate,
)

INTERVAL = 1 / 33
JACOBIAN = 1.5893 / 9.9 * np.eye(2)
LOOP = {"jacobian": JACOBIAN, "stage": Stage(saturation=400.0), "camera": Camera(INTERVAL)}


WEIGHTS = {"feature_weight": (0.9, 0.9), "control_weight": (0.025e-6, 0.05e-6)}


def controller():
    return OptimalController(JACOBIAN, interval=INTERVAL, **WEIGHTS)


def test_stage_positions_are_multiples_of_its_step():
    quantized = Stage(saturation=1.0).rounded(np.array([0.024, 0.026, -1.31]))
    np.testing.assert_allclose(quantized, [0.0, 0.05, -1.3], atol=1e-12)


def test_jitter_has_the_stated_standard_deviation_and_seed_equals_generator():
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


def test_simulate_rejects_references_beyond_travel_and_invalid_commands():
    loop = {"jacobian": np.eye(2), "stage": Stage(1.0), "camera": Camera(0.1), "rng": 0}
    with pytest.raises(ValueError, match="reference must lie within"):
        simulate(controller(), np.full((3, 2), 9e4), start=(0, 0), **loop)
    with pytest.raises(ValueError, match="command must be finite"):
        simulate(lambda *_: np.full(2, np.nan), np.zeros((3, 2)), **loop)


@pytest.mark.parametrize("predicts", [False, True])
def test_runs_simulated_at_once_equal_those_simulated_alone(predicts):
    """With a delay of more than a frame, and frames in which the feature is lost."""
    late = {"delay": 1.4 * INTERVAL, "saturation": 400.0} if predicts else {}
    kind = PredictiveController if predicts else OptimalController
    law = kind(JACOBIAN, interval=INTERVAL, **WEIGHTS, **late)
    path = np.cumsum(np.random.default_rng(1).normal(0, 2, (40, 2)), axis=0)
    matrices = JACOBIAN * np.array([0.9, 1.0, 1.2])[:, None, None]
    starts = path[0] + [[3.0, 0.0], [0.0, 0.0], [-40.0, 9.0]]
    lost = np.random.default_rng(2).random((40, 3)) < 0.2
    lost[0, 1] = True

    def loop(runs, **options):
        frames = iter(lost)

        def see(feature):
            return np.where(next(frames)[runs, None], np.nan, feature)

        camera = Camera(INTERVAL, latency=1.4 * INTERVAL, jitter=0.1)
        given = {"stage": LOOP["stage"], "camera": camera, "start": starts[runs]}
        return simulate(law, path, jacobian=matrices[runs], observer=see, **given, **options)

    together = loop(np.arange(3), rng=[np.random.default_rng(k) for k in range(3)])
    for k in range(3):
        alone = loop([k], rng=[np.random.default_rng(k)])
        for name in ("feature", "measured", "position", "command", "saturated"):
            both = getattr(together, name)[k], getattr(alone, name)[0]
            np.testing.assert_allclose(*both, atol=1e-9)
    np.testing.assert_array_equal(np.isnan(together.measured[..., 0]), lost.T)
