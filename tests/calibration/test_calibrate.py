"""Calibration against exact data, the Cramér–Rao bound, Monte Carlo and OpenCV."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import f as fisher
from scipy.stats import t as student

from microlib.calibration import (
    Calibration,
    calibrate,
    detect_squares,
    linear_intrinsics,
    radial_alignment,
)
from microlib.estimate import Estimate
from microlib.microscope import Microscope
from tests.scenes.calibration import (
    SCOPE,
    SENSOR,
    detection_of,
    grid_in_view,
    imperfect_projection,
    seen_by_opencv,
)

F, M = SCOPE.focal_length, SCOPE.magnification
POSE = ("alpha", "beta", "gamma", "tx", "ty")
NOISE = 0.02
CHESSBOARD = Path(__file__).parents[2] / "data" / "real" / "chessboard"
CAMERA = {"pixel_pitch": 8.0, "image_size": (640, 480)}


def tilted(beta, gamma):
    """`SCOPE` with other angles of its tilt, in degrees."""
    return replace(SCOPE, beta=np.deg2rad(beta), gamma=np.deg2rad(gamma))


def tilted_views():
    """Three microscopes, the points of a plane that each sees, µm, and their exact images, px."""
    scopes = [tilted(*angles) for angles in ((12, 3), (-5, 10), (4, -14))]
    worlds = [grid_in_view(scope) for scope in scopes]
    return scopes, worlds, [s.project(w) for s, w in zip(scopes, worlds, strict=True)]


def values(found):
    """The estimates of the parameters."""
    return np.array([each.value for each in found.parameters.values()])


def numerical_bound(project, truth):
    """Cramér–Rao bound of the parameters of a function that returns image points, for `NOISE`."""
    steps = np.diag(1e-5 * np.abs(truth))
    slopes = [(project(truth + h) - project(truth - h)).ravel() / (2 * h.sum()) for h in steps]
    jacobian = np.array(slopes).T
    return NOISE**2 * np.linalg.inv(jacobian.T @ jacobian)


def noisy(points, seed):
    return points + np.random.default_rng(seed).normal(0, NOISE, points.shape)


def lens_views(
    count, *, principal=900.0, spacing=46.0, tilt=0.4, aside=(0.0, 0.0), k1=-0.2, k2=0.0,
    seed=0, shift=0.0, bend=0.0, pixel=1.0, printed=1.0,
):  # fmt: skip
    """Views through one lens, projected by OpenCV. The principal distance and the spacing of marks
    are in px; `shift`, the rms error of printed marks, and the bend of the pattern are in µm.
    `pixel` and `printed` are the heights of a pixel and of the print over their widths."""
    rng = np.random.default_rng(seed)
    world = 280.0 * (np.argwhere(np.ones((11, 8))) - [5, 3.5])
    made = world + rng.normal(0, 1, world.shape) * shift
    made = np.column_stack([made * [1, printed], bend * (made[:, 0] / 1400) ** 2])
    center = np.array([319.5, 239.5]) + aside
    camera = np.array([[principal, 0, center[0]], [0, principal / pixel, center[1]], [0, 0, 1]])
    place = np.array([30.0, -20, 280 * principal / spacing])
    worlds, images = [], []
    for _ in range(count):
        rotation = cv2.Rodrigues(rng.uniform(-tilt, tilt, 3))[0]
        seen = cv2.projectPoints(made, rotation, place, camera, np.array([k1, k2, 0, 0, 0]))[0]
        seen = seen[:, 0] + rng.normal(0, NOISE, world.shape)
        shown = ((seen >= 0) & (seen <= [639, 479])).all(axis=1)
        worlds.append(world[shown])
        images.append(seen[shown])
    return worlds, images


# The linear start


@pytest.mark.parametrize(
    ("distortion", "precision"),
    # The linear equations omit the product of distortion and perspective: 1.3 % of h in a corner.
    [(0.0, 1e-9), (-8.4e-10, 0.013)],
)
def test_linear_intrinsics_are_exact_without_distortion(distortion, precision):
    scope = replace(tilted(2, 1.5), distortion=distortion)
    world = grid_in_view(scope)
    frame = scope.to_objective(world)
    sensor = (scope.project(world) - scope.principal_point) * scope.pitch
    found = linear_intrinsics(frame[:, :2], frame[:, 2] - F - F / M, sensor)
    np.testing.assert_allclose(found, [M, distortion, 1 / (F + F / M)], rtol=precision, atol=1e-20)


# The fit


@given(
    alpha=st.floats(-3.1, 3.1), beta=st.floats(0.05, 0.5), gamma=st.floats(-0.5, 0.5),
    behind=st.booleans(), shift=st.tuples(st.floats(-500, 500), st.floats(-500, 500)),
    magnification=st.floats(0.8, 10), distortion=st.floats(-1e-9, 1e-9),
)  # fmt: skip
@settings(deadline=None, max_examples=25)
def test_exact_data_give_exact_pose_and_lens(
    alpha, beta, gamma, behind, shift, magnification, distortion
):
    f, turns = 2e5 / magnification, np.array([alpha, beta, gamma + np.pi * behind])
    scope = Microscope(2e5, f, f / magnification, distortion, *turns, *shift, **SENSOR)
    world = grid_in_view(scope, pitch=500 / magnification)
    image = scope.project(world)
    start = radial_alignment(world, (image - scope.principal_point) * scope.pitch)
    # It uses only the directions of the points, which are the same for either sign of the tilt.
    sign = [1, np.sign(start[1]), np.sign(start[1])]
    np.testing.assert_allclose(np.exp(1j * start[:3] * sign), np.exp(1j * turns), atol=1e-6)
    np.testing.assert_allclose(start[3:], shift, atol=1e-3)
    found = calibrate(world, image, focal_length=f, **SENSOR)
    assert found.reprojection.max < 1e-8
    assert found.microscope.magnification == pytest.approx(magnification, rel=1e-9)
    assert found.microscope.tube_length == pytest.approx(2e5, rel=1e-9)
    assert found.microscope.distortion == pytest.approx(distortion, abs=1e-16)
    angles = np.array([getattr(found.microscope, name) for name in POSE[:3]])
    np.testing.assert_allclose(np.exp(1j * angles), np.exp(1j * turns), atol=1e-6)


@pytest.mark.parametrize("focal_length", [None, F])
@pytest.mark.parametrize("count", [1, 3])
def test_exact_views_give_their_lens_and_no_further_parameters(count, focal_length):
    scopes, world, exact = (each[:count] for each in tilted_views())
    for factor in (1, 1 + 1e-15):  # exact points, and with other rounding errors
        image = [factor * points for points in exact]
        found = calibrate(world, image, focal_length=focal_length, **SENSOR)
        assert len(found.parameters) == 1 + (focal_length is None) + 6 * count
        assert found.undetermined == ()
        assert found.adequate
        for scope, view in zip(scopes, found.views, strict=True):
            assert view.focal_length == pytest.approx(F, rel=1e-7)
            assert view.magnification == pytest.approx(M, rel=1e-9)
            assert view.tilt == pytest.approx(scope.tilt, rel=1e-7)
            assert view.tx == pytest.approx(scope.tx, abs=1e-4)


@pytest.mark.parametrize("tilt", [2, 20])
def test_sigma_equals_cramer_rao_bound_and_intervals_cover(tilt):
    """The focal length is given. The share of 420 intervals is 95 % ± 1.1 % if they are
    independent; those of a run are correlated, so 91 to 99 % are accepted."""
    scope = tilted(tilt, 0.6 * tilt)
    world = grid_in_view(scope)
    names = ("magnification", "distortion", *POSE)
    truth = np.array([getattr(scope, name) for name in names])

    def projected(parameters):  # in focus: T_op = M f and d = f/M
        own = dict(zip(names, parameters, strict=True))
        m = own.pop("magnification")
        return replace(scope, tube_length=m * F, distance=F / m, **own).project(world)

    bound = np.sqrt(np.diag(numerical_bound(projected, truth)))
    stated, inside, errors = [], [], []
    for seed in range(60):
        found = calibrate(world, noisy(scope.project(world), seed), focal_length=F, **SENSOR)
        assert found.undetermined == ()
        stated.append([each.uncertainty for each in found.parameters.values()])
        errors.append(values(found) - truth)
        spans = [found.parameters[name].interval for name in names]
        inside.append([low <= t <= high for (low, high), t in zip(spans, truth, strict=True)])
    np.testing.assert_allclose(np.median(stated, axis=0), bound, rtol=0.25)
    # A standard deviation from 60 runs is good to 9 %; three times that.
    np.testing.assert_allclose(np.std(errors, axis=0), bound, rtol=0.3)
    assert 0.91 <= np.mean(inside) <= 0.99


def test_interval_of_focal_length_is_that_of_its_reciprocal():
    """Its ends are the reciprocals of 1/f ± t σ(1/f); other intervals are estimate ± t σ."""
    scope = tilted(10, 170)
    world = grid_in_view(scope)
    found = calibrate(world, noisy(scope.project(world), 0), **SENSOR)
    quantile = student.ppf(0.975, 2 * len(world) - 8)
    assert found.dof == 2 * len(world) - 8
    assert ", tilt 14.1°" in repr(found)  # its cosine is that of 10°, squared
    f, sigma = found.microscope.focal_length, found.parameters["focal_length"].uncertainty
    low, high = found.parameters["focal_length"].interval
    assert 1 / low == pytest.approx(1 / f + quantile * sigma / f**2, rel=1e-12)
    assert 1 / high == pytest.approx(1 / f - quantile * sigma / f**2, rel=1e-12)
    low, high = found.parameters["alpha"].interval
    assert (low + high) / 2 == pytest.approx(found.microscope.alpha, rel=1e-12)
    assert (high - low) / 2 == pytest.approx(
        quantile * found.parameters["alpha"].uncertainty, rel=1e-9
    )


@pytest.mark.parametrize("focal_length", [None, F])
def test_covariance_follows_from_numerical_derivatives_of_the_projection(focal_length):
    names = ("magnification", *POSE)
    names = ["focal_length", "distortion", "distortion_k2", "principal_x", "principal_y", *names,
             *(f"{name}_2" for name in names)]  # fmt: skip
    poses = [[1.6, 0.3, 0.2, -0.15, -900.0, -700], [1.5, -0.4, -0.25, 0.1, -850, -650]]
    truth = np.array([F, -8e-9, -3e-15, 14.0, -13.0, *np.ravel(poses)])
    world = grid_in_view(tilted(2, 1.5))

    def projected(parameters):
        images = []
        for magnification, *pose in parameters[5:].reshape(2, 6):
            # In focus T_op + f = f (1 + M), which is the same in both views.
            f = focal_length or parameters[0] * (1 + parameters[5]) / (1 + magnification)
            lengths = magnification * f, f, f / magnification
            lens = {"distortion_k2": parameters[2], "principal_offset": parameters[3:5]}
            scope = Microscope(*lengths, parameters[1], *pose, **SENSOR, **lens)
            images.append(scope.project(world))
        return np.array(images)

    shown = ((projected(truth) > 0) & (projected(truth) < [655, 490])).all(axis=(0, 2))
    # With more marks than parameters, 16 or 17, the covariance is that of leaving out each mark.
    world = world[np.random.default_rng(1).permutation(np.flatnonzero(shown))[:12]]
    image = noisy(projected(truth), 1)
    found = calibrate([world] * 2, list(image), focal_length=focal_length, **SENSOR)
    assert set(found.parameters) == set(names[1 if focal_length else 0 :])
    order, best = [names.index(name) for name in found.parameters], truth.copy()
    best[order] = values(found)

    def fitted(parameters):
        every = best.copy()
        every[order] = parameters
        return projected(every)

    left = (projected(best) - image).ravel()
    variance = left @ left / (len(left) - len(order))
    expected = variance / NOISE**2 * numerical_bound(fitted, best[order])
    assert found.p_value > 0.1  # otherwise the covariance includes the model discrepancy
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found.covariance / scale, expected / scale, atol=1e-3)


def test_covariance_of_squares_equals_leaving_out_one_square():
    """The closed form is compared with twelve calibrations that each leave out one square."""
    scope = replace(tilted(20, 15), tx=0, ty=0)
    grid = 4 * np.argwhere(np.ones((3, 4)))[:, None] + [[0, 0], [1, 0], [1, 1], [0, 1]]
    grid = grid.reshape(-1, 2)
    world = 180.0 * (grid - [4, 6]) @ [[0, 1], [-1, 0]]
    groups = np.arange(48) // 4
    image = noisy(scope.project(world), 2) + noisy(np.zeros((12, 2)), 3)[groups]
    whole = detection_of(world / 360, image, groups=groups, image_size=SENSOR["image_size"])

    def left_out(*which):
        kept = ~np.isin(groups, which)
        part = ("points", "grid", "uncertainty", "group", "positions")
        found = replace(whole, **{name: getattr(whole, name)[kept] for name in part})
        return calibrate(found, pitch=360, focal_length=F, pixel_pitch=SENSOR["pixel_pitch"])

    found = left_out()
    changes = np.array([values(left_out(g)) for g in range(12)]) - values(found)
    expected = 11 / 12 * changes.T @ changes
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # The closed form is exact for linear models only.
    np.testing.assert_allclose(found.covariance / scale, expected / scale, atol=0.03)


# What the points do not determine


@pytest.mark.parametrize("noise", [0.0, NOISE])
@pytest.mark.parametrize("views", [1, 3])
def test_focal_length_and_tilt_are_undetermined_for_parallel_planes(views, noise):
    """The last bit of exact points is random. With f given, exact points determine the tilt."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        f = 2e5 / rng.uniform(0.8, 5)
        lens = 2e5, f, f**2 / 2e5, rng.choice([0.0, -8.4e-10, 5e-10])
        scope = Microscope(*lens, rng.uniform(-3, 3), 0.0, rng.choice([0.0, np.pi]), 90.0, **SENSOR)
        worlds = [grid_in_view(scope, pitch=500 / scope.magnification)] * views
        exact = np.array([scope.project(world) for world in worlds])
        image = np.nextafter(exact, rng.choice([-1e9, 1e9], exact.shape))
        image = list(image + rng.normal(0, noise, exact.shape))
        found = calibrate(worlds, image, **SENSOR)
        ends = ["", *(f"_{view + 1}" for view in range(1, views))]
        assert found.undetermined == ("focal_length", *(n + e for e in ends for n in POSE[1:3]))
        assert found.adequate
        assert found.parameters["focal_length"].interval == (0, np.inf)  # a length is positive
        assert found.microscope.magnification == pytest.approx(scope.magnification, rel=2e-4)
        lost = np.isin(list(found.parameters), found.undetermined)
        assert np.isinf(found.covariance[lost, lost]).all()
        assert np.isnan(found.covariance[np.outer(lost, ~lost)]).all()
        assert np.isfinite(found.covariance[np.ix_(~lost, ~lost)]).all()
        # The microscope reproduces the points, exact ones with an f of a kilometer at most.
        assert found.microscope.focal_length < 1.001e9
        assert found.reprojection.rms < 1e-8 + 1.5 * noise
        assert "tilt" not in repr(found)
        assert "focal length not determined" in repr(found)
        assert f"\n  undetermined: {', '.join(found.undetermined)}" in repr(found)
        camera = json.loads(found.to_json())["opencv"]
        assert not any(np.ravel(camera[name]).any() for name in camera if "image" not in name)
        given = calibrate(worlds, image, focal_length=f, **SENSOR)
        assert noise or given.undetermined == ()
        assert given.adequate


def test_tilt_is_undetermined_where_perspective_is_lost_in_noise():
    """A far objective: foreshortening shows the tilt, perspective is lost in noise, so its sign is
    too."""
    f = 4e7
    scope = Microscope(1.6 * f, f, f / 1.6, 0.0, 0.3, 0.15, 0.1, 20, 30, **SENSOR)
    world = grid_in_view(scope)
    for seed in range(2):
        found = calibrate(world, noisy(scope.project(world), seed), focal_length=f, **SENSOR)
        assert {"beta", "gamma"} <= set(found.undetermined)
        assert np.isinf(found.parameters["beta"].uncertainty)
        camera = json.loads(found.to_json())["opencv"]
        assert camera["rotation_vectors"] == [None]
        assert camera["camera_matrix"][0][0] == found.microscope.principal_distance[0]
        assert np.isfinite(found.parameters["magnification"].uncertainty)


# Detections, and wrong input

WORLD = grid_in_view(SCOPE)
IMAGE = SCOPE.project(WORLD)
LINE = np.column_stack([np.arange(9.0), 2 * np.arange(9.0)])


def detection(scope):
    """The detection of a grid of 280 µm, without errors."""
    world = grid_in_view(scope)
    positions = (world - world.min(axis=0)) / 280 + 0.25
    return detection_of(positions, scope.project(world), image_size=scope.image_size)


FOUND = detection(SCOPE)
OTHER = [replace(FOUND, image_size=size) for size in ((656, 490), (657, 491))]
NO_SIZE = {"pixel_pitch": 9.9}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"world": [], "pitch": 400, **NO_SIZE}, "world must hold at least one view, got an empty"),
        ({"world": WORLD[:4], "image": IMAGE[:4], **SENSOR}, "at least 5"),
        ({"world": LINE, "image": IMAGE[:9], **SENSOR}, "world must not lie on one line"),
        ({"world": WORLD[:9], "image": LINE, **SENSOR}, "image must not lie on one line"),
        ({"world": np.tile(WORLD[[0, 1, 40]], (2, 1)), "image": np.tile(IMAGE[[0, 1, 40]], (2, 1)),
            **SENSOR}, "determine a pose"),
        ({"world": WORLD, "image": IMAGE, **SENSOR, "image_size": (491, 656)},
            r"image_size of \(width, height\)"),
        ({"world": WORLD, "image": IMAGE, **NO_SIZE}, "image_size must be given"),
        ({"world": WORLD, "image": IMAGE, "pitch": 4.0, **SENSOR}, "pitch must be left"),
        ({"world": [WORLD] * 2, "image": [IMAGE], **SENSOR}, "image must hold .* the 2 views"),
        ({"world": [WORLD] * 2, "image": np.array(np.nan), **SENSOR},
            "image must hold one array for each of the 2 views"),
        ({"world": WORLD / 1e6, "image": IMAGE, **SENSOR}, "give a magnification of 1.58.*e.06"),
        # In mm instead of µm. An earlier version called residuals as large as the image adequate.
        ({"world": WORLD, "image": IMAGE, "focal_length": 126, **SENSOR},
            "focal_length must fit each view .* got 126 µm"),
        ({"world": [WORLD] * 2, "image": [IMAGE] * 2, "focal_length": 1.5, **SENSOR},
            "focal_length must fit each view .* got 1.5 µm"),
        ({"world": FOUND, **NO_SIZE}, "pitch must be given"),
        ({"world": WORLD, "image": IMAGE, "image_size": (656, 491), "focal_length": F},
            "pixel_pitch must be given with focal_length"),
        ({"world": FOUND, "pitch": 400, **SENSOR}, "must not be given with"),
        ({"world": [FOUND, WORLD], "pitch": 400, **NO_SIZE}, "either detections or points"),
        ({"world": [FOUND, OTHER[0]], "pitch": 400, **NO_SIZE},
            "one size, got 656×490 and 656×491 px: leave out"),
        ({"world": [FOUND, OTHER[1]], "pitch": 400, **NO_SIZE}, "one size"),
    ],
)  # fmt: skip
def test_wrong_input_is_rejected_by_name(given, message):
    with pytest.raises(ValueError, match=message):
        calibrate(**given)


# A model that does not fit


@cache
def ten_calibrations(**lack):
    """Calibrations of noisy images of a pattern that lacks what the model assumes."""
    scope = tilted(12, 9)
    world = grid_in_view(scope)
    seen = imperfect_projection(scope, world, **lack)
    return [calibrate(world, noisy(seen, seed), **SENSOR) for seed in range(10)]


@pytest.mark.parametrize(
    "lack",
    [{"bend": 60.0}, {"aside": (8, -6)}, {"k2": 3e-17}],
    ids=["bent", "aside", "fifth order"],
)
def test_inadequate_model_has_small_p_value_and_larger_sigma(lack):
    adequate, sigma, widening, scale = {}, {}, {}, {}
    for name, each in (("exact", {}), ("lacking", lack)):
        found = ten_calibrations(**each)
        adequate[name] = np.mean([c.adequate for c in found])
        sigma[name] = np.median([c.parameters["focal_length"].uncertainty for c in found])
        widening[name] = np.median([c.widening for c in found])
        shares = [c.um_per_pixel.uncertainty / c.um_per_pixel.value for c in found]
        scale[name] = np.median(shares)
    assert adequate["lacking"] <= 0.1
    text = repr(found[0])
    start = f"Calibration of {len(found[0].residuals)} points in 1 view(s), "
    assert text.startswith(f"{start}{found[0].reprojection.rms:.3g} px rms residual")
    assert f"in the pattern's plane {found[0].plane_error.rms:.2g} µm rms; the" in text
    assert f"is {found[0].widening:.2g} times as wide" in text
    assert widening["exact"] == 1
    noise_alone = scale["lacking"] / widening["lacking"]
    # The noise is estimated from residuals that contain the discrepancy.
    assert 0.9 * scale["exact"] < noise_alone < scale["lacking"] / 2
    assert adequate["exact"] >= 0.9  # by chance, one in a thousand is not
    assert sigma["lacking"] > 2 * sigma["exact"]


def test_wide_angle_views_are_fitted_if_the_linear_distortion_is_too_large():
    """An earlier version rejected half of them, as the linear κ was outside the model's domain."""
    for seed in range(16):
        wide = {"principal": 210.0, "spacing": 36.0, "tilt": 0.7, "k1": 0.05 * (1 + seed % 2)}
        found = calibrate(*lens_views(1, **wide, seed=seed), **CAMERA)
        # OpenCV draws with Brown's polynomial, which is not the inverse of (2.10).
        assert found.reprojection.rms < 1.5
        assert not found.adequate


def test_fit_of_few_points_says_that_the_model_is_not_tested():
    """With 17 corners nothing can be tested: `adequate` stays True, and the summary says so."""
    (world,), (image,) = lens_views(1)
    many, few = calibrate(world, image, **CAMERA), calibrate(world[::5], image[::5], **CAMERA)
    assert np.isnan(few.lack_of_fit)
    assert few.adequate
    assert "too few marks to test whether the model is adequate" in repr(few)
    assert "too few" not in repr(many)
    # Of F, with the degrees of freedom of the parameters taken off, for some number of polynomials.
    smooth = np.arange(1, many.dof)
    p_values = fisher.sf(many.lack_of_fit**2, smooth, many.dof - smooth)
    assert np.isclose(p_values, many.p_value, rtol=1e-9).sum() == 1


# Several views


def test_views_drawn_by_opencv_give_its_lens():
    world, image = lens_views(4, aside=(14, -9), k2=0.15)
    found = calibrate(world, image, **CAMERA)
    assert {"principal_x", "principal_y", "distortion_k2"} <= set(found.parameters)
    # Both models of the lens have two terms; from the third on they differ, by a tenth of a pixel.
    principal = [(v.tube_length + v.focal_length) / 8 for v in found.views]
    assert np.ptp(principal) < 1e-9
    assert principal[0] == pytest.approx(900, abs=0.5)
    assert found.parameters["principal_x"].value == pytest.approx(14, abs=0.2)
    assert found.parameters["principal_y"].value == pytest.approx(-9, abs=0.2)
    assert found.reprojection.rms < 1.1 * NOISE * np.sqrt(2)
    assert found.plane_error.rms < 280 / 46 * 1.3 * NOISE * np.sqrt(2)
    assert found.adequate
    assert found.dof == 11 * 8 - 1  # the errors of a mark are the same in all views


def test_bic_leaves_out_needless_lens_parameters():
    _, world, exact = tilted_views()
    left_out = 0
    for seed in range(5):
        found = calibrate(world, [noisy(points, seed) for points in exact], **SENSOR)
        left_out += len(found.parameters) == 2 + 3 * 6
    assert left_out >= 4
    names = ["magnification", "focal_length", "distortion", *POSE, "magnification_2", "alpha_2"]
    assert list(found.parameters)[:10] == names


def test_held_out_error_is_that_of_the_true_lens():
    """If the model fits, it is that of the true lens; if the lens is wide, it exceeds the noise."""
    world, image = lens_views(5, aside=(14, -9))
    found = calibrate(world, image, **CAMERA)
    lens = np.array([[900, 0, 333.5], [0, 900, 230.5], [0, 0, 1]]), np.array([-0.2, 0, 0, 0, 0])
    for error, w, i in zip(found.held_out, world, image, strict=True):
        flat = np.column_stack([w, 0 * w[:, 0]])
        off = cv2.projectPoints(flat, *cv2.solvePnP(flat, i, *lens)[1:], *lens)[0][:, 0] - i
        assert error == pytest.approx(np.sqrt((off**2).sum(axis=1).mean()), rel=0.1)
    middle = np.array([319.5, 239.5])
    power = [np.linalg.norm(i - middle, axis=1, keepdims=True) ** 5 for i in image]
    wide = [i - 2e-14 * p * (i - middle) for i, p in zip(image, power, strict=True)]  # up to 15 px
    assert np.median(calibrate(world, wide, **CAMERA).held_out) > 3 * NOISE
    assert np.isnan(calibrate(world[:2], image[:2], **CAMERA).held_out).all()


def test_held_out_views_do_not_determine_their_lens():
    """A lens that was fitted without a view fits it worse than the lens of all views does."""
    world, image = lens_views(5, aside=(14, -9))
    some = np.random.default_rng(0).permutation(len(world[0]))[:10]
    found = calibrate([w[some] for w in world], [i[some] for i in image], **CAMERA)
    assert len(some) * np.sum(found.held_out**2) > 1.1 * np.sum(found.residuals**2)


@pytest.mark.parametrize("pixel_pitch", [8.0, None, (8.0, 6.5)])
def test_aspect_ratio_of_pixels_is_fitted_and_named(pixel_pitch):
    """Without the term, the rms residual is 1.1 px."""
    ratio = 1.03
    given = np.ptp(pixel_pitch) / 8.0 if np.ndim(pixel_pitch) else 0.0
    world, image = lens_views(4, pixel=ratio * (1 - given), aside=(14, -9))
    found = calibrate(world, image, pixel_pitch=pixel_pitch, image_size=(640, 480))
    aspect = found.parameters["pixel_aspect"]
    assert abs(aspect.value - ratio) < 4 * aspect.uncertainty < 4e-4
    assert found.adequate
    assert np.median(found.held_out) < 1.2 * NOISE * np.sqrt(2)
    assert "the pixels or the print are not square: ratio 1.0" in repr(found)
    unsure = Estimate(1.03, 0.02, 0.99, 1.07, "")  # the interval contains square pixels
    assert "square" not in repr(
        replace(found, parameters={**found.parameters, "pixel_aspect": unsure})
    )
    hold_residuals(found, world, image)
    height = json.loads(found.to_json())["imagej"]["pixel_height"]
    assert height / found.um_per_pixel.value == pytest.approx(ratio * (1 - given), rel=1e-4)
    assert found.um_per_pixel.value == pytest.approx(280 / 46, rel=0.02)


def test_print_that_is_not_square_is_named_with_the_ratio_that_mends_it():
    world, image = lens_views(4, printed=1.02)
    found = calibrate(world, image, **CAMERA)
    assert found.print_aspect == pytest.approx(1.02, abs=5e-4)
    assert not found.adequate
    assert "the print is not square: ratio 1.020" in repr(found)
    assert np.median(found.held_out) > 0.5
    boards = [detection_of(w / 280, points) for w, points in zip(world, image, strict=True)]
    mended = calibrate(boards, pitch=(280, 280 * found.print_aspect), pixel_pitch=8.0)
    assert mended.adequate
    assert mended.print_aspect == 1
    assert np.median(mended.held_out) < 1.2 * NOISE * np.sqrt(2)
    assert "square" not in repr(mended)
    assert "square" not in repr(calibrate(*lens_views(4, bend=60.0), **CAMERA))


def skipped(world, image, rng):
    """As if every second row of a board had been skipped."""
    return world * [1, 2], image


def sheared(world, image, rng):
    return world @ np.array([[1.0, 0.0], [1.0, 1.0]]), image


def zoomed(world, image, rng):
    """Through another lens."""
    middle = np.array([319.5, 239.5])
    return world, (image - middle) * rng.uniform(0.3, 0.6) + middle + rng.uniform(-60, 60, 2)


def exchanged(world, image, rng):
    """Marks with wrong places: all of them fit no microscope."""
    return rng.permutation(world), image


@pytest.mark.parametrize(
    ("fault", "count", "wrong"),
    [
        *((fault, 3, [2]) for fault in (skipped, sheared, zoomed, exchanged)),
        *((fault, 4, [0, 1]) for fault in (skipped, exchanged)),
        (zoomed, 6, [2]),
        (sheared, 8, [1, 4, 5, 7]),
    ],
)
def test_inconsistent_views_are_named_up_to_half_of_them(fault, count, wrong):
    world, image = lens_views(count, aside=(14, -9))
    rng = np.random.default_rng(0)
    for view in wrong:
        world[view], image[view] = fault(world[view], image[view], rng)
    numbers = ", ".join(str(view + 1) for view in wrong)
    if fault is exchanged:
        with pytest.raises(ValueError, match=f"leave out view {numbers}, counted") as refusal:
            calibrate(world, image, **CAMERA)
        assert list(refusal.value.views) == wrong
        return
    found = calibrate(world, image, **CAMERA)
    assert list(found.inconsistent) == wrong
    assert f"inconsistent, to be left out: view {numbers}, counted from 1" in repr(found)
    median, most = np.nanmedian(found.held_out), np.nanmax(found.held_out)
    assert f"held-out views: median {median:.3g} px rms, most {most:.3g}" in repr(found)
    assert not found.adequate
    if fault is skipped and count == 3:  # the error of 2/3 of the board's size
        assert found.held_out[2] > 10 > 1 > found.held_out[:2].max()
    right = np.setdiff1d(range(count), wrong)
    rest = calibrate([world[v] for v in right], [image[v] for v in right], **CAMERA)
    assert rest.inconsistent == ()
    assert rest.reprojection.rms < 1.2 * NOISE * np.sqrt(2)


def test_intervals_cover_for_an_imprecise_pattern():
    """Printed marks are displaced by 0.13 px, the same in all views; the noise is 0.02 px."""
    inside = 0
    for seed in range(10):
        found = calibrate(*lens_views(3, shift=0.8, aside=(6, 4), seed=seed), **CAMERA)
        low, high = found.parameters["focal_length"].interval
        inside += low <= 900 * 8 / (1 + found.microscope.magnification) <= high
    assert inside >= 7  # of ten 95 % intervals, with a probability of 99.9 %


# The result as one object


def test_plot_of_a_calibration_rejects_other_detections():
    one = detection(SCOPE)
    found = calibrate(one, pitch=280, pixel_pitch=SENSOR["pixel_pitch"], focal_length=F)
    for other in ([one, one], [detection(tilted(20, 10))], []):
        with pytest.raises(ValueError, match="found must hold the detections of the 1 calibrated"):
            found.plot(found=other)


@pytest.mark.parametrize("pixel_pitch", [8.0, None])
@pytest.mark.parametrize("count", [1, 4])
def test_residuals_are_image_points_minus_projection_by_the_views(count, pixel_pitch):
    """In the image and in the plane, with every term that the fit has."""
    world, image = lens_views(count, aside=(14, -9), k2=0.15)
    found = calibrate(world, image, pixel_pitch=pixel_pitch, image_size=(640, 480))
    assert ("distortion_k2" in found.parameters) is (count > 1)
    sensor, unit = "µm" if pixel_pitch else "px", found.to_frame()["unit"]
    units = {"^(focal|tx|ty)": "µm", "^(alpha|beta|gamma)": "rad", "^magni": "", "^px_": "px/µm"}
    units |= {"^principal": "px", "distortion$": f"1/{sensor}²", "distortion_k2": f"1/{sensor}⁴"}
    for kind, wanted in units.items():
        assert {*unit.filter(regex=kind)} <= {wanted}
    assert found.um_per_pixel.unit == "µm/px"
    hold_residuals(found, world, image)


def hold_residuals(found, world, image, *, deviation=0.05):
    """The views leave the residuals that the result states, in the image and in the plane."""
    views = list(zip(found.views, world, image, strict=True))
    left = np.concatenate([seen - view.project(points) for view, points, seen in views])
    np.testing.assert_allclose(found.residuals, left, atol=1e-9)
    size = np.hypot(*left.T)
    statistics = size.mean(), size.std(), size.max(), np.sqrt(np.mean(size**2))
    assert tuple(vars(found.reprojection).values()) == pytest.approx(statistics, rel=1e-6)
    left = np.concatenate([view.back_project(seen) - points for view, points, seen in views])
    np.testing.assert_allclose(found.plane_residuals, left, atol=1e-6)
    assert found.microscope == found.views[0]
    again = Calibration.from_json(found.to_json())
    assert again.views == found.views
    # The files lead OpenCV to the same residuals.
    camera = json.loads(found.to_json())["opencv"]
    left = [i - seen for i, seen in zip(image, seen_by_opencv(camera, world), strict=True)]
    allowed = camera["distortion_model_error_px"] + 1e-6
    np.testing.assert_allclose(np.concatenate(left), found.residuals, atol=allowed)
    assert allowed < deviation


@pytest.mark.parametrize("views", [1, 6])
def test_residuals_of_photographs_are_those_of_the_views(views):
    """Photographs of a chessboard, whose lens has all terms of the model."""
    files = sorted(CHESSBOARD.glob("*.jpg"))[:views]
    boards = [detect_squares(cv2.imread(str(f), 0), pattern="chessboard") for f in files]
    found = calibrate(boards, pitch=1.0)
    assert found.reprojection.rms < (0.2 if views > 1 else 0.35)
    # With κ alone, the inverse of (2.10) differs from OpenCV's three terms by a tenth of a pixel.
    deviation = 0.05 if views > 1 else 0.15
    positions, points = ([getattr(each, n) for each in boards] for n in ("positions", "points"))
    hold_residuals(found, positions, points, deviation=deviation)


def test_principal_distance_and_scale_need_no_pixel_pitch():
    """What one photograph determines: (T_op + f)/s in px and s/M in µm/px; no f, no M."""
    scope = replace(tilted(15, 10), pixel_pitch=9.9)
    world = grid_in_view(scope)
    inside = []
    for seed in range(40):
        image = noisy(scope.project(world), seed)
        found = calibrate(world, image, image_size=scope.image_size)
        assert not {"magnification", "focal_length"} & set(found.parameters)
        assert found.pixel_pitch is None
        assert "magnification" not in repr(found)
        assert "focal" not in repr(found)
        assert "px (95 %" in repr(found)
        truth = {"um_per_pixel": 9.9 / M, "principal_distance": scope.principal_distance[0]}
        spans = {name: getattr(found, name) for name in truth}
        inside += [spans[name].low <= truth[name] <= spans[name].high for name in truth]
    assert np.mean(inside) >= 0.88  # of 80, 95 % with a probability of a thousandth
    known = calibrate(world, image, image_size=scope.image_size, pixel_pitch=9.9)
    for name in truth:
        one, other = (vars(getattr(each, name)) for each in (found, known))
        assert one.pop("unit") == other.pop("unit")
        np.testing.assert_allclose(list(one.values()), list(other.values()), rtol=1e-4)
    # With a given focal length the principal distance follows from the magnification.
    camera = {"image_size": scope.image_size, "pixel_pitch": (9.9, 11.0)}
    image = replace(scope, **camera).project(world)
    given = calibrate(world, image, **camera, focal_length=F)
    assert given.pixel_pitch == (9.9, 11.0)
    assert given.principal_distance.value == pytest.approx(F * (1 + M) / 9.9, rel=1e-9)
