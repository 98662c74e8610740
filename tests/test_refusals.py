"""Inputs that once gave a silent wrong result or another exception, one test for each."""

from __future__ import annotations

import time
import warnings

import numpy as np
import pytest

from microlib import (
    calibration,
    curvature,
    focus,
    membrane,
    microscope,
    optics,
    servoing,
    synthetic,
    tracking,
)

SCOPE = microscope.Microscope(200000.0, 126000.0, 79380.0, image_size=(300, 260))
POINTS = np.array([[x, y] for y in range(5) for x in range(6)]) * 200.0
WEIGHTS = {"interval": 0.04, "feature_weight": (1.0, 1.0), "control_weight": (0.01, 0.01)}
REFERENCE = np.tile([100.0, 80.0], (6, 1))


def test_a_stage_of_unsigned_speed_moves_backwards() -> None:
    """As uint8, −200 wraps around to 56 and −100 µm/s became +56."""
    position, _ = servoing.Stage(np.uint8(200)).move(
        np.zeros(2), np.zeros(2), np.array([-100.0, 50.0]), 1.0
    )
    np.testing.assert_allclose(position, [-100.0, 50.0], rtol=1e-12)


@pytest.mark.parametrize("wrong", [257, 1.9, -255])
def test_labels_are_not_cast_to_eight_bits(wrong: float) -> None:
    labels = np.ones((4, 4))
    labels[1, 1] = wrong
    with pytest.raises(ValueError, match="labels must"):
        curvature.clean_labels(labels, 2)


@pytest.mark.parametrize("detect", [calibration.detect_circles, calibration.detect_squares])
@pytest.mark.parametrize("wrong", [np.nan, np.inf, "0", [0.0]])
def test_a_direction_is_a_finite_number(detect, wrong) -> None:
    with pytest.raises(ValueError, match="direction must be"):
        detect(np.zeros((64, 64), np.uint8), direction=wrong)


@pytest.mark.parametrize("wrong", [np.inf, np.nan, 0.0])
def test_an_infinite_pitch_is_no_blank_image(wrong: float) -> None:
    with pytest.raises(ValueError, match="pitch must be"):
        synthetic.render_circles(SCOPE, pitch=wrong)


@pytest.mark.parametrize("wrong", [-1.0, -1e-9, np.nan])
def test_noise_is_positive_in_the_bound(wrong: float) -> None:
    with pytest.raises(ValueError, match="noise must be"):
        calibration.cramer_rao(SCOPE, POINTS, noise=wrong, parameters=("tx",))


def masked(value: np.ndarray) -> np.ma.MaskedArray:
    return np.ma.array(value, mask=np.arange(value.size).reshape(value.shape) % 2 == 0)


STACK = np.random.default_rng(0).integers(0, 255, (5, 24, 31)).astype(np.uint8)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("depth", lambda: focus.correct_spikes(masked(np.ones((9, 9))))),
        ("frames", lambda: focus.depth_from_focus(masked(STACK), np.arange(5.0))),
        (r"frames\[0\]", lambda: focus.depth_from_focus([masked(f) for f in STACK], range(5))),
        ("positions", lambda: focus.depth_from_focus(STACK, masked(np.arange(5.0)))),
        ("world", lambda: calibration.calibrate(
            masked(POINTS), POINTS, pixel_size=9.9, image_size=(300, 260))),
        ("height", lambda: curvature.surface_curvature(masked(np.ones((20, 20))), 1.0)),
        ("dimple_depth", lambda: membrane.mean_strain(
            250.0, masked(np.ones(4)), probe_half_width=25.0)),
        ("image", lambda: tracking.ESMTracker(masked(STACK[0]), (4, 4, 12, 12))),
        ("gap|pixel_size", lambda: synthetic.gripper_scene(0, pixel_size=np.ma.masked)),
    ],
)  # fmt: skip
def test_a_mask_is_refused_instead_of_dropped(name, call) -> None:
    with pytest.raises(ValueError, match=f"({name}) must be"):
        call()


def test_a_masked_frame_is_refused_by_the_tracker() -> None:
    tracker = tracking.ESMTracker(STACK[0], (4, 4, 12, 12), "translation")
    with pytest.raises(ValueError, match="frame must be without a mask"):
        tracker.track(masked(STACK[0]))


@pytest.mark.parametrize("wrong", [[1.0], np.ones(1), [[1.0]], True, "1", None, 1j, {}])
def test_a_list_of_one_is_no_number(wrong) -> None:
    for name, call in (
        ("sigma", lambda: optics.gaussian_kernel(wrong, 3)),
        ("gain", lambda: servoing.loop_poles(wrong)),
        ("gap", lambda: synthetic.gripper_scene(0, pixel_size=1.0, gap=wrong)),
        ("focal_length", lambda: microscope.Microscope(1.0, wrong, 1.0)),
        ("interval", lambda: servoing.Camera(wrong)),
        ("jump", lambda: focus.smooth_depth(np.ones((5, 5)), jump=wrong)),
    ):
        with pytest.raises(ValueError, match=f"{name} must be"):
            call()


@pytest.mark.parametrize("positions", [[3.0] * 5, [0, 0, 1, 2, 3], [2, 1, 1, 0, -1], np.zeros(5)])
def test_equal_positions_are_refused_by_name(positions) -> None:
    with pytest.raises(ValueError, match=r"positions must rise or fall strictly, got \S+ followed"):
        focus.depth_from_focus(STACK, positions)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"window": np.ones((4, 2, 2))}, "window"),
        ({"window": np.ones((3, 2, 3))}, "window"),
        ({"window": -np.ones((3, 2, 2))}, "window"),
        ({"window": np.full((3, 2, 2), 1e100)}, "window"),
        ({"index": np.full((2, 2), 5)}, "index"),
        ({"index": np.full((2, 2), -1)}, "index"),
        ({"index": np.zeros((2, 2))}, "index"),
        ({"positions": np.array([0.0, 1, np.nan, 3, 4])}, "positions"),
        ({"positions": np.zeros(5)}, "positions"),
        ({"positions": 1e100 * np.arange(5)}, "positions"),
        ({"positions": [0.0, 1, 2, 3, 4]}, "positions"),
    ],
)
def test_the_fit_of_a_peak_refuses_by_name(change, name) -> None:
    given = {
        "window": np.ones((3, 2, 2)), "index": np.full((2, 2), 2), "positions": np.arange(5.0)
    }  # fmt: skip
    with pytest.raises(ValueError, match=f"{name} must"):
        focus.three_point_peak(**(given | change))


CONTROLLERS = [
    servoing.OptimalController(np.eye(2) * 0.3, **WEIGHTS),
    servoing.PredictiveController(np.eye(2) * 0.3, **WEIGHTS, delay=0.06, saturation=500.0),
]


@pytest.mark.parametrize("control", CONTROLLERS)
@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"k": -1}, "k"),
        ({"k": 0.5}, "k"),
        ({"k": 10**400}, "k"),
        ({"measured": [1.0]}, "measured"),
        ({"measured": np.ones((2, 1))}, "measured"),
        ({"measured": np.array([1e300, 0.0])}, "measured"),
        ({"measured": masked(np.ones(2))}, "measured"),
        ({"measured": np.ones(2) * 1j}, "measured"),
        ({"reference": np.ones(2)}, "reference"),
        ({"reference": np.empty((0, 2))}, "reference"),
        ({"reference": REFERENCE * np.nan}, "reference"),
        ({"reference": REFERENCE * 1e100}, "reference"),
        ({"reference": np.full((2, 2), np.inf)}, "reference"),
    ],
)
def test_a_controller_refuses_by_name(control, change, name) -> None:
    given = {"k": 0, "measured": np.array([1.0, 2.0]), "reference": REFERENCE} | change
    with pytest.raises(ValueError, match=f"^{name} must"):
        control(**given)


@pytest.mark.parametrize("control", CONTROLLERS)
def test_a_controller_takes_the_same_numbers_in_any_form(control) -> None:
    measured = np.array([98.0, 79.0])
    plain = servoing.OptimalController(np.eye(2) * 0.3, **WEIGHTS)(0, measured, REFERENCE)
    for form in (list(measured), measured.astype(">f8"), measured.astype(int)):
        again = servoing.OptimalController(np.eye(2) * 0.3, **WEIGHTS)(0, form, REFERENCE.tolist())
        np.testing.assert_array_equal(again, plain)
    assert np.isfinite(control(0, np.array([np.nan, 1.0]), REFERENCE)).all()


def test_a_summary_of_errors_refuses_by_name() -> None:
    image = SCOPE.project(POINTS / 2)
    found = calibration.calibrate(
        POINTS / 2, image, focal_length=126000.0, pixel_size=9.9, image_size=(300, 260)
    )
    summary = type(found.plane_error)
    for wrong in (np.ones(3), np.ones((3, 3)), [], None, [[np.nan, 1.0]]):
        with pytest.raises(ValueError, match="differences must"):
            summary.of(wrong)


@pytest.mark.parametrize("wrong", [np.nan, [1.0], None, "1", 1e12])
def test_angles_and_distortions_are_numbers(wrong) -> None:
    with pytest.raises(ValueError, match="beta must"):
        microscope.euler_rotation(0.0, wrong, 0.0)
    if wrong != 1e12:
        for function in (microscope.distort, microscope.undistort):
            with pytest.raises(ValueError, match="distortion must"):
                function(POINTS, wrong)
    for function in (microscope.distort, microscope.undistort):
        with pytest.raises(ValueError, match="points must be finite or NaN"):
            function([[np.inf, 0.0]], 1e-9)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("image", lambda: calibration.calibrate(
            POINTS, SCOPE.project(POINTS) * 1e100, pixel_size=9.9, image_size=(300, 260))),
        ("world", lambda: calibration.calibrate(
            POINTS * 1e-300, SCOPE.project(POINTS), pixel_size=9.9, image_size=(300, 260))),
        ("side", lambda: synthetic.render_squares(SCOPE, side=1e30)),
        ("largest", lambda: optics.BlurLadder(np.ones((9, 9)), largest=1e30)),
        ("sigma", lambda: optics.defocus(np.ones((9, 9)), 1e30)),
        ("blur_rate", lambda: synthetic.focal_stack(
            np.ones((9, 9)), np.zeros((9, 9)), [0.0, 1.0], blur_rate=1e30)),
        ("radius", lambda: focus.smooth_depth(np.ones((9, 9)), jump=1.0, radius=1e6)),
        ("delay", lambda: servoing.loop_poles(0.5, 1e9)),
        ("grain", lambda: synthetic.sphere_on_plane((9, 9), 3.0, 1.0, grain=1e30)),
        ("rng", lambda: synthetic.sphere_on_plane((9, 9), 3.0, 1.0, rng="any")),
        ("patch", lambda: synthetic.patchy_texture((20, 24), 0, patch=1e6)),
    ],
)  # fmt: skip
def test_an_absurd_scale_is_refused_at_once(name, call) -> None:
    """Each of them hung, or asked for terabytes."""
    begin = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ValueError, match=f"{name} (and sharpest )?must"):
            call()
    assert time.process_time() - begin < 5  # not a measure of speed: hours would fail


def test_a_covariance_has_no_negative_variance() -> None:
    values = {
        "force": 100.0, "dimple_radius": 200.0, "dimple_depth": 10.0, "thickness": 3.0,
        "probe_half_width": 25.0, "poisson_ratio": 0.5,
    }  # fmt: skip
    for wrong in (-np.eye(2), [[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [0.0, 1.0]]):
        with pytest.raises(ValueError, match="dimple_covariance must be a covariance"):
            membrane.modulus_std(values, {}, dimple_covariance=wrong)
    assert membrane.modulus_std(values, {}, dimple_covariance=np.zeros((2, 2))) == 0
