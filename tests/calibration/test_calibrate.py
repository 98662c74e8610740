"""Calibration against exact data, the Cramér–Rao bound, Monte Carlo and OpenCV."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import t as student

from microlib.calibration import (
    Detection,
    calibrate,
    cramer_rao,
    detect_squares,
    linear_intrinsics,
    radial_alignment,
)
from microlib.microscope import Microscope
from microlib.synthetic import render_squares

DEGREE = np.pi / 180
F = 126150.0
SENSOR = {"pixel_size": 9.9, "image_size": (656, 491)}
POSE = ("distortion", "alpha", "beta", "gamma", "tx", "ty")
NOISE = 0.02


def scope_with(beta=2.0, gamma=1.5, **change):
    """In focus, magnification 1.59, angles in degrees."""
    base = Microscope(
        1.59 * F, F, F / 1.59, -8.4e-10, 1.5, beta * DEGREE, gamma * DEGREE, -781, -55
    )
    return replace(base, **change)


def grid_in_view(scope, pitch=280.0):
    index = np.arange(-40, 41)
    world = pitch * np.stack(np.meshgrid(index, index), axis=-1).reshape(-1, 2)
    seen = scope.project(world)
    return world[((seen > 5) & (seen < [650, 485])).all(axis=1)]


def tilted_views():
    """Three views of a plane, its points in µm, and where they are seen exactly, px."""
    scopes = [scope_with(beta=b, gamma=c) for b, c in ((12, 3), (-5, 10), (4, -14))]
    world = [grid_in_view(scope) for scope in scopes]
    return scopes, world, [s.project(w) for s, w in zip(scopes, world, strict=True)]


def truth_of(scope, names):
    return np.array([getattr(scope, name) for name in names])


def repeat(scope, world, seeds, **options):
    image = scope.project(world)
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        yield calibrate(world, image + rng.normal(0, NOISE, image.shape), **SENSOR, **options)


# The linear start


@given(
    alpha=st.floats(-3.1, 3.1),
    beta=st.floats(0.05, 0.5),
    gamma=st.floats(-0.5, 0.5),
    behind=st.booleans(),
    distortion=st.floats(-2e-9, 2e-9),
    shift=st.tuples(st.floats(-500, 500), st.floats(-500, 500)),
)
@settings(deadline=None, max_examples=40)
def test_radial_alignment_is_exact_for_any_lens(alpha, beta, gamma, behind, distortion, shift):
    gamma += np.pi * behind
    scope = Microscope(2e5, 1.3e5, 8e4, distortion, alpha, beta, gamma, *shift)
    world = grid_in_view(scope)
    sensor = (scope.project(world) - scope.principal_point) * 9.9
    found = radial_alignment(world, sensor)
    assert np.isclose(np.abs(np.sin(found[1])), np.abs(np.sin(beta)), rtol=0, atol=1e-7)
    # The tilt's sign is open: either pose, the pattern's directions are the same.
    sign = np.sign(found[1]) * np.sign(beta)
    expected = np.array([alpha, sign * beta, sign * gamma])
    np.testing.assert_allclose(np.exp(1j * found[:3]), np.exp(1j * expected), atol=1e-6)
    np.testing.assert_allclose(found[3:], shift, atol=1e-3)


@pytest.mark.parametrize(
    ("distortion", "precision"),
    # With both distortion and perspective their product is left out: 1.3 % of h at the corner.
    [(0.0, 1e-9), (-8.4e-10, 0.013)],
)
def test_linear_intrinsics(distortion, precision):
    scope = scope_with(distortion=distortion)
    world = grid_in_view(scope)
    frame = scope.to_objective(world)
    sensor = (scope.project(world) - scope.principal_point) * 9.9
    depth = frame[:, 2] - F - F / 1.59
    found = linear_intrinsics(frame[:, :2], depth, sensor)
    truth = [1.59, distortion, 1 / (F + F / 1.59)]
    np.testing.assert_allclose(found, truth, rtol=precision, atol=1e-20)


# The fit


@given(
    alpha=st.floats(-3, 3),
    beta=st.floats(-0.2, 0.2),
    gamma=st.floats(-0.2, 0.2),
    behind=st.booleans(),
    magnification=st.floats(0.8, 10),
    distortion=st.floats(-1e-9, 1e-9),
)
@settings(deadline=None, max_examples=25)
def test_exact_data_gives_exact_parameters(alpha, beta, gamma, behind, magnification, distortion):
    gamma += np.pi * behind
    f = 2e5 / magnification
    scope = Microscope(2e5, f, f / magnification, distortion, alpha, beta, gamma, 30.0, -20.0)
    world = grid_in_view(scope, pitch=500 / magnification)
    found = calibrate(world, scope.project(world), focal_length=f, **SENSOR)
    assert found.reprojection.max < 1e-8
    assert found.microscope.magnification == pytest.approx(magnification, rel=1e-9)
    assert found.microscope.tube_length == pytest.approx(2e5, rel=1e-9)
    assert found.microscope.distortion == pytest.approx(distortion, abs=1e-16)
    turns = np.array([found.microscope.alpha, found.microscope.beta, found.microscope.gamma])
    np.testing.assert_allclose(
        np.exp(1j * turns), np.exp(1j * np.array([alpha, beta, gamma])), atol=1e-6
    )


def test_focal_length_follows_from_a_tilted_plane():
    scope = scope_with(10, 170)
    world = grid_in_view(scope)
    found = calibrate(world, scope.project(world), **SENSOR)
    assert found.microscope.focal_length == pytest.approx(F, rel=1e-7)
    assert found.microscope.gamma == pytest.approx(170 * DEGREE, rel=1e-7)
    assert found.undetermined == ()


@pytest.mark.parametrize("tilt", [2, 20])
def test_sigma_equals_cramer_rao_bound_and_intervals_cover(tilt):
    """f given. 60 runs of 7 parameters: 95 % ± 1.1 % if independent; correlated, allow 91 to 99
    %."""
    scope = scope_with(tilt, 0.6 * tilt)
    world = grid_in_view(scope)
    names = ("magnification", *POSE)
    bound = np.sqrt(np.diag(cramer_rao(scope, world, NOISE, names)))
    truth = truth_of(scope, names)
    stated, inside, errors = [], [], []
    for found in repeat(scope, world, 60, focal_length=F):
        assert found.undetermined == ()
        stated.append(list(found.sigma.values()))
        errors.append(found.estimate - truth)
        spans = [found.interval(name) for name in names]
        inside.append([low <= t <= high for (low, high), t in zip(spans, truth, strict=True)])
    np.testing.assert_allclose(np.median(stated, axis=0), bound, rtol=0.25)
    # Scatter over 60 runs: ±9 %; three of them.
    np.testing.assert_allclose(np.std(errors, axis=0), bound, rtol=0.3)
    assert 0.91 <= np.mean(inside) <= 0.99
    assert np.abs(np.array(errors)[:, 0]).max() / scope.magnification < 1e-4


def test_focal_length_is_undetermined_for_a_parallel_plane():
    scope = scope_with(0, 180)
    world = grid_in_view(scope)
    for found in repeat(scope, world, 5):
        assert {"focal_length", "beta", "gamma"} <= set(found.undetermined)
        assert np.isinf(found.sigma["focal_length"])
        assert found.microscope.magnification == pytest.approx(1.59, rel=2e-4)
    exact = calibrate(world, scope.project(world), **SENSOR)
    lost = np.isin(exact.parameters, exact.undetermined)
    assert exact.interval("focal_length", 1e-60) == (0, np.inf)  # a length is positive
    assert np.isinf(exact.covariance[lost, lost]).all()
    assert np.isnan(exact.covariance[np.outer(lost, ~lost)]).all()
    assert np.isfinite(exact.covariance[np.ix_(~lost, ~lost)]).all()


def disturbed(points, rng):
    """Points as they are, and as another order of the same arithmetic would have them."""
    yield points
    yield np.nextafter(points, np.inf)
    yield np.nextafter(points, rng.choice([-1e9, 1e9], points.shape))
    yield points * (1 + 1e-15 * rng.normal(size=points.shape))


def test_rounding_does_not_change_undetermined_parameters():
    """Exact points of many parallel planes: f and the tilt are lost, and the tilt with f is not."""
    for plane in range(6):
        rng = np.random.default_rng(plane)
        f = 2e5 / rng.uniform(0.8, 5)
        scope = Microscope(
            2e5,
            f,
            f**2 / 2e5,
            rng.choice([0.0, -8.4e-10, 5e-10]),
            alpha=rng.uniform(-3, 3),
            gamma=rng.choice([0.0, np.pi]),
            tx=rng.uniform(-300, 300),
        )
        world = grid_in_view(scope, pitch=500 / scope.magnification)
        for seen in disturbed(scope.project(world), rng):
            blind = calibrate(world, seen, **SENSOR)
            assert blind.undetermined == ("focal_length", "beta", "gamma")
            given = calibrate(world, seen, focal_length=f, **SENSOR)
            assert given.undetermined == ()
            assert blind.adequate
            assert given.adequate


def test_rounding_does_not_add_lens_parameters():
    _, world, exact = tilted_views()
    rng = np.random.default_rng(0)
    for seen in zip(*(disturbed(points, rng) for points in exact), strict=True):
        found = calibrate(world, seen, **SENSOR)
        assert len(found.parameters) == 2 + 3 * 6
        assert found.undetermined == ()
        assert found.adequate


def test_tilt_is_undetermined_if_its_sign_is():
    """A far objective: foreshortening shows the tilt, perspective is lost in noise, so its sign is
    too."""
    f = 4e7
    scope = Microscope(1.6 * f, f, f / 1.6, 0.0, 0.3, 0.15, 0.1, 20, 30)
    world = grid_in_view(scope)
    for found in repeat(scope, world, 5, focal_length=f):
        assert {"beta", "gamma"} <= set(found.undetermined)
        assert np.isinf(found.sigma["beta"])
        assert np.isfinite(found.sigma["magnification"])


def test_interval_of_focal_length_is_that_of_its_reciprocal():
    """1/f ± t σ(1/f), turned over; the others straight; both widen with the level."""
    scope = scope_with(10, 170)
    world = grid_in_view(scope)
    found = next(iter(repeat(scope, world, 1)))
    quantile = student.ppf(0.95, 2 * len(world) - 8)
    assert found.dof == 2 * len(world) - 8
    f, sigma = found.microscope.focal_length, found.sigma["focal_length"]
    low, high = found.interval("focal_length", 0.9)
    assert 1 / low == pytest.approx(1 / f + quantile * sigma / f**2, rel=1e-12)
    assert 1 / high == pytest.approx(1 / f - quantile * sigma / f**2, rel=1e-12)
    low, high = found.interval("alpha", 0.9)
    assert (low + high) / 2 == pytest.approx(found.microscope.alpha, rel=1e-12)
    assert (high - low) / 2 == pytest.approx(quantile * found.sigma["alpha"], rel=1e-9)


def test_covariance_of_squares_equals_leaving_out_one_square():
    """In closed form, against leaving out one square after the other and calibrating again."""
    scope = scope_with(20, 15)
    cells = 800.0 * np.argwhere(np.ones((3, 4)))
    corners = 200.0 * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    world = (cells[:, None] + corners).reshape(-1, 2)
    world = np.round((world - world.mean(axis=0)) @ [[0, 1], [-1, 0]])
    groups = np.arange(48) // 4
    rng = np.random.default_rng(2)
    image = (
        scope.project(world) + rng.normal(0, NOISE, (48, 2)) + rng.normal(0, NOISE, (12, 2))[groups]
    )
    grid = np.round((world - world.min(axis=0)) / 200).astype(int)
    sigma = np.full(48, NOISE)
    whole = Detection(image, grid, sigma, groups, world / 400, 0.5, 1.0, (656, 491))

    def left_out(*which):
        kept = ~np.isin(groups, which)
        part = {n: getattr(whole, n)[kept] for n in ("points", "grid", "sigma", "group")}
        found = replace(whole, **part, positions=whole.positions[kept])
        return calibrate(found, pitch=400, focal_length=F, pixel_size=9.9)

    found = left_out()
    left = np.array([left_out(g).estimate for g in range(12)])
    spread = left - found.estimate
    expected = 11 / 12 * spread.T @ spread
    sigma = np.sqrt(np.diag(expected))
    # The closed form is that of a linear problem.
    np.testing.assert_allclose(
        found.covariance / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=0.03
    )


def test_detections_need_only_pitch_and_pixel_size():
    scope = Microscope(2e5, 126000, 79380, tx=-450, ty=-330, beta=0.1, image_size=(260, 220))
    views = [scope, replace(scope, beta=-0.15, gamma=0.1)]
    found = [detect_squares(render_squares(view)) for view in views]
    sensor = {"pixel_size": 9.9, "focal_length": 126000.0}
    one = calibrate(found[0], pitch=400, **sensor)
    world, size = 400 * found[0].positions, {"image_size": (260, 220)}
    assert one.microscope == calibrate(world, found[0].points, **sensor, **size).microscope
    both = calibrate(found, pitch=400, **sensor)
    assert [v.beta for v in both.views] == pytest.approx([0.1, -0.15], abs=1e-3)
    for wrong, word in (
        ({"world": found[0]}, "pitch must be given"),
        ({"world": found[0], "pitch": 400, "image_size": (260, 220)}, "must not be given with"),
        ({"world": [found[0], world], "pitch": 400}, "either detections or points"),
        *(
            ({"world": [found[0], replace(found[1], image_size=size)], "pitch": 400}, "one size")
            for size in ((260, 221), (261, 220))
        ),
        ({"world": world, "image": found[0].points}, "image_size must be given"),
        ({"world": world, "image": found[0].points, "pitch": 4.0, **size}, "pitch must be left"),
    ):
        with pytest.raises(ValueError, match=word):
            calibrate(**wrong, **sensor)


# Bad input

WORLD = grid_in_view(scope_with())
IMAGE = scope_with().project(WORLD)
LINE = np.column_stack([np.arange(9.0), 2 * np.arange(9.0)])


@pytest.mark.parametrize(
    ("world", "image", "change", "word"),
    [
        (WORLD[:4], IMAGE[:4], {}, "at least 5"),
        (WORLD, IMAGE[:-1], {}, "same length"),
        (LINE, IMAGE[:9], {}, "world must not lie on one line"),
        (WORLD[:9], LINE, {}, "image must not lie on one line"),
        (np.zeros((9, 2)), IMAGE[:9], {}, "world"),
        (WORLD[[0, 1, 40, 0, 1, 40]], IMAGE[[0, 1, 40, 0, 1, 40]], {}, "determine a pose"),
        (WORLD, IMAGE, {"image_size": (491, 656)}, r"image_size of \(width, height\)"),
    ],
)
def test_wrong_input_is_rejected_by_name(world, image, change, word):
    with pytest.raises(ValueError, match=word):
        calibrate(world, image, **{"focal_length": F, **SENSOR, **change})


# A model that does not fit


def seen_by_a_lens(scope, world, *, bend=0.0, aside=(0.0, 0.0), fifth=0.0):
    """Image points of a pattern on a bent plane, an axis aside, and a distortion of fifth order."""
    turned = np.column_stack([world, bend * (world[:, 0] / 2000) ** 2]) @ scope.rotation.T
    depth = 1 + turned[:, 2] / (scope.focal_length + scope.distance)
    flat = scope.magnification * (turned[:, :2] + [scope.tx, scope.ty]) / depth[:, None] / 9.9
    third = scope.distortion * 9.9**2
    square = (flat**2).sum(axis=1, keepdims=True)
    inverse = 1 - third * square + (3 * third**2 + fifth) * square**2 - 12 * (third * square) ** 3
    return flat * inverse + scope.principal_point + aside


@pytest.mark.parametrize(
    ("lack", "adequate"),
    [({}, True), ({"bend": 60.0}, False), ({"aside": (8, -6)}, False), ({"fifth": 3e-13}, False)],
    ids=["none", "bent", "aside", "fifth order"],
)
def test_inadequate_model_has_small_p_value_and_larger_sigma(lack, adequate):
    scope = scope_with(beta=12, gamma=9)
    world = grid_in_view(scope)
    said, sigmas = [], []
    for seed in range(10):
        noise = np.random.default_rng(seed).normal(0, NOISE, world.shape)
        found = calibrate(world, seen_by_a_lens(scope, world, **lack) + noise, **SENSOR)
        said.append(found.adequate)
        sigmas.append(found.sigma["focal_length"])
    # One in a thousand by chance; seen_by_a_lens ends the inverse of (2.10) after three terms,
    # within 0.001 px.
    assert np.mean(said) >= 0.9 if adequate else np.mean(said) <= 0.1
    exact = [c.sigma["focal_length"] for c in repeat(scope, world, 3)]
    assert (
        np.median(sigmas) < 1.5 * np.median(exact) if adequate else np.median(sigmas) > 2 * exact[0]
    )


@pytest.mark.parametrize("distortion", [0.05, 0.1])
def test_wide_angle_views_are_fitted_if_the_linear_distortion_is_too_large(distortion):
    """The linear κ was outside the domain of the model, and half of the views were rejected."""
    camera = np.array([[210.0, 0, 319.5], [0, 210, 239.5], [0, 0, 1]])
    board = 280.0 * np.stack(np.meshgrid(np.arange(11), np.arange(8)), -1).reshape(-1, 2)
    board -= board.mean(axis=0)
    flat = np.column_stack([board, 0 * board[:, 0]])
    for seed in range(20):
        rng = np.random.default_rng(seed)
        rotation = cv2.Rodrigues(rng.uniform(-0.7, 0.7, 3))[0]
        place = np.array([*rng.uniform(-400, 400, 2), 280 * 210 / 36])
        seen = cv2.projectPoints(flat, rotation, place, camera, np.array([distortion, 0, 0, 0.0]))
        seen = seen[0][:, 0] + rng.normal(0, NOISE, board.shape)
        inside = ((seen >= 0) & (seen <= [639, 479])).all(axis=1)
        found = calibrate(board[inside], seen[inside], **CAMERA)
        # Brown's polynomial is not the inverse of (2.10).
        assert found.reprojection.rms < 1.5
        assert not found.adequate


# Several views


def lens_views(count, *, aside=(0.0, 0.0), second=0.0, seed=0, noise=NOISE, shift=0.0, bend=0.0):
    """Tilted views through one lens of principal distance 900 px, independent of the library's."""
    rng = np.random.default_rng(seed)
    world = 280.0 * np.stack(np.meshgrid(np.arange(11), np.arange(8)), -1).reshape(-1, 2)
    world = world - world.mean(axis=0)
    made = world + rng.normal(0, 1, world.shape) * shift
    worlds, images = [], []
    for _ in range(count):
        rotation = cv2.Rodrigues(rng.uniform(-0.4, 0.4, 3))[0]
        lens = np.array([-0.2, second, 0, 0, 0])
        camera = np.array([[900.0, 0, 319.5 + aside[0]], [0, 900, 239.5 + aside[1]], [0, 0, 1]])
        seen, _ = cv2.projectPoints(
            np.column_stack([made, bend * (made[:, 0] / 1400) ** 2]),
            rotation,
            np.array([30.0, -20, 280 * 900 / 46]),
            camera,
            lens,
        )
        seen = seen[:, 0] + rng.normal(0, noise, world.shape)
        shown = ((seen >= 0) & (seen <= [639, 479])).all(axis=1)
        worlds.append(world[shown])
        images.append(seen[shown])
    return worlds, images


CAMERA = {"pixel_size": 8.0, "image_size": (640, 480)}


def principal_distance(found):
    """In px, of each view."""
    return [(v.tube_length + v.focal_length) / 8 for v in found.views]


def projected(values, world, view, cell, focal_length):
    """Image points of one view from lens and poses, real or complex, by Newton's method for κ."""
    inverse_distance, kappa, kappa_2, *center = values[:5]
    magnification, alpha, beta, gamma, tx, ty = values[5 + 6 * view : 11 + 6 * view]
    if focal_length is not None:
        inverse_distance = 1 / (focal_length * (1 + magnification))
    zero, one = 0 * alpha, 1 + 0 * alpha
    rotation = (
        np.array([[np.cos(alpha), -np.sin(alpha), zero], [np.sin(alpha), np.cos(alpha), zero],
                  [zero, zero, one]])
        @ np.array([[np.cos(beta), zero, np.sin(beta)], [zero, one, zero],
                    [-np.sin(beta), zero, np.cos(beta)]])
        @ np.array([[one, zero, zero], [zero, np.cos(gamma), -np.sin(gamma)],
                    [zero, np.sin(gamma), np.cos(gamma)]])
    )  # fmt: skip
    x, y, z = rotation[:, :2] @ world.T
    straight = np.array([x + tx, y + ty]) / (1 / magnification + inverse_distance * z)
    length = np.sqrt((straight**2).sum(axis=0))  # of complex numbers, too
    radius = length
    for _ in range(30):  # r (1 + κ r²) is the undistorted radius
        radius = radius - (radius + kappa * radius**3 - length) / (1 + 3 * kappa * radius**2)
    sensor = straight * radius / length
    return (sensor * (1 + kappa_2 * (sensor**2).sum(axis=0) ** 2)).T / cell + np.array(center)


@pytest.mark.parametrize("focal_length", [None, F])
def test_covariance_follows_from_complex_step_derivatives(focal_length):
    """Of an independent projection: Im p(x + i h)/h is exact to rounding."""
    cell, center = np.array([9.9, 8.3]), np.array([327.5, 245.0])
    sensor = {"pixel_size": (9.9, 8.3), "image_size": (656, 491), "focal_length": focal_length}
    poses = [[1.6, 0.3, 0.2, -0.15, -900.0, -700], [1.5, -0.4, -0.25, 0.1, -850, -650]]
    truth = np.array([1 / (2.6 * F), -8e-9, 3e-15, 14.0, -13.0, *np.ravel(poses)])
    rng = np.random.default_rng(1)
    every = grid_in_view(scope_with())
    seen = [projected(truth, every, view, cell, focal_length) + center for view in (0, 1)]
    shown = np.all([((s > 0) & (s < 2 * center)).all(axis=1) for s in seen], axis=0)
    some = rng.permutation(np.flatnonzero(shown))[:12]  # with 17 marks a jackknife would be made
    world, image = [every[some]] * 2, [s[some] + rng.normal(0, NOISE, (12, 2)) for s in seen]
    found = calibrate(world, image, **sensor)
    names = [n if v == 1 else f"{n}_2" for v in (1, 2) for n in ("magnification", *POSE[1:])]
    names = ["focal_length", "distortion", "distortion_k2", "principal_x", "principal_y", *names]
    assert set(found.parameters) == set(names[1 if focal_length else 0 :])
    values = truth.copy()
    values[[names.index(n) for n in found.parameters]] = found.estimate

    def residuals(change):
        lens, both = values + change, []
        lens[0] = 1 / (lens[0] * (1 + lens[5])) if focal_length is None else lens[0]
        for view, (w, i) in enumerate(zip(world, image, strict=True)):
            both.append(projected(lens, w, view, cell, focal_length) + center - i)
        return np.concatenate(both).ravel()

    steps = [1e-30 * values[names.index(n)] * np.eye(17)[names.index(n)] for n in found.parameters]
    jacobian = np.transpose([residuals(1j * h).imag / h[h != 0] for h in steps])
    left = residuals(0j).real
    variance = left @ left / (len(left) - len(steps))
    expected = variance * np.linalg.inv(jacobian.T @ jacobian)
    assert found.p_value > 0.1  # otherwise the covariance includes the model discrepancy
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found.covariance / scale, expected / scale, atol=1e-3)


def test_several_views_agree_with_opencv():
    world, image = lens_views(4, aside=(14, -9), second=0.15)
    found = calibrate(world, image, **CAMERA)
    assert {"principal_x", "principal_y", "distortion_k2"} <= set(found.parameters)
    estimate = dict(zip(found.parameters, found.estimate, strict=True))
    flat = [np.column_stack([w, 0 * w[:, 0]]).astype(np.float32) for w in world]
    flags = cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    flags |= cv2.CALIB_USE_INTRINSIC_GUESS
    start = np.array([[900.0, 0, 319.5], [0, 900, 239.5], [0, 0, 1]])
    _, camera, *_ = cv2.calibrateCamera(
        flat, [i.astype(np.float32) for i in image], (640, 480), start, np.zeros(5), flags=flags
    )
    # Two models of one lens with two terms each, which part in the third: a tenth of a pixel.
    assert np.ptp(principal_distance(found)) < 1e-9
    assert principal_distance(found)[0] == pytest.approx(camera[0, 0], abs=0.5)
    assert estimate["principal_x"] == pytest.approx(camera[0, 2] - 319.5, abs=0.2)
    assert estimate["principal_y"] == pytest.approx(camera[1, 2] - 239.5, abs=0.2)
    assert found.reprojection.rms < 1.1 * NOISE * np.sqrt(2)
    assert found.plane_error.rms < 280 / 46 * 1.3 * NOISE * np.sqrt(2)
    assert found.adequate
    assert len(found.residuals) == sum(map(len, image))
    # With both terms OpenCV projects the pattern to where it was drawn.
    told = json.loads(found.to_json())["opencv"]
    vectors = [np.array(told[n][1]) for n in ("rotation_vectors", "translation_vectors_um")]
    lens = np.array(told["camera_matrix"]), np.array(told["distortion_coefficients"])
    seen = cv2.projectPoints(flat[1], *vectors, *lens)[0][:, 0]
    assert np.sqrt(((seen - image[1]) ** 2).mean()) < 1.1 * NOISE


def test_bic_leaves_out_needless_lens_parameters():
    _, world, exact = tilted_views()
    left_out = 0
    for seed in range(5):
        rng = np.random.default_rng(seed)
        image = [points + rng.normal(0, NOISE, points.shape) for points in exact]
        found = calibrate(world, image, **SENSOR)
        left_out += len(found.parameters) == 2 + 3 * 6
    assert left_out >= 4
    assert found.parameters[:3] == ("magnification", "focal_length", "distortion")
    assert found.parameters[3:10] == (*POSE[1:], "magnification_2", "alpha_2")


def test_held_out_error_agrees_with_opencv():
    """Of views through one lens that of the noise; of a wide lens, what the model lacks."""
    world, image = lens_views(5, aside=(14, -9))
    found = calibrate(world, image, **CAMERA)
    np.testing.assert_allclose(found.held_out, NOISE * np.sqrt(2), rtol=0.3)
    flat = [np.column_stack([w, 0 * w[:, 0]]).astype(np.float32) for w in world]
    seen = [i.astype(np.float32) for i in image]
    flags = cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    _, *lens, _, _ = cv2.calibrateCamera(flat[1:], seen[1:], (640, 480), None, None, flags=flags)
    pose = cv2.solvePnP(flat[0], seen[0], *lens)[1:]
    off = cv2.projectPoints(flat[0], *pose, *lens)[0][:, 0] - image[0]
    assert found.held_out[0] == pytest.approx(np.sqrt((off**2).sum(axis=1).mean()), rel=0.1)
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
    apart = len(some) * np.sum(found.held_out**2)
    assert apart > 1.1 * np.sum(found.residuals**2)


def test_inconsistent_view_has_the_largest_held_out_error():
    """As if every second row of a board had been skipped in one photograph."""
    world, image = lens_views(6, aside=(14, -9))
    world[2] = world[2] * [1, 2]
    found = calibrate(world, image, **CAMERA)
    assert found.held_out[2] > 10
    assert np.delete(found.held_out, 2).max() < 1
    assert not found.adequate


def test_intervals_of_several_views_cover_for_an_imprecise_pattern():
    """Marks made beside their places are so in every view: 0.13 px, for 0.02 px of noise."""
    inside = []
    for seed in range(10):
        found = calibrate(*lens_views(4, seed=seed, shift=0.8, aside=(6, 4)), **CAMERA)
        low, high = found.interval("focal_length")
        inside.append(low <= 900 * 8 / (1 + found.microscope.magnification) <= high)
    assert sum(inside) >= 7  # of 10 at 95 %, in 999 of a thousand cases


def test_given_focal_length_is_kept_in_every_view():
    scopes, world, image = tilted_views()
    found = calibrate(world, image, focal_length=F, **SENSOR)
    for scope, view in zip(scopes, found.views, strict=True):
        assert view.focal_length == F
        assert view.magnification == pytest.approx(1.59, rel=1e-9)
        assert view.tx == pytest.approx(scope.tx, abs=1e-5)
    assert found.views[0] == found.microscope
    single = calibrate(world[0], image[0], focal_length=F, **SENSOR)
    assert single.views == (single.microscope,)


def test_focal_length_is_undetermined_for_several_parallel_views():
    scope = scope_with(beta=0, gamma=0)
    world = grid_in_view(scope)
    noise = np.random.default_rng(0).normal(0, NOISE, (3, *world.shape))
    found = calibrate([world] * 3, [scope.project(world) + n for n in noise], **SENSOR)
    assert {"focal_length", "beta", "gamma_3"} <= set(found.undetermined)
    assert np.isinf(found.sigma["focal_length"])


def test_determined_focal_length_may_exceed_a_kilometer():
    """Of a pattern in another unit than µm: it was put at one, with an interval around it."""
    scope = scope_with(beta=15, gamma=10)
    world = grid_in_view(scope)
    seen = scope.project(world) + np.random.default_rng(2).normal(0, NOISE, world.shape)
    found = calibrate(1e5 * world, seen, **(SENSOR | {"pixel_size": 9.9e5}))
    low, high = found.interval("focal_length")
    assert low < 1e5 * F < high


def test_interval_covers_the_error_by_a_bent_pattern():
    """A plate bent by 20 µm, seen in three views whose lens has its axis found: the residuals show
    the bend, and the interval of f is as wide as the bend may have moved it."""
    inside, said = [], []
    for seed in range(6):
        found = calibrate(*lens_views(3, seed=seed, aside=(14, -9), bend=20.0), **CAMERA)
        low, high = found.interval("focal_length")
        inside.append(low <= 900 * 8 / (1 + found.microscope.magnification) <= high)
        said.append(not found.adequate)
    assert sum(said) >= 5
    assert sum(inside) >= 3  # with what the noise alone makes of it none


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"image": [np.zeros((9, 2))]}, "image"),
        ({"image": np.array(np.nan)}, "image must hold one array for each of the 2 views"),
        # Of 1.5 µm: seconds, and then magnifications of both signs.
        ({"focal_length": 1.5}, "focal_length must fit each view .* got 1.5 µm"),
    ],
)
def test_wrong_views_are_rejected_by_name(change, word):
    world, image = lens_views(2)
    with pytest.raises(ValueError, match=word):
        calibrate(**{"world": world, "image": image, **CAMERA, **change})
