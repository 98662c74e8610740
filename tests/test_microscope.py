"""The microscope model against its equations, OpenCV, SciPy, and its own inverse."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from microlib.microscope import Microscope, distort, euler_rotation, project_points, undistort
from tests.checks import (
    NO_NUMBER,
    hold_call,
    hold_refused,
    hold_scaled,
    no_array,
    not_finite,
    not_real,
)

# Rounding only: a few operations on numbers of about 1e5 µm, each good to 1e-16.
ROUNDING = 1e-11

angles = st.floats(-np.pi, np.pi)
small_tilts = st.floats(-0.35, 0.35)


SENSOR = {"pixel_pitch": (9.9, 8.3), "image_size": (640, 470)}
TURNS = {"alpha": 0.6, "beta": 0.3, "gamma": -0.2}
LENGTHS = {
    **{"tube_length": 200e3, "focal_length": 126e3, "distance": 79e3, "tx": -780.0, "ty": -55.0},
    "pixel_pitch": (9.9, 8.3),
}
LENS = {"distortion": -8.4e-10, "distortion_k2": 3e-17}
#: Turned, tilted, and with oblong pixels: without a symmetry.
SCOPE = Microscope(**LENGTHS, **TURNS, **LENS, principal_offset=(14.0, -9.0), image_size=(640, 470))
PLANE = np.random.default_rng(6).uniform(-900, 900, (7, 2))
ON_SENSOR = np.array([[2900.0, -1800.0], [-700.0, 2100.0]])
#: A valid call of each function.
CALLS = {
    Microscope: lambda: {
        field.name: getattr(SCOPE, field.name) for field in fields(SCOPE) if field.init
    },
    Microscope.to_objective: lambda: {"self": SCOPE, "points": PLANE.copy()},
    Microscope.project: lambda: {"self": SCOPE, "points": PLANE.copy()},
    Microscope.back_project: lambda: {"self": SCOPE, "pixels": PLANE / 9 + 200},
    distort: lambda: {"points": ON_SENSOR.copy(), **LENS},
    undistort: lambda: {"points": ON_SENSOR.copy(), **LENS}, euler_rotation: lambda: dict(TURNS),
}  # fmt: skip
each_call = pytest.mark.parametrize("function", CALLS, ids=lambda f: f.__qualname__)


def no_points(valid):
    """Return what is refused in place of points; NaN is one without an image."""
    return [*not_real(valid), valid + np.inf]


#: What is refused in place of each argument.
REFUSED = {
    Microscope: {
        **dict.fromkeys((*TURNS, *LENS, "tx", "ty"), NO_NUMBER),
        "pixel_pitch": lambda valid: [*not_finite(valid), 0.0, (9.9, -1.0), (9.9, 9.9, 9.9)],
        "image_size": lambda valid: [*no_array(valid), (656, 0), (-656, 491), (656.5, 491), 656],
    },
    distort: {"points": no_points, **dict.fromkeys(LENS, NO_NUMBER)},
    undistort: {"points": no_points, **dict.fromkeys(LENS, NO_NUMBER)},
    euler_rotation: dict.fromkeys(TURNS, NO_NUMBER),
}


@each_call
def test_call_gives_the_same_for_the_same_numbers(function):
    hold_call(function, CALLS[function])


@each_call
def test_wrong_arguments_are_refused_by_name(function):
    hold_refused(function, CALLS[function](), REFUSED.get(function, {}))


def test_microscope_in_nanometers_sees_the_same():
    lengths = {name: 1e3 * np.array(length) for name, length in LENGTHS.items()}
    kappas = {"distortion": -8.4e-16, "distortion_k2": 3e-29}
    scope = replace(SCOPE, **lengths, **kappas)
    lengths = dict.fromkeys((*LENGTHS, "pitch", "translation"), 1e3)
    kappa = {"distortion": 1e-6, "distortion_k2": 1e-12}
    view = {"tx": 1e3, "ty": 1e3, "convergence": 1e-3, **kappa}
    hold_scaled(scope, SCOPE, **lengths, **kappa, view=view)
    np.testing.assert_allclose(scope.project(1e3 * PLANE), SCOPE.project(PLANE))
    np.testing.assert_allclose(scope.to_objective(1e3 * PLANE), 1e3 * SCOPE.to_objective(PLANE))
    pixels = PLANE / 9 + 200
    np.testing.assert_allclose(scope.back_project(pixels), 1e3 * SCOPE.back_project(pixels))
    for change in (distort, undistort):
        found = change(1e3 * ON_SENSOR, *kappas.values())
        np.testing.assert_allclose(found, 1e3 * change(ON_SENSOR, *LENS.values()), rtol=1e-9)


def test_euler_rotation_equals_scipy_extrinsic_xyz():
    for alpha, beta, gamma in np.random.default_rng(0).uniform(-np.pi, np.pi, (20, 3)):
        expected = Rotation.from_euler("xyz", [gamma, beta, alpha]).as_matrix()
        np.testing.assert_allclose(euler_rotation(alpha, beta, gamma), expected, atol=1e-14)


def test_projection_equals_printed_equation():
    """(2.11) written out for one point, with the undistortion inverted by bisection."""
    world = np.array([123.0, -456.0, 7.0])
    depth = SCOPE.focal_length + SCOPE.distance
    x, y, z = SCOPE.rotation @ world + [SCOPE.tx, SCOPE.ty, depth]
    flat = (SCOPE.tube_length + SCOPE.focal_length) * np.array([x, y]) / z
    square, fourth = SCOPE.distortion * flat @ flat, SCOPE.distortion_k2 * (flat @ flat) ** 2
    scale = brentq(lambda s: s * (1 + square * s**2 + fourth * s**4) - 1, 0.9, 1.1, xtol=1e-15)
    expected = flat * scale / [9.9, 8.3] + [(640 - 1) / 2 + 14.0, (470 - 1) / 2 - 9.0]
    np.testing.assert_allclose(SCOPE.project(world[None])[0], expected, atol=1e-9)


@given(
    alpha=angles, beta=small_tilts, tilt=small_tilts, behind=st.booleans(),
    shift=st.tuples(st.floats(-2e3, 2e3), st.floats(-2e3, 2e3)),
    magnification=st.floats(0.5, 20), distortion=st.floats(-2e-9, 2e-9),
    distortion_k2=st.floats(-2e-17, 2e-17),
)  # fmt: skip
@settings(deadline=None, max_examples=100)
def test_back_projection_undoes_projection(
    alpha, beta, tilt, behind, shift, magnification, distortion, distortion_k2
):
    f = 2e5 / magnification
    gamma = tilt + np.pi * behind
    pose = (alpha, beta, gamma, *shift)
    lens = {"distortion_k2": distortion_k2, "principal_offset": (20.0, -10.0)}
    scope = Microscope(2e5, f, f * f / 2e5, distortion, *pose, **SENSOR, **lens)
    pixels = np.random.default_rng(3).uniform(0, [655, 490], (30, 2))
    plane = scope.back_project(pixels)
    # 1e-9 relative to the field of view: the numbers themselves may be near zero.
    np.testing.assert_allclose(scope.project(plane), pixels, rtol=0, atol=656e-9)
    field = 656 * 9.9 / magnification + np.abs(shift).max()
    again = scope.back_project(scope.project(plane))
    np.testing.assert_allclose(again, plane, rtol=0, atol=1e-9 * field)


@given(st.integers(-99, 99), st.integers(-99, 99), st.floats(0, 5000), angles)
@example(-99, 4, 7000.0, 0.3)  # near the fold the radius is half as long again
@example(-99, 5, 9000.0, 0.3)  # and twice as long where κ₂ takes the fold away
@example(-99, 0, 5700.0, 0.3)  # κ alone has its fold at 1/√(−3κ) = 5803 µm
@example(-99, 0, 5900.0, 0.3)
@settings(deadline=None, max_examples=300)
def test_distort_and_undistort_are_inverse_with_two_coefficients(k1, k2, radius, angle):
    """The radius grows up to the fold, where 1 + 3 κ r² + 5 κ₂ r⁴ is zero; no point is beyond."""
    k1, k2, direction = 1e-10 * k1, 1e-17 * k2, np.array([np.cos(angle), np.sin(angle)])
    squares = np.roots([5 * k2, 3 * k1, 1])
    folds = np.sqrt(squares.real[(abs(squares.imag) < 1e-6 * abs(squares)) & (squares.real > 0)])
    fold = folds.min(initial=np.inf)
    flat = undistort(radius * direction, k1, k2)
    assert np.isnan(flat).all() == (radius > fold) or radius == pytest.approx(fold, rel=1e-6)
    if radius < 0.99 * fold:
        again = distort(flat, k1, k2)
        np.testing.assert_allclose(again, radius * direction, rtol=1e-11, atol=ROUNDING)
    if fold < 1e6:
        reach = fold * (1 + k1 * fold**2 + k2 * fold**4)
        assert np.isnan(distort(1.001 * reach * direction, k1, k2)).all()
        assert np.isfinite(distort(0.999 * reach * direction, k1, k2)).all()


def test_projection_behind_objective_is_nan():
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1e6]])
    for scope in (SCOPE, replace(SCOPE, distortion=0.0, distortion_k2=0.0)):
        assert np.isnan(scope.project(points)).all(axis=1).tolist() == [False, True]
    corners = [[0.0, 0.0], [639.0, 0.0], [0.0, 469.0], [639.0, 469.0]]
    edge_on = replace(SCOPE, beta=np.pi / 2, gamma=0.0, distortion=0.0, distortion_k2=0.0)
    assert set(np.isnan(edge_on.back_project(corners)).any(axis=1)) == {False, True}


def test_tilt_is_the_angle_of_the_plane_normal_to_the_axis():
    normal = SCOPE.rotation[:, 2]
    assert SCOPE.tilt == pytest.approx(np.arccos(abs(normal[2])), abs=1e-12)
    behind = replace(SCOPE, gamma=SCOPE.gamma + np.pi)
    assert behind.tilt == pytest.approx(SCOPE.tilt, abs=1e-12)
    assert Microscope(2e5, 1e5, 5e4, beta=1e-9, **SENSOR).tilt == pytest.approx(1e-9, rel=1e-6)


@pytest.mark.parametrize("name", list(SCOPE.view))
@pytest.mark.parametrize("distortion", [-8.4e-10, 2e-9])
def test_derivatives_of_projection_equal_numerical_ones(name, distortion):
    view = SCOPE.view | {"distortion": distortion}
    world = np.random.default_rng(4).uniform(-1500, 1500, (12, 3))
    # Steps that balance rounding (1e-13 px) against curvature.
    steps = {"distortion": 1e-13, "distortion_k2": 1e-20, "magnification": 1e-4}
    steps |= {"convergence": 1e-9, **dict.fromkeys(TURNS, 1e-6)}
    step = steps.get(name, 1.0)
    up, down = (
        project_points(world, SCOPE.pitch, view | {name: view[name] + s})[0] for s in (step, -step)
    )
    numeric = (up - down) / (2 * step)
    _, by = project_points(world, SCOPE.pitch, view, derivatives=True)
    np.testing.assert_allclose(by[name], numeric, atol=1e-6 * np.abs(numeric).max() + 1e-11)
    assert np.abs(numeric).max() > 1e-6


def test_telecentric_projection_is_the_scaled_plane():
    world = np.random.default_rng(5).uniform(-1500, 1500, (12, 2))
    view = SCOPE.view | {"magnification": 2.0, "convergence": 0.0, "distortion": 0.0}
    view |= {"distortion_k2": 0.0, "principal_x": 0.0, "principal_y": 0.0}
    flat, _ = project_points(world, SCOPE.pitch, view)
    expected = 2 * SCOPE.to_objective(world)[:, :2] / SCOPE.pitch
    np.testing.assert_allclose(flat.T, expected, rtol=1e-12)


@pytest.mark.parametrize("change", [distort, undistort])
def test_distort_accepts_pairs_and_nan(change):
    points = np.array([[[100.0, 200.0], [np.nan, 1.0]], [[0.0, 0.0], [-300.0, 5.0]]])
    found = change(points, 1e-9)
    assert found.shape == points.shape
    np.testing.assert_array_equal(np.isnan(found).all(axis=2), [[False, True], [False, False]])


def test_projection_is_defined_beyond_the_horizon():
    """1 + h Z_r below zero, where the image comes back from infinity; zero itself is unknown."""
    edge_on = {"magnification": 2.0, "convergence": 1e-5, "beta": np.pi / 2, "tx": 3.0, "ty": 4.0}
    view = dict.fromkeys(SCOPE.view, 0.0) | edge_on  # Z_r = −X_w
    world = np.array([[5e4, 10.0], [3e5, 10.0], [1e5, 10.0]])
    seen, by = project_points(world, np.array([2.0, 4.0]), view, derivatives=True)
    # By hand: (0 + 3)·2/(1 − 1e-5 X_w)/2 and (10 + 4)·2/(1 − 1e-5 X_w)/4.
    np.testing.assert_allclose(seen.T[:2], [[6.0, 14.0], [-1.5, -3.5]], rtol=1e-9)
    assert all(np.isfinite(each[:, :2]).all() for each in by.values())


def test_default_microscope_is_untilted_with_thesis_sensor():
    scope = Microscope(2e5, 1e5, 5e4, pixel_pitch=9.9, image_size=(656, 491))
    np.testing.assert_allclose(scope.rotation, np.eye(3), atol=1e-15)
    assert scope.tilt == 0
    np.testing.assert_array_equal(scope.translation, [0, 0, 1.5e5])
    np.testing.assert_array_equal(scope.pitch, [9.9, 9.9])
    np.testing.assert_array_equal(scope.principal_point, [327.5, 245.0])
    # M = 2: 99 µm of the plane are 198 µm of the sensor, 20 px.
    np.testing.assert_allclose(scope.project([[99.0, -49.5]]), [[347.5, 235.0]], rtol=1e-12)
