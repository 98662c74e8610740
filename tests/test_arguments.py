"""What every argument of every public function may be: one contract for each kind of argument.

A wrong value is refused by a `ValueError` that names the argument, with no warning before. Each
value is put in the place of one argument of the valid call of `tests/fuzz.py`. What a message says
beyond the name is tested where it is made, in tests/_common/test_checks.py.
"""

import inspect
import os
import random
import re
from collections.abc import Iterator
from fnmatch import fnmatch

import numpy as np
import pytest

from microlib import embryo
from tests import fuzz
from tests.laws import resolve, unlike

NAMES = fuzz.names()
#: How many pairs of unusual values are drawn for each function; ``make fuzz`` draws more.
PAIRS = int(os.environ.get("FUZZ_PAIRS", "3"))

#: Numbers of either sign. All others are refused below zero, and at zero unless they may be zero.
SIGNED = {
    "x",
    "distortion",
    "distortion_k2",
    "alpha",
    "beta",
    "gamma",
    "tilt",
    "tx",
    "ty",
    "u",
    "mean",
}
MAY_BE_ZERO = SIGNED | {
    "blur", "bright", "dark", "delay", "delta", "force", "h_zero", "increment", "jitter",
    "k", "k_zero", "largest", "latency", "noise", "poisson_ratio", "pressure", "pretension",
    "rng", "sigma", "std", "step", "threshold", "unevenness", "vignetting",
}  # fmt: skip
#: Further numbers that are out of the range of an argument, in every function.
OUT_OF_RANGE: dict[str, float] = {
    "band": 1.0, "bright": 255.5, "dark": 255.5, "degree": 3, "inflation": 0.9,
    "level": 1.0, "poisson_ratio": 0.6, "span": 1.2,
    "terms": 21, "tilt": 4.0, "unevenness": 0.6, "vignetting": 1.1,
    "window": 4,  # not odd
}  # fmt: skip
#: Arrays of which all numbers are above zero.
POSITIVE_ARRAYS = {
    "counts", "image_size", "pitch", "pixel_pitch", "pixel_size", "radius", "scales", "shape",
    "travel", "widths",
}  # fmt: skip

#: Where a number may be one of an array, or an array have any shape.
ANY_SHAPE = (
    *(f"membrane.{name}.*" for name in (
        "elastic_modulus", "indentation_force", "dimple_depth", "dimple_profile",
        "membrane_stress", "mean_strain")),
    "embryo.GaussianSum.*.x",
    "optics.*_distance", "optics.blur_radius.*", "optics.gaussian_transfer.*",
    "microscope.distort.points", "microscope.undistort.points", "*.pixel_size", "*.pixel_pitch",
    "servoing.StageModel.rounded.position", "servoing.point_jacobian.depth",
    "synthetic.mixed_texture.scales", "curvature.hk_labels.?_zero", "optics.defocus.sigma",
    "optics.BlurLadder.at.sigma",
)  # fmt: skip
#: Where NaN is an unknown pixel, a lost feature or an uncertainty that is not known.
MAY_BE_NAN = (
    "curvature.*.gaussian", "curvature.*.mean", "curvature.*.height", "*.frames",
    "focus.correct_spikes.depth", "focus.smooth_depth.depth", "io.write_*.height",
    "curvature.hk_labels.?_zero", "*covariance", "microscope.*distort.points", "*.measured",
)  # fmt: skip
#: Labels of `fuzz.wrong_kinds` for arrays of another shape, and those that are right somewhere.
SHAPES = ("number", "one axis more", "one column less", "flat")
ACCEPTED = {
    **dict.fromkeys(("True", "[1.0]", "number"), ANY_SHAPE),
    "one axis more": (
        *ANY_SHAPE,
        "servoing.OptimalController.__call__.measured",
        "servoing.simulate.jacobian",
    ),
    "one column less": (*ANY_SHAPE, "servoing.ibvs_control.jacobian"),
    **dict.fromkeys(("nan", "0-d nan", "inf", "with nan", "with inf", "all nan"), MAY_BE_NAN),
    "empty": ("io.read_frames.frames",),
    "ragged": ("io.write_ply.image",),  # refused in NumPy's words
}
SINGULAR = ([[1.0, 2.0], [2.0, 4.0]], np.zeros((2, 2)))
NOT_DEFINITE = ((0.9, 0.0), [[1.0, 2.0], [2.0, 1.0]])
WITHOUT_DIMPLE = embryo.GaussianSum([9.0], [0.0], [5.0], domain=(-9, 9))
#: What is wrong for one function: values that contradict each other or another argument.
CONTRADICTIONS: dict[str, tuple[object, ...]] = {
    "curvature.clean_labels.labels": ([[12]], np.full((4, 4), 1.9), -np.eye(4)),
    "curvature.curvature_windows.size": (1, 4),
    "curvature.hk_labels.k_zero": ([0.1, 0.2],),
    "curvature.region_table.labels": ([[1]],),
    "curvature.surface_curvature.height": (np.zeros((8, 40)), np.full((40, 40), np.inf)),
    "curvature.surface_curvature.size": (4,),
    "embryo.GaussianSum.domain": ((1, 1),),
    "embryo.dimple_from_outline.x": (np.arange(5.0),),
    "embryo.dimple_geometry.curve": (WITHOUT_DIMPLE,),
    "embryo.fit_dimple.probe_half_width": (8.0, 45.0),
    "embryo.fit_gaussians.x": (np.full(60, 2.0), np.arange(5.0)),
    "embryo.loess.span": (0.02,),
    "embryo.loess.x": (np.ones(40), np.repeat([0.0, 1.0], 20)),
    "embryo.modulus_from_image.force": (150e-6,),  # in N
    "embryo.modulus_from_image.pixel_size": (3.9e-6,),  # in m
    "embryo.modulus_from_image.probe_half_width": (45.0,),
    "embryo.modulus_from_image.thickness": (3e-6,),
    "focus.correct_spikes.depth": (np.zeros(12), np.full((12, 12), np.inf)),
    "focus.depth_from_focus.positions": ([3.0] * 5, [0, 0, 1, 2, 3], [2, 1, 1, 0, -1]),
    "focus.smooth_depth.depth": (np.full((44, 60), -np.inf),),
    "focus.sum_modified_laplacian.step": (0, 99),
    "focus.three_point_peak.index": (np.full((44, 60), 10), np.full((44, 60), -1)),
    "focus.three_point_peak.positions": (np.arange(2.0), np.arange(10) // 2),
    "focus.three_point_peak.window": (np.ones((4, 44, 60)), np.full((3, 44, 60), -1.0)),
    "io.read_frames.region": ((-1, 0, 4, 4), (0, 0, 0, 4), (0, 0, 4, 0), "abcd"),
    "membrane.capsule_modulus.depth": (1300.0, 500.0, 0.01),
    "membrane.capsule_modulus.rim_radius": (10.0, 570.0),
    "membrane.dimple_profile.radius": ([10.0],),
    "membrane.elastic_modulus.rim_radius": (10.0,),
    "membrane.elastic_modulus.probe_half_width": (213.0,),
    "membrane.finite_slope_modulus.probe_half_width": (300.0,),
    "membrane.indent_capsule.probe_half_width": (570.0,),
    "membrane.indent_disc.force": (5e3,),
    "membrane.indent_disc.poisson_ratio": (0.4,),
    "membrane.indent_disc.probe_half_width": (213.0,),
    "membrane.modulus_samples.uncertainties": ({"poisson_ratio": 1e5},),
    "membrane.modulus_uncertainty.dimple_covariance": (np.eye(3),),
    "membrane.modulus_uncertainty.uncertainties": (
        {"mass": 1.0},
        {"force": np.nan},
        {"dimple_depth": 1.0},
    ),
    "membrane.modulus_uncertainty.values": ({"force": 1.0},),
    "microscope.Microscope.image_size": ((656, 0), (656.5, 491), 656),
    "microscope.Microscope.pixel_pitch": ((9.9, 0.0), (9.9, 9.9, 9.9)),
    "optics.blur_radius.sensor_distance": (90.0,),
    "optics.BlurLadder.at.sigma": (np.zeros((4, 5)), 4.1),
    "optics.defocus.sigma": (np.zeros((4, 5)),),
    "optics.gaussian_kernel.sigma": (0.0,),
    "optics.gaussian_kernel.size": (6,),
    "optics.image_distance.object_distance": (50.0,),
    "servoing.OptimalController.jacobian": SINGULAR,
    "servoing.ibvs_control.jacobian": SINGULAR,
    "servoing.optimal_control.control_weight": NOT_DEFINITE,
    "servoing.optimal_control.feature_weight": NOT_DEFINITE,
    "servoing.servo.jacobian": SINGULAR,
    "servoing.servo.test_move": (500.0, 80.0),  # beyond the travel, and beyond the longest move
    "servoing.simulate.reference": (np.full((3, 2), 9e4),),
    "servoing.path_metrics.position": (np.zeros((1, 2)),),
    "servoing.step_metrics.time": (np.zeros(25), np.arange(24.0)),
    "synthetic.Embryo.dented.depth": (3000.0,),
    "synthetic.Embryo.rim_radius": (20.0,),
    "synthetic.Embryo.pressed.force": (0.0, 1e-9),
    "synthetic._gripper.GripperScene.frame.shift": ((90, 0),),
    "synthetic.embryo_image.shape": ((10, 10),),
    "synthetic.embryo_image.blur": (0.2,),
    "synthetic.focal_stack.blur_rate": (1e3,),
    "synthetic.focal_stack.height": (np.eye(5),),
    "synthetic.gripper_scene.gap": (130.0,),
    "synthetic.parabolic_cylinder.shape": ((1, 9),),
    "tracking.ESMTracker.track.frame": (np.zeros((20, 30)),),
    "tracking.KalmanFilter.noise": (0.0,),
}

#: Not checked: objects and functions, and a text that is written as it is.
FREE = {"self", "kalman", "observer", "progress", "what"}


def fits(key: str, patterns: tuple[str, ...]) -> bool:
    return any(fnmatch(key, pattern) for pattern in patterns)


def arguments(name: str) -> Iterator[tuple[str, object]]:
    """Yield the arguments of a valid call that are looked at, with their values."""
    for argument, value in fuzz.valid_call(name).items():
        if argument not in FREE and fuzz.is_checked(value):
            yield argument, value


def out_of_range(argument: str, value: object, kind: str) -> list:
    """Return numbers beyond the range of an argument; `kind` is its annotation."""
    if fuzz.is_array(value):
        positive = argument in POSITIVE_ARRAYS
        return [np.zeros(np.shape(value)), -np.asarray(value)] if positive else []
    if not isinstance(value, (int, float, np.number)):
        return []
    beyond = [OUT_OF_RANGE[argument]] if argument in OUT_OF_RANGE else []
    beyond += [] if argument in MAY_BE_ZERO else [0]
    beyond += [] if argument in SIGNED else [-1]
    return beyond + ([1.5] if kind.startswith("int") else [])


def wrong_values(name: str) -> Iterator[tuple[str, str, object]]:
    """Yield an argument, a label and a value of all that a function must refuse."""
    parameters = inspect.signature(resolve(name)).parameters
    for argument, value in arguments(name):
        known = parameters.get(argument)
        wrong = {} if value is None else fuzz.wrong_kinds(value)
        if known is None or known.default is not None:
            wrong["None"] = None
        beyond = out_of_range(argument, value, str(known.annotation) if known else "")
        wrong |= {str(number): number for number in beyond}
        for label, each in wrong.items():
            if not fits(f"{name}.{argument}", ACCEPTED.get(label, ())):
                yield argument, label, each
    for key, values in CONTRADICTIONS.items():
        function, _, argument = key.rpartition(".")
        yield from ((argument, str(value)[:40], value) for value in values if function == name)


@pytest.mark.parametrize("name", NAMES)
def test_wrong_value_is_refused_by_name(name):
    """Text, masks, NaN, nothing, another shape, out of range, or in contradiction to another."""
    found = []
    for argument, label, value in wrong_values(name):
        result, fault = fuzz.answer(name, {argument: value})
        if fault or not isinstance(result, fuzz.Refused):
            found.append(f"{argument}={label}: {fault or 'accepted'}")
        # For a shape the message may name the argument that it goes with.
        elif label not in SHAPES and not re.search(rf"\b{argument}\b", result):
            found.append(f"{argument}={label}: {result}")
    assert not found, "\n".join(found)


@pytest.mark.parametrize("name", NAMES)
def test_unusual_value_gives_a_result_or_is_refused_by_name(name):
    """Also two at once; drawn, the same ones each time."""
    rng, valid = random.Random(name), dict(arguments(name))
    unusual = {argument: [*fuzz.unusual(value)] for argument, value in valid.items()}
    drawn = [
        {a: value} for a, each in unusual.items() for value in rng.sample(each, min(2, len(each)))
    ]
    for argument, value in valid.items():
        unusual[argument] += [*fuzz.wrong_kinds(value).items()] if value is not None else []
    for _ in range(PAIRS if len(valid) > 1 else 0):
        drawn.append({a: rng.choice(unusual[a]) for a in rng.sample([*valid], 2)})
    found = []
    for changed in drawn:
        if wrong := fuzz.fault(name, {argument: value for argument, (_, value) in changed.items()}):
            labels = {argument: label for argument, (label, _) in changed.items()}
            found.append(f"{labels}: {wrong}")
    assert not found, "\n".join(found)


@pytest.mark.parametrize("name", NAMES)
def test_same_numbers_in_another_form_give_the_same_result(name):
    """Read-only, with gaps in memory, and in the byte order of another computer."""
    given = fuzz.valid_call(name)
    forms = {key: fuzz.in_another_form(value) for key, value in given.items()}
    forms = {key: form for key, form in forms.items() if form is not None}
    expected, _ = fuzz.answer(name, {key: given[key] for key in forms})
    result, wrong = fuzz.answer(name, forms)
    assert wrong is None
    # Images are filtered in single precision, along rows or columns.
    assert not [*unlike(expected, result, within=1e-4)]


def test_every_public_callable_is_called_with_every_argument():
    for name in fuzz.names():
        inspect.signature(resolve(name)).bind(**fuzz.valid_call(name))
