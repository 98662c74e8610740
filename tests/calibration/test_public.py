"""The calls of every public function of calibration: their units, axes, and what they refuse."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from microlib import calibration
from microlib.calibration import Calibration, calibrate, detect_micrometer, stage_affine
from tests.checks import hold_call, hold_refused, hold_scaled, no_array, not_finite
from tests.scenes.calibration import MOVES, PHOTOGRAPHS, SCOPE, SENSOR, grid_in_view

WORLD = grid_in_view(SCOPE)[::3]
IMAGE = SCOPE.project(WORLD) + np.random.default_rng(5).normal(0, 0.02, WORLD.shape)
SENSOR_POINTS = (IMAGE - SCOPE.principal_point) * SCOPE.pitch
FLAT = SCOPE.to_objective(WORLD)
SEEN = MOVES @ [[1.3, 0.4], [-0.5, 1.6]] + np.sin(MOVES[::-1]) + [12, -5]


def seen(um: float = 1.0) -> dict:
    """Return the arguments of a calibration."""
    sensor = SENSOR | {"pixel_pitch": (9.9 * um, 8.3 * um)}
    return {"world": WORLD * um, "image": IMAGE.copy(), "focal_length": 126e3 * um, **sensor}


@cache
def calibrated(um: float = 1.0) -> Calibration:
    return calibrate(**seen(um))


@cache
def charuco() -> np.ndarray:
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    return cv2.aruco.CharucoBoard((4, 3), 3.0, 2.0, markers).generateImage((180, 140))


#: A valid call of each function.
CALLS = {
    calibrate: seen, Calibration.to_json: lambda: {"self": calibrated()},
    Calibration.from_json: lambda: {"text": calibrated().to_json()},
    calibration.detect_circles: lambda: {"image": PHOTOGRAPHS["circles"].copy()},
    calibration.detect_squares: lambda: {
        "image": PHOTOGRAPHS["squares"].copy(), "pattern": "squares",
    },
    detect_micrometer: lambda: {"image": PHOTOGRAPHS["scale"].copy()},
    calibration.detect_pattern: lambda: {
        "image": PHOTOGRAPHS["circles"].copy(), "pattern": "circles",
    },
    calibration.detect_charuco: lambda: {"image": charuco().copy()},
    calibration.Micrometer.um_per_pixel: lambda: {
        "self": detect_micrometer(PHOTOGRAPHS["scale"]), "division": 10.0,
    },
    calibration.linear_intrinsics: lambda: {
        "flat": FLAT[:, :2].copy(), "depth": FLAT[:, 2] - SCOPE.translation[2],
        "sensor": SENSOR_POINTS.copy(),
    },
    calibration.radial_alignment: lambda: {"world": WORLD.copy(), "sensor": SENSOR_POINTS.copy()},
    stage_affine: lambda: {"stage": MOVES.copy(), "image": SEEN.copy()},
}  # fmt: skip
each_call = pytest.mark.parametrize("function", CALLS, ids=lambda f: f.__qualname__)
#: What is refused in place of each argument.
REFUSED = {
    calibrate: {
        "pixel_pitch": lambda valid: [*not_finite(valid), 0.0, (9.9, -8.3)],
        "image_size": lambda valid: [*no_array(valid), (0, 491), (-656, 491)],
    }
}


@each_call
def test_call_gives_the_same_for_the_same_numbers(function):
    hold_call(function, CALLS[function])


@each_call
def test_wrong_arguments_are_refused_by_name(function):
    hold_refused(function, CALLS[function](), REFUSED.get(function, {}))


@pytest.mark.parametrize("um", [1e-3, 1.7, 1e3])
def test_calibration_follows_unit_of_length(um):
    found, plain = calibrated(um), calibrated()
    hold_scaled(found.plane_residuals, plain.plane_residuals, um, within=1e-5)  # end of a search
    for name, factor in (("magnification", 1.0), ("alpha", 1.0), ("distortion", um**-2)):
        spans = [np.array(each.parameters[name].interval) for each in (found, plain)]
        hold_scaled(*spans, factor, within=1e-5)
    lengths = {"flat": um * FLAT[:, :2], "sensor": um * SENSOR_POINTS}
    lengths["depth"] = um * (FLAT[:, 2] - SCOPE.translation[2])
    plain = calibration.linear_intrinsics(**CALLS[calibration.linear_intrinsics]())
    hold_scaled(calibration.linear_intrinsics(**lengths), plain, np.array([1, um**-2, 1 / um]))
    found = calibration.radial_alignment(um * WORLD, um * SENSOR_POINTS)
    plain = calibration.radial_alignment(WORLD, SENSOR_POINTS)
    hold_scaled(found, plain, np.array([1, 1, 1, um, um]))


@pytest.mark.parametrize("grey", [1 / 255, 257.0, (0.0, 0.9, 0.3)])
@pytest.mark.parametrize(
    "detect",
    [
        calibration.detect_circles,
        calibration.detect_squares,
        calibration.detect_pattern,
        detect_micrometer,
    ],
)
def test_marks_are_the_same_in_other_grey_levels_and_in_color(detect, grey):
    given = CALLS[detect]()
    found = detect(**given | {"image": np.multiply.outer(given["image"], grey)})
    # The middle of a mark is found to some 1e-6 px from grey levels in single precision.
    hold_scaled(found, detect(**given), within=1e-5)


def test_um_per_pixel_of_stage_and_micrometer_scales_with_unit_of_length():
    um, px = 1.7, 0.6
    scale = detect_micrometer(PHOTOGRAPHS["scale"])
    hold_scaled(scale.um_per_pixel(10.0 * um), scale.um_per_pixel(10.0), um)
    units = np.array([px / um, px / um, px])
    by = {"matrix": units, "residuals": px, "um_per_pixel": um / px}
    by["covariance"] = np.outer([*units, *units], [*units, *units])
    found, plain = stage_affine(um * MOVES, px * SEEN), stage_affine(MOVES, SEEN)
    hold_scaled(vars(found), vars(plain), within=1e-8, **by)


def test_calibration_follows_order_of_points_and_views_and_origin():
    """Numbers of a view stay with it; where the world begins moves T_x and T_y alone."""
    scopes = [SCOPE, replace(SCOPE, alpha=-0.4, beta=-0.25, gamma=0.1)]
    rng = np.random.default_rng(3)
    image = [s.project(WORLD) + rng.normal(0, 0.02, WORLD.shape) for s in scopes]
    keep = [((i > 0) & (i < [655, 490])).all(axis=1) for i in image]
    world, image = [WORLD[k] for k in keep], [i[k] for i, k in zip(image, keep, strict=True)]
    one = calibrate(world, image, **SENSOR)
    order = [rng.permutation(len(w)) for w in world]
    mixed = [
        [part[k] for part, k in zip(each, order, strict=True)][::-1] for each in (world, image)
    ]
    other = calibrate(*mixed, **SENSOR)
    origin = np.array([[310.0, -140.0]])
    moved = calibrate([w + origin for w in world], image, **SENSOR)
    for view, mate, away in zip(one.views, other.views[::-1], moved.views, strict=True):
        assert mate.focal_length == pytest.approx(view.focal_length, rel=1e-5)
        for name in ("magnification", "alpha", "beta", "gamma", "tx"):
            assert getattr(mate, name) == pytest.approx(getattr(view, name), rel=1e-5), name
        beside = away.to_objective(origin) - view.to_objective([[0.0, 0.0]])
        np.testing.assert_allclose(beside[0, :2], 0, atol=0.01)
    assert other.um_per_pixel.value == pytest.approx(9.9 / one.views[1].magnification, rel=1e-6)
    every = [c.parameters["focal_length"] for c in (one, other, moved)]
    sigmas = [each.uncertainty / each.value for each in every]
    np.testing.assert_allclose(sigmas, sigmas[0], rtol=0.01)  # f is that of the first view
