"""The microscope model against its equations, OpenCV, SciPy, and its own inverse."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from microlib.microscope import Microscope, distort, euler_rotation, undistort
from tests.laws import NUMBER, Row, Units, laws_of, um

# Rounding only: a few operations on numbers of about 1e5 µm, each good to 1e-16.
ROUNDING = 1e-11

angles = st.floats(-np.pi, np.pi)
small_tilts = st.floats(-0.35, 0.35)


def pose(u, **changes):
    """Return a microscope without a symmetry: turned, tilted, and with oblong pixels."""
    given = {
        **dict(zip(("alpha", "beta", "gamma"), (0.6, 0.3, -0.2), strict=True)),
        "tube_length": 200e3 * u.um,
        "focal_length": 126e3 * u.um,
        "distance": 79e3 * u.um,
        "distortion": -8.4e-10 / u.um**2,
        "tx": -780.0 * u.um,
        "ty": -55.0 * u.um,
        "pixel_pitch": (9.9 * u.um, 8.3 * u.um),
        "image_size": (640, 470),
    }
    return Microscope(**given | changes)


SENSOR = {"pixel_pitch": (9.9, 8.3), "image_size": (640, 470)}
SCOPE = pose(Units())
PLANE = np.random.default_rng(6).uniform(-900, 900, (7, 2))
SCOPE_UNITS = {
    **dict.fromkeys(("tube_length", "focal_length", "distance", "tx", "ty"), um),
    **dict.fromkeys(("pixel_pitch", "translation", "pitch"), um),
    **dict.fromkeys(("alpha", "beta", "gamma", "tilt", "rotation", "magnification"), NUMBER),
    **dict.fromkeys(("image_size", "principal_point"), NUMBER),
    "distortion": 1 / um**2,
}


def on_sensor(u):
    points = np.array([[2900.0, -1800.0], [-700.0, 2100.0]])
    return {"points": points * u.um, "distortion": -8.4e-10 / u.um**2}


LAWS = {
    "microscope.Microscope": Row(lambda u: vars(pose(u)), SCOPE_UNITS),
    "microscope.Microscope.to_objective": Row(lambda u: {"self": pose(u), "points": PLANE * u.um},
        um),
    "microscope.Microscope.project": Row(lambda u: {"self": pose(u), "points": PLANE * u.um},
        NUMBER),
    "microscope.Microscope.back_project": Row(lambda u: {"self": pose(u),
        "pixels": PLANE / 9 + 200}, um),
    "microscope.Microscope.jacobian": Row(lambda u: {"self": pose(u), "world": PLANE * u.um,
        "parameters": (*Microscope.PARAMETERS, "magnification")},
        [1 / um, 1 / um, 1 / um, um**2, NUMBER, NUMBER, NUMBER, 1 / um, 1 / um, NUMBER]),
    "microscope.Microscope.project_plane": Row(lambda u: {
        "visible": [1.6, 5e-6 / u.um, -8e-10 / u.um**2, 0.6, 0.3, -0.2, 90 * u.um, -55 * u.um],
        "world": PLANE * u.um, "pitch": np.array([9.9, 8.3]) * u.um}, (NUMBER,
        [NUMBER, um, um**2, NUMBER, NUMBER, NUMBER, 1 / um, 1 / um])),
    "microscope.distort": Row(on_sensor, um),
    "microscope.undistort": Row(on_sensor, um),
    "microscope.euler_rotation": Row(lambda u: {"alpha": 0.6, "beta": 0.3, "gamma": -0.2}, NUMBER),
}  # fmt: skip


@pytest.mark.parametrize(("law", "name"), laws_of(LAWS))
def test_law_holds(law, name):
    law(name, LAWS[name])


@given(angles, angles, angles)
@settings(deadline=None, max_examples=50)
def test_euler_rotation_equals_scipy_extrinsic_xyz(alpha, beta, gamma):
    expected = Rotation.from_euler("xyz", [gamma, beta, alpha]).as_matrix()
    np.testing.assert_allclose(euler_rotation(alpha, beta, gamma), expected, atol=1e-14)


def test_projection_equals_printed_equation():
    """(2.11) written out for one point, with the undistortion inverted by bisection."""
    world = np.array([123.0, -456.0, 7.0])
    depth = SCOPE.focal_length + SCOPE.distance
    x, y, z = SCOPE.rotation @ world + [SCOPE.tx, SCOPE.ty, depth]
    flat = (SCOPE.tube_length + SCOPE.focal_length) * np.array([x, y]) / z
    square = SCOPE.distortion * flat @ flat
    scale = brentq(lambda s: s * (1 + square * s**2) - 1, 0.9, 1.1, xtol=1e-15)
    expected = flat * scale / [9.9, 8.3] + [(640 - 1) / 2, (470 - 1) / 2]
    np.testing.assert_allclose(SCOPE.project(world[None])[0], expected, atol=1e-9)


@given(
    alpha=angles,
    beta=small_tilts,
    tilt=small_tilts,
    behind=st.booleans(),
    shift=st.tuples(st.floats(-2e3, 2e3), st.floats(-2e3, 2e3)),
    magnification=st.floats(0.5, 20),
    distortion=st.floats(-2e-9, 2e-9),
)
@settings(deadline=None, max_examples=100)
def test_back_projection_undoes_projection(
    alpha, beta, tilt, behind, shift, magnification, distortion
):
    f = 2e5 / magnification
    gamma = tilt + np.pi * behind
    pose = (alpha, beta, gamma, *shift)
    scope = Microscope(2e5, f, f * f / 2e5, distortion, *pose, **SENSOR)
    pixels = np.random.default_rng(3).uniform(0, [655, 490], (30, 2))
    plane = scope.back_project(pixels)
    # 1e-9 relative to the field of view: the numbers themselves may be near zero.
    np.testing.assert_allclose(scope.project(plane), pixels, rtol=0, atol=656e-9)
    field = 656 * 9.9 / magnification + np.abs(shift).max()
    again = scope.back_project(scope.project(plane))
    np.testing.assert_allclose(again, plane, rtol=0, atol=1e-9 * field)


@given(st.floats(-1e-8, 1e-8), st.floats(0, 5000), angles)
@settings(deadline=None, max_examples=200)
def test_undistort_is_the_inverse_of_distort_up_to_the_fold(distortion, radius, angle):
    """The fold of u (1 + κ u²) lies at u = 1/√(−3κ), where u' = 2u/3."""
    flat = radius * np.array([np.cos(angle), np.sin(angle)])
    seen = distort(flat, distortion)
    if 27 / 4 * -distortion * radius**2 > 1:
        assert np.isnan(seen).all()
        assert np.isnan(undistort(1.5 * flat, distortion)).all()
    elif 27 / 4 * -distortion * radius**2 < 0.99:  # at the fold the inverse loses half its digits
        np.testing.assert_allclose(undistort(seen, distortion), flat, rtol=1e-13, atol=ROUNDING)


def test_projection_behind_objective_is_nan():
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1e6]])
    for scope in (SCOPE, replace(SCOPE, distortion=0.0)):
        assert np.isnan(scope.project(points)).all(axis=1).tolist() == [False, True]
    corners = [[0.0, 0.0], [639.0, 0.0], [0.0, 469.0], [639.0, 469.0]]
    edge_on = replace(SCOPE, beta=np.pi / 2, gamma=0.0, distortion=0.0).back_project(corners)
    assert set(np.isnan(edge_on).any(axis=1)) == {False, True}


def test_tilt_is_the_angle_of_the_plane_normal_to_the_axis():
    normal = SCOPE.rotation[:, 2]
    assert SCOPE.tilt == pytest.approx(np.arccos(abs(normal[2])), abs=1e-12)
    behind = replace(SCOPE, gamma=SCOPE.gamma + np.pi)
    assert behind.tilt == pytest.approx(SCOPE.tilt, abs=1e-12)
    assert Microscope(2e5, 1e5, 5e4, beta=1e-9, **SENSOR).tilt == pytest.approx(1e-9, rel=1e-6)


def moved(scope, name, by):
    """The microscope with another value of a parameter of `jacobian`.

    M changes by the tube alone, with f + d as it is; the focus is f with the plane kept in focus at
    the same M, T_op = M f and d = f/M.
    """
    m, f = scope.magnification, scope.focal_length
    if name == "magnification":
        return replace(scope, tube_length=(m + by) * (f + scope.distance) - f)
    if name == "focus":
        return replace(scope, focal_length=f + by, tube_length=m * (f + by), distance=(f + by) / m)
    return replace(scope, **{name: getattr(scope, name) + by})


@pytest.mark.parametrize("name", [*Microscope.PARAMETERS, "magnification", "focus"])
@pytest.mark.parametrize("distortion", [-8.4e-10, 2e-9])
def test_jacobian_equals_numerical_derivative(name, distortion):
    scope = replace(SCOPE, distortion=distortion)
    if name == "focus":  # of a microscope that is in focus
        scope = moved(scope, name, 0.0)
    world = np.random.default_rng(4).uniform(-1500, 1500, (12, 2))
    # Steps that balance rounding (1e-13 px) against curvature.
    small = {"distortion": 1e-13, "magnification": 1e-4, "focus": 10.0}
    step = small.get(name, 1e-6 if name in ("alpha", "beta", "gamma") else 1.0)
    up, down = (moved(scope, name, s).project(world) for s in (step, -step))
    numeric = (up - down) / (2 * step)
    found = scope.jacobian(world, ("tx", name))[..., 1]
    np.testing.assert_allclose(found, numeric, atol=1e-6 * np.abs(numeric).max() + 1e-11)
    assert np.abs(numeric).max() > 1e-6


def test_project_plane_equals_projection_of_microscope():
    """The same image from (M, h, …) as from the three lengths; and the telecentric one, X alone."""
    world = np.random.default_rng(5).uniform(-1500, 1500, (12, 2))
    depth = SCOPE.focal_length + SCOPE.distance
    rest = [SCOPE.distortion, SCOPE.alpha, SCOPE.beta, SCOPE.gamma, SCOPE.tx, SCOPE.ty]
    visible = np.array([SCOPE.magnification, 1 / depth, *rest])
    seen, _ = Microscope.project_plane(visible, world, SCOPE.pitch)
    np.testing.assert_allclose(seen + SCOPE.principal_point, SCOPE.project(world), atol=1e-9)
    flat, _ = Microscope.project_plane(np.array([2.0, 0.0, 0.0, *rest[1:]]), world, SCOPE.pitch)
    expected = 2 * SCOPE.to_objective(world)[:, :2] / SCOPE.pitch
    np.testing.assert_allclose(flat, expected, rtol=1e-12)


@pytest.mark.parametrize("change", [distort, undistort])
def test_distort_accepts_pairs_and_nan(change):
    points = np.array([[[100.0, 200.0], [np.nan, 1.0]], [[0.0, 0.0], [-300.0, 5.0]]])
    found = change(points, 1e-9)
    assert found.shape == points.shape
    np.testing.assert_array_equal(np.isnan(found).all(axis=2), [[False, True], [False, False]])


def test_project_plane_is_defined_beyond_the_horizon():
    """1 + h Z_r below zero, where the image comes back from infinity; zero itself is unknown."""
    pose = np.array([2.0, 1e-5, 0.0, 0.0, np.pi / 2, 0.0, 3.0, 4.0])  # edge on: Z_r = −X_w
    world = np.array([[5e4, 10.0], [3e5, 10.0], [1e5, 10.0]])
    seen, by = Microscope.project_plane(pose, world, np.array([2.0, 4.0]))
    # By hand: (0 + 3)·2/(1 − 1e-5 X_w)/2 and (10 + 4)·2/(1 − 1e-5 X_w)/4.
    np.testing.assert_allclose(seen[:2], [[6.0, 14.0], [-1.5, -3.5]], rtol=1e-9)
    assert np.isfinite(by[:2]).all()


def test_project_plane_rejects_point_on_fold_of_distortion():
    """Rounding decides which points meet the fold exactly: of many some do, and are rejected."""
    said = set()
    for distortion in -np.arange(1, 400) / 7.0:
        visible = np.array([1.0, 0.0, distortion, 0.0, 0.0, 0.0, 0.0, 0.0])
        edge = np.array([[2 / 3 / np.sqrt(-3 * distortion), 0.0]])
        try:
            seen, by = Microscope.project_plane(visible, edge, np.ones(2))
            assert np.isnan(seen).all() == np.isnan(by).all()
        except ValueError as error:
            said.add(str(error))
    assert said == {"world must keep off the fold of the distortion model, got a point on it"}


def test_default_microscope_is_untilted_with_thesis_sensor():
    scope = Microscope(2e5, 1e5, 5e4, pixel_pitch=9.9, image_size=(656, 491))
    np.testing.assert_allclose(scope.rotation, np.eye(3), atol=1e-15)
    assert scope.tilt == 0
    np.testing.assert_array_equal(scope.translation, [0, 0, 1.5e5])
    np.testing.assert_array_equal(scope.pitch, [9.9, 9.9])
    np.testing.assert_array_equal(scope.principal_point, [327.5, 245.0])
    # M = 2: 99 µm of the plane are 198 µm of the sensor, 20 px.
    np.testing.assert_allclose(scope.project([[99.0, -49.5]]), [[347.5, 235.0]], rtol=1e-12)
    wide = replace(scope, pixel_pitch=(9.9, 19.8), image_size=(100, 50))
    np.testing.assert_allclose(wide.project([[99.0, -49.5]]), [[69.5, 19.5]], rtol=1e-12)
