"""The laws of every public name of calibration."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from microlib.calibration import calibrate, detect_micrometer, stage_affine
from tests.calibration import test_boards, test_charuco, test_micrometer, test_stage
from tests.calibration.scenes import MOVES, PHOTOGRAPHS, SCOPE, SENSOR, grid_in_view
from tests.laws import (
    NUMBER,
    SAME,
    VIEWS,
    Row,
    TestedBy,
    covariance,
    estimate,
    laws_of,
    px,
    um,
)

WORLD = grid_in_view(SCOPE)[::3]
IMAGE = SCOPE.project(WORLD) + np.random.default_rng(5).normal(0, 0.02, WORLD.shape)
SENSOR_POINTS = (IMAGE - SCOPE.principal_point) * SCOPE.pitch
FLAT = SCOPE.to_objective(WORLD)


def seen(u):
    """The arguments of a calibration."""
    sensor = SENSOR | {"pixel_pitch": (9.9 * u.um, 8.3 * u.um)}
    return {"world": WORLD * u.um, "image": IMAGE, "focal_length": 126e3 * u.um, **sensor}


@cache
def calibrated(um=1.0):
    return calibrate(**seen(SimpleNamespace(um=um)))


def spans(found):
    """The numbers of a calibration; the fields of `Calibration` have the units of parameters."""
    intervals = {
        name: np.array(found.parameters[name].interval)
        for name in ("magnification", "alpha", "distortion")
    }
    return intervals | {n: getattr(found, n) for n in ("residuals", "plane_residuals")}


#: Where a search ends, of the largest residual.
SEARCHED = 1e-5
SPANS = {
    **dict.fromkeys(("magnification", "alpha", "residuals"), NUMBER),
    "distortion": 1 / um**2,
    "plane_residuals": um,
}
#: The middle of a mark is found to some 1e-6 px from grey levels in single precision.
SINGLE = 1e-5
DETECTED = dict.fromkeys(
    ("points", "uncertainty", "positions", "side", "normalized_rms"), NUMBER
) | {
    **dict.fromkeys(("grid", "group", "image_size"), SAME),
}
SCALE = {
    **dict.fromkeys(("points", "residuals", "angle"), NUMBER),
    "divisions": SAME,
    "spacing": estimate(NUMBER),
}


def photographed(u, shown):
    return PHOTOGRAPHS[shown] * u.grey


LAWS = {
    "calibration.calibrate": Row(
        seen, SPANS, within=SEARCHED, call=lambda **given: spans(calibrate(**given))
    ),
    "calibration.Calibration": Row(
        lambda u: {"found": calibrated(u.um)}, SPANS, within=SEARCHED, call=spans
    ),
    "calibration.Calibration.to_json": TestedBy(
        test_stage.test_json_describes_the_camera_to_other_programs),
    "calibration.Calibration.from_json": TestedBy(
        test_stage.test_calibration_survives_json_and_csv),
    "calibration.Detection": TestedBy(
        test_boards.test_points_are_accurate_for_any_marks_blur_and_noise),
    **{
        f"calibration.{detect}": Row(lambda u, shown=shown: {"image": photographed(u, shown)}, unit,
            within=SINGLE)
        for detect, shown, unit in (("detect_circles", "circles", DETECTED),
            ("detect_squares", "squares", DETECTED), ("detect_micrometer", "scale", SCALE),
            ("detect_pattern", "circles", (SAME, DETECTED)))
    },
    "calibration.Micrometer": TestedBy(test_micrometer.test_spacing_of_scale_lines_is_accurate),
    "calibration.Micrometer.um_per_pixel": Row(
        lambda u: {"self": detect_micrometer(PHOTOGRAPHS["scale"]), "division": 10.0 * u.um},
        estimate(um),
    ),
    "calibration.detect_charuco": TestedBy(
        test_charuco.test_inverted_charuco_board_has_the_same_corners),
    "calibration.linear_intrinsics": Row(
        lambda u: {
            "flat": FLAT[:, :2] * u.um,
            "depth": (FLAT[:, 2] - SCOPE.translation[2]) * u.um,
            "sensor": SENSOR_POINTS * u.um,
        },
        [NUMBER, um**-2, um**-1],
    ),
    "calibration.radial_alignment": Row(
        lambda u: {"world": WORLD * u.um, "sensor": SENSOR_POINTS * u.um},
        [NUMBER, NUMBER, NUMBER, um, um],
    ),
    "calibration.stage_affine": Row(
        lambda u: {
            "stage": MOVES * u.um,
            "image": (MOVES @ [[1.3, 0.4], [-0.5, 1.6]] + np.sin(MOVES[::-1]) + [12, -5]) * u.px,
        },
        {
            "matrix": [px / um, px / um, px],
            "covariance": covariance(px / um, px / um, px, px / um, px / um, px),
            "um_per_pixel": {**dict.fromkeys(("value", "uncertainty", "low", "high"), um / px),
                "unit": SAME, "interval": um / px},
            "angle": NUMBER,
            "mirrored": SAME,
            "residuals": px,
        },
        call=lambda stage, image: vars(stage_affine(stage, image)),
        within=1e-8,
    ),
}  # fmt: skip


@pytest.mark.parametrize(("law", "name"), laws_of(LAWS))
def test_law_holds(law, name):
    law(name, LAWS[name])


@pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.name)
@pytest.mark.parametrize("shown", ["circles", "squares", "chessboard"])
def test_detected_points_follow_flips_and_rotations(shown, view):
    detect, image = test_boards.DETECTORS[shown], PHOTOGRAPHS[shown]
    one = detect(image)
    other = detect(np.ascontiguousarray(view.image(image)))
    wanted = view.points(one.points, image.shape)
    order = cKDTree(wanted).query(other.points)[1]
    assert sorted(order) == list(range(len(wanted)))
    apart = other.points - wanted[order]
    assert np.abs(apart).max() < 0.02  # a middle rounded the other way has other pixels around it
    np.testing.assert_allclose(
        other.uncertainty, one.uncertainty[order], rtol=0.2
    )  # of a hundred pixels
    turned = [
        np.linalg.lstsq(p.positions - p.positions.mean(axis=0), p.points)[0] for p in (one, other)
    ]
    assert all(np.linalg.det(steps) > 0 for steps in turned)  # y is clockwise from x


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
