"""What once gave a silent wrong number, another exception or no end is refused by name.

Each value is put in the place of one argument of the valid call of `tests/fuzz.py`, whose hostile
values are drawn from what may go wrong anywhere; these went wrong.
"""

from __future__ import annotations

import re
import time
import warnings

import numpy as np
import pytest

from microlib import embryo, servoing
from tests import fuzz


def masked(value: np.ndarray) -> np.ma.MaskedArray:
    """Hide half of an array; in the table, of the valid one."""
    value = np.asarray(value)
    return np.ma.array(value, mask=np.arange(value.size).reshape(value.shape) % 2 == 0)


NO_POINTS = ([1.0, 2.0], [[1.0]], np.empty((0, 2)), [[np.nan, 0.0]], "ab")
NO_SENSOR: dict[str, tuple[object, ...]] = {
    "distortion": (np.nan, [1.0], None),
    "points": ([[np.inf, 0.0]], 3.0, [1.0, 2.0, 3.0]),
}
NO_JACOBIAN = ([[1.0, 2.0], [2.0, 4.0]], np.zeros((2, 2)))
NO_WEIGHT = ((0.9, 0.0), [[1.0, 2.0], [2.0, 1.0]])
NO_NUMBERS = ([1.0], np.ones(1), [[1.0]], True, "1", None, 1j, {})

#: By callable and argument, the values that are refused.
REFUSED: dict[str, dict[str, tuple[object, ...]]] = {
    "calibration._calibration.ErrorSummary.of": {
        "differences": (np.ones(3), np.ones((3, 3)), [], None, [[np.nan, 1.0]]),
    },
    "calibration.calibrate": {
        "world": (masked,),
    },
    "calibration.cramer_rao": {
        "noise": (-1.0, np.nan),
        "world": (fuzz.grid() * 1e12,),  # beyond the fold of the distortion
    },
    "curvature.clean_labels": {
        "labels": ([[12]], *(np.where(np.eye(4), wrong, 1.0) for wrong in (257, 1.9, -255))),
        "smallest": (0,),
    },
    "curvature.curvature_windows": {"size": (1,)},
    "curvature.hk_labels": {
        "gaussian": (np.ones(1), 0.2),
        "h_zero": (-0.1,),
        "k_zero": ([0.1, 0.2], -0.1),
    },
    "curvature.region_table": {"labels": ([[1]],), "curvature": (3,)},
    "curvature.surface_curvature": {
        "height": (masked, np.zeros((8, 40)), np.full((40, 40), np.inf)),
        "pixel_size": (-1.0,),
        "size": (4,),
        "noise": (-1,),
    },
    "embryo.GaussianSum": {"centers": ([1.0, 2.0],), "widths": (np.zeros(3),), "domain": ((1, 1),)},
    "embryo.dimple_geometry": {
        "curve": (embryo.GaussianSum([9.0], [0.0], [5.0], domain=(-9, 9)),),
        "pixel_size": (0.0,),
    },
    "embryo.dimple_from_outline": {
        "x": (np.full(193, np.nan), np.arange(5.0)),
        "y": (np.zeros(193),),
        "pixel_size": (0.0,),
    },
    "embryo.fit_dimple": {"pixel_size": (0.0,), "probe_half_width": (-1.0, 8.0, 45.0)},
    "embryo.fit_gaussians": {
        "x": (np.full(60, 2.0), np.full(60, np.nan), np.arange(5.0)),
        "terms": (0, 21),
    },
    "embryo.loess": {
        "x": (np.full(40, np.nan), np.ones(40), np.repeat([0.0, 1.0], 20)),
        "y": (np.zeros(9),),
        "span": (0.0, 1.2, 0.02),
        "degree": (3,),
    },
    "embryo.modulus_from_image": {
        "force": (0.0, np.nan, 150e-6),
        "method": ("eyes",),
        "pixel_size": (-1.0, 3.9e-6),
        "thickness": (0.0, 3e-6),
        "probe_half_width": (45.0,),
        "poisson_ratio": (0.6,),
    },
    "focus.correct_spikes": {
        "depth": (masked, np.zeros(12), np.full((12, 12), np.inf)),
        "window": (8,),
        "delta": (-1,),
    },
    "focus.depth_from_focus": {
        "frames": (masked, [masked(frame) for frame in fuzz.stack()]),
        "positions": (masked, [3.0] * 5, [0, 0, 1, 2, 3], [2, 1, 1, 0, -1]),
    },
    "focus.smooth_depth": {
        "depth": (np.full((44, 60), -np.inf),),
        "jump": (0,),
        "radius": (-1,),
        "weight": (np.zeros((43, 60)), np.full((44, 60), -1)),
    },
    "focus.sum_modified_laplacian": {
        "image": (np.zeros((3, 8, 8)), np.full((8, 8), np.nan), np.zeros((0, 8))),
        "window": (4,),
        "step": (0, 99),
        "threshold": (-1,),
    },
    "focus.three_point_peak": {
        "window": (
            *(masked, np.ones((4, 44, 60)), np.ones((3, 44, 60), complex)),
            *(np.full((3, 44, 60), wrong) for wrong in (-1.0, np.nan)),
        ),
        "index": (np.ones((44, 60)), np.full((44, 60), 10), np.full((44, 60), -1)),
        "positions": (
            *(np.arange(2.0), np.zeros((10, 10)), np.arange(10) // 2),
            np.append(np.arange(9.0), np.inf),
        ),
    },
    "io.read_frames": {
        "region": ((-1, 0, 4, 4), (0, 0, 0, 4), (0, 0, 4, 0), "abcd"),
        "reduce": (0, 1.5),
    },
    "membrane.capsule_modulus": {"rim_radius": (10.0, 570.0), "depth": (1300.0, 500.0, 0.01)},
    "membrane.dimple_profile": {"radius": ([10.0],)},
    "membrane.elastic_modulus": {
        "force": (-1.0, np.nan, [], "ten"),
        "dimple_radius": (10.0,),
        "dimple_depth": (0.0,),
        "thickness": (-3.0,),
        "probe_half_width": (213.0,),
        "poisson_ratio": ([0.4, 0.6], -1.0),
    },
    "membrane.finite_slope_modulus": {"force": ([1.0, 2.0],), "probe_half_width": (300.0,)},
    "membrane.fit_capsule": {
        "outline": (np.zeros((5, 2)), np.zeros((30, 3)), np.full((30, 2), np.nan), np.eye(30, 2)),
    },
    "membrane.indent_capsule": {
        "force": (-1.0,),
        "modulus": (np.inf,),
        "radius": (0.0,),
        "probe_half_width": (570.0,),
        "law": ("rubber",),
        "inflation": (0.9,),
    },
    "membrane.indent_disc": {
        "force": (0.0, np.nan, [1.0, 2.0], 5e3),
        "modulus": (0.0,),
        "probe_half_width": (213.0,),
        "poisson_ratio": (0.4,),
        "pressure": ("none", -1.0),
        "pretension": (-0.1,),
        "rim_inset": (0.6,),
    },
    "membrane.indentation_force": {"modulus": (-1.0,)},
    "membrane.mean_strain": {"dimple_depth": (masked,)},
    "membrane.modulus_samples": {
        "stds": ({"poisson_ratio": 1e5},),
        "size": (0,),
    },
    "membrane.modulus_std": {
        "values": ({"force": 1.0},),
        "stds": ({"mass": 1.0}, {"force": -1.0}, {"dimple_depth": 1.0}),
        "dimple_covariance": (np.eye(3),),
    },
    "membrane.viscoelastic_force": {
        "time": ([0.0, 0.0, 1.0, 2.0],),
        "elastic_force": ([0.0, 1.0],),
        "prony_coefficients": ([0.7, 0.7], [-0.1, 0.1]),
        "relaxation_times": ([1.0, 0.0], [1.0]),
    },
    "microscope.Microscope": {
        "focal_length": (*NO_NUMBERS, 0.0),
        "distance": (np.nan,),
        "distortion": (np.inf,),
        "pixel_size": ((9.9, 0.0), (9.9, 9.9, 9.9)),
        "image_size": ((656, 0), (656.5, 491), 656),
    },
    "microscope.Microscope.jacobian": {"parameters": (("alpha", "lens"),)},
    "microscope.Microscope.project": {"points": NO_POINTS},
    "microscope.Microscope.back_project": {"pixels": NO_POINTS},
    "microscope.euler_rotation": {"beta": (np.nan, [1.0], None, "1")},
    "microscope.distort": NO_SENSOR,
    "microscope.undistort": NO_SENSOR,
    "optics.blur_radius": {"object_distance": (np.nan,), "sensor_distance": (90.0,)},
    "optics.defocus": {
        "image": (np.zeros((4, 4, 3)), np.full((4, 4), np.nan)),
        "sigma": (-1.0, np.zeros((4, 5))),
    },
    "optics.gaussian_kernel": {"sigma": (*NO_NUMBERS, 0.0), "size": (6,)},
    "optics.gaussian_transfer": {"sigma": (-1.0,)},
    "optics.image_distance": {"object_distance": (50.0, -1.0), "focal_length": (-1.0,)},
    "servoing.Camera": {"interval": NO_NUMBERS},
    "servoing.OptimalController": {"jacobian": NO_JACOBIAN},
    "servoing.ibvs_control": {"jacobian": NO_JACOBIAN},
    "servoing.loop_poles": {"gain": NO_NUMBERS, "delay": (-1.0,)},
    "servoing.optimal_control": dict.fromkeys(("feature_weight", "control_weight"), NO_WEIGHT),
    "servoing.path_metrics": {"position": (np.zeros((1, 2)),)},
    "servoing.step_metrics": {
        "time": (np.zeros(25), np.arange(24.0)),
        "target": (fuzz.valid_call("servoing.step_metrics")["position"][0],),
        "band": (0.0,),
    },
    "synthetic.Embryo": {"modulus": (-1.0,), "dimple_radius": (20.0,), "poisson_ratio": (1.0,)},
    "synthetic.Embryo.dented": {"depth": (3000.0,)},
    "synthetic.Embryo.outline": {"spacing": (0.0,)},
    "synthetic.Embryo.pressed": {"force": (0.0, 1e-9)},
    "synthetic.ImagingConditions": {"dark": (255.5,), "bright": (255.5,)},
    "synthetic.cone": {"height": (-1.0,)},
    "synthetic.embryo_image": {
        "blur": (0.2,),
        "noise": (-1.0,),
        "unevenness": (0.6,),
        "shape": ((10, 10),),
        "pixel_size": (0.0,),
        "tilt": (4.0,),
    },
    "synthetic.focal_stack": {"blur_rate": (1e3,), "height": (np.eye(5),), "rng": (None,)},
    "synthetic.gripper_scene": {"gap": (*NO_NUMBERS[:5], 130.0)},
    "synthetic._gripper.GripperScene.frame": {"shift": ((90, 0),)},
    "synthetic.mixed_texture": {"scales": (0,)},
    "synthetic.parabolic_cylinder": {"shape": ((1, 9),)},
    "synthetic.render_circles": {"pitch": (np.inf, np.nan, 0.0)},
    "synthetic.sphere_on_plane": {"rng": ("any", None)},
    "tracking.ESMTracker": {"image": (masked,)},
    "tracking.ESMTracker.track": {"frame": (masked,)},
    "tracking.KalmanFilter": {
        "interval": (0.0,),
        "acceleration": (-1.0,),
        "noise": (np.nan, 0.0),
    },
    "tracking.track_all": {
        "frames": ([],),
        "box": ((20, 15, 400, 40),),
        "rate": (0.0,),
        "pixel_size": (-3.0,),
    },
    **{
        f"servoing.{kind}.__call__": {
            "k": (-1, 0.5),
            "measured": ([1.0], np.ones((2, 1)), np.ones(2) * 1j),
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


def _shown(each: object) -> str:
    """Name a case alike in every process: a function prints its address."""
    return getattr(each, "__name__", str(each)[:40])


@pytest.mark.parametrize(("name", "argument", "value"), CASES, ids=_shown)
def test_a_wrong_value_is_refused_by_name_and_at_once(name, argument, value) -> None:
    value = masked(fuzz.valid_call(name)[argument]) if value is masked else value
    begin = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result, wrong = fuzz.answer(name, {argument: value})
    assert wrong is None
    assert isinstance(result, fuzz.Refused)
    assert re.search(rf"\b{argument}\b", result)
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
