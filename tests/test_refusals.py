"""What once gave a silent wrong number, another exception or no end is refused by name.

Each value is put in the place of one argument of the valid call of `tests/fuzz.py`, whose hostile
values are drawn from what may go wrong anywhere; these went wrong.
"""

from __future__ import annotations

import time
import warnings

import numpy as np
import pytest

from microlib import servoing
from tests import fuzz


def masked(value: np.ndarray) -> np.ma.MaskedArray:
    return np.ma.array(value, mask=np.arange(value.size).reshape(value.shape) % 2 == 0)


STACK = np.random.default_rng(0).integers(0, 255, (5, 24, 31)).astype(np.uint8)
NO_NUMBERS = ([1.0], np.ones(1), [[1.0]], True, "1", None, 1j, {})

#: By callable and argument, the values that are refused.
REFUSED: dict[str, dict[str, tuple[object, ...]]] = {
    "calibration.calibrate": {
        "image": (fuzz.scope().project(fuzz.grid()) * 1e100,),
        "world": (fuzz.grid() * 1e-300, masked(fuzz.grid())),
    },
    "calibration.cramer_rao": {"noise": (-1.0, -1e-9, np.nan)},
    "calibration.detect_circles": {"direction": (np.nan, np.inf, "0", [0.0])},
    "calibration.detect_squares": {"direction": (np.nan, np.inf, "0", [0.0])},
    "curvature.clean_labels": {
        "labels": tuple(np.where(np.eye(4), wrong, 1.0) for wrong in (257, 1.9, -255)),
    },
    "curvature.surface_curvature": {"height": (masked(np.ones((20, 20))),)},
    "focus.correct_spikes": {"depth": (masked(np.ones((9, 9))),)},
    "focus.depth_from_focus": {
        "frames": (masked(STACK), [masked(frame) for frame in STACK]),
        "positions": (masked(np.arange(5.0)), [3.0] * 5, [0, 0, 1, 2, 3], [2, 1, 1, 0, -1]),
    },
    "membrane.mean_strain": {"dimple_depth": (masked(np.ones(4)),)},
    "membrane.modulus_std": {
        "dimple_covariance": (-np.eye(2), [[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [0.0, 1.0]]),
    },
    "microscope.Microscope": {"focal_length": NO_NUMBERS},
    "microscope.euler_rotation": {"beta": (np.nan, [1.0], None, "1", 1e12)},
    "microscope.distort": {"distortion": (np.nan, [1.0], None), "points": ([[np.inf, 0.0]],)},
    "microscope.undistort": {"distortion": (np.nan, [1.0], None), "points": ([[np.inf, 0.0]],)},
    "optics.defocus": {"sigma": (1e30,)},
    "optics.gaussian_kernel": {"sigma": NO_NUMBERS},
    "servoing.Camera": {"interval": NO_NUMBERS},
    "servoing.loop_poles": {"gain": NO_NUMBERS, "delay": (1e9,)},
    "synthetic.focal_stack": {"blur_rate": (1e30,)},
    "synthetic.gripper_scene": {"gap": NO_NUMBERS[:5]},
    "synthetic.render_circles": {"pitch": (np.inf, np.nan, 0.0)},
    "synthetic.render_squares": {"side": (1e30,)},
    "synthetic.sphere_on_plane": {"grain": (1e30,), "rng": ("any",)},
    "tracking.ESMTracker": {"image": (masked(STACK[0]),)},
    "tracking.ESMTracker.track": {"frame": (masked(fuzz.target()),)},
    **{
        f"servoing.{kind}.__call__": {
            "k": (-1, 0.5, 10**400),
            "measured": ([1.0], np.ones((2, 1)), np.array([1e300, 0.0]), np.ones(2) * 1j),
            "reference": (np.ones(2), np.empty((0, 2)), np.full((2, 2), np.inf)),
        }
        for kind in ("OptimalController", "PredictiveController")
    },
}
CASES = [
    (name, argument, value)
    for name, arguments in REFUSED.items()
    for argument, values in arguments.items()
    for value in values
]


@pytest.mark.parametrize(("name", "argument", "value"), CASES, ids=lambda each: str(each)[:40])
def test_a_wrong_value_is_refused_by_name_and_at_once(name, argument, value) -> None:
    begin = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result, wrong = fuzz.answer(name, {argument: value})
    assert wrong is None
    assert result is fuzz.REFUSED
    assert time.process_time() - begin < 5  # not a measure of speed: hours would fail


def test_a_controller_takes_the_same_numbers_in_any_form() -> None:
    measured, reference = np.array([98.0, 79.0]), np.tile([100.0, 80.0], (6, 1))
    weights = {"interval": 0.04, "feature_weight": (1.0, 1.0), "control_weight": (0.01, 0.01)}

    def command(form: object) -> np.ndarray:
        return servoing.OptimalController(np.eye(2) * 0.3, **weights)(0, form, reference.tolist())

    plain = command(measured)
    for form in (list(measured), measured.astype(">f8"), measured.astype(int)):
        np.testing.assert_allclose(command(form), plain, rtol=1e-12)
    assert np.isfinite(command(np.array([np.nan, 1.0]))).all()


def test_a_summary_of_errors_refuses_by_name() -> None:
    summary = type(fuzz.calibrated().plane_error)
    for wrong in (np.ones(3), np.ones((3, 3)), [], None, [[np.nan, 1.0]]):
        with pytest.raises(ValueError, match="differences must"):
            summary.of(wrong)
