"""Parts of the second-order minimization against numerical derivatives and other libraries."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from microlib.synthetic import mixed_texture
from microlib.tracking._esm import (
    MOTIONS,
    apply_homography,
    generators,
    half_pixel,
    make_level,
)
from microlib.tracking._esm import _correlation as correlation
from microlib.tracking._loops import moved

BOX = (30, 24, 40, 36)
POSE = np.array([[20.0, 0, 49.5], [0, 20.0, 41.5], [0, 0, 1]])


def level_of(motion: str, image: np.ndarray, smoothing: float = 1.0):
    return make_level(image, BOX, POSE, step=1, density=1, smoothing=smoothing, motion=motion)


def texture(seed: int = 0) -> np.ndarray:
    return mixed_texture((90, 100), np.random.default_rng(seed), scales=3.0).astype(np.float32)


@settings(deadline=None, max_examples=60)
@given(
    entries=st.lists(st.floats(-3, 3), min_size=8, max_size=8),
    motion=st.sampled_from(MOTIONS),
)
def test_exponential_agrees_with_scipy(entries, motion):
    basis = generators(motion)
    matrix = np.tensordot(entries[: len(basis)], basis, 1)
    # Relative to the largest entry: both are accurate to a few roundings of it.
    scale = np.abs(expm(matrix)).max()
    np.testing.assert_allclose(
        moved(np.eye(3), np.array(entries[: len(basis)]), basis),
        expm(matrix),
        rtol=0,
        atol=1e-12 * scale,
    )


def test_homographies_are_generated_with_unit_determinant():
    basis = generators("homography")
    assert np.trace(basis, axis1=1, axis2=2) == pytest.approx(np.zeros(8), abs=0)
    # Eight independent directions and nothing more: the whole of sl(3).
    assert np.linalg.matrix_rank(basis.reshape(8, 9)) == 8


@pytest.mark.parametrize("motion", MOTIONS)
def test_the_flow_is_the_derivative_of_the_warp(motion):
    one = level_of(motion, texture())
    row, column = 7, 11
    pad = (one.padded[0] - BOX[2]) // 2
    patch = np.array([[column + pad, row + pad]], float)
    point = apply_homography(one.to_template, patch)
    step = 1e-6
    for number, generator in enumerate(one.basis):
        ahead = apply_homography(moved(np.eye(3), np.array([step]), generator[None]), point)
        back = apply_homography(moved(np.eye(3), np.array([-step]), generator[None]), point)
        to_patch = np.linalg.inv(one.to_template)
        numeric = (apply_homography(to_patch, ahead) - apply_homography(to_patch, back)) / (
            2 * step
        )
        # Central differences over 1e-6 leave about 1e-8; the flow is kept in single precision.
        stored = one.flow[:, number, row * BOX[2] + column]
        np.testing.assert_allclose(stored, numeric[0], atol=2e-5)


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_fit_undoes_a_small_warp_of_its_own_group(motion):
    image = texture(1)
    one = level_of(motion, image, smoothing=0.0)
    rng = np.random.default_rng(2)
    start = moved(POSE, rng.normal(0, 0.02, len(one.basis)), one.basis)
    result = one.align(image, start, tolerance=1e-4, iterations=20)
    assert not result.failure
    # No noise and no resampling at the solution: what is left is the single precision of the patch.
    np.testing.assert_allclose(
        apply_homography(result.pose, one.corners), apply_homography(POSE, one.corners), atol=2e-3
    )
    assert result.correlation > 0.99999


def test_the_step_is_of_second_order():
    # Whole pixels, so that interpolation takes no part, on a texture much coarser than the steps.
    image = mixed_texture((90, 100), np.random.default_rng(3), scales=6.0).astype(np.float32)
    one = level_of("translation", image, smoothing=0.0)
    errors = []
    for distance in (4, 2):
        start = np.array([[1.0, 0, distance], [0, 1, 0], [0, 0, 1]]) @ POSE
        errors.append(
            abs(one.align(image, start, tolerance=0, iterations=1).pose[0, 2] - POSE[0, 2])
        )
    # Halving the distance leaves a quarter of a first-order step's error (Gauss-Newton: 3.9 here),
    # an eighth of a second-order step's.
    assert errors[1] < errors[0] / 6


def test_half_pixel_keeps_the_pixels_and_meets_a_sinusoid_between_them():
    x, y = np.meshgrid(np.arange(40.0), np.arange(30.0))
    wave = lambda x, y: np.sin(0.9 * x + 0.3) * np.cos(0.7 * y)  # noqa: E731
    fine = half_pixel(wave(x, y).astype(np.float32))
    np.testing.assert_array_equal(fine[::2, ::2], wave(x, y).astype(np.float32))
    inner = fine[6:-6, 6:-6]
    x, y = np.meshgrid(np.arange(6, 74) / 2, np.arange(6, 54) / 2)
    # The six-tap interpolator is wrong by 0.3 % at 0.9 rad/px, linear interpolation by 10 %.
    assert np.abs(inner - wave(x, y)).max() < 0.004


def test_correlation_finds_what_lies_beyond_any_gradient():
    image = texture(4)
    one = level_of("translation", image)
    start = np.array([[1.0, 0, 17], [0, 1, -13], [0, 0, 1]]) @ POSE
    np.testing.assert_allclose(one.correlate(image, start, 20), POSE, atol=1e-9)


def test_a_singular_system_and_a_warp_out_of_view_are_states_not_exceptions():
    one = level_of("affine", texture())
    blank = one.align(np.zeros((90, 100), np.float32), POSE, tolerance=0.0, iterations=5)
    assert blank.failure == "singular"
    away = np.array([[1.0, 0, 400], [0, 1, 0], [0, 0, 1]]) @ POSE
    assert one.align(texture(), away, tolerance=0.1, iterations=5).failure == "out of view"


def test_smoothing_in_the_frame_of_the_template_commutes_with_the_warp():
    image = texture(5)
    angle = 0.5
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    stretch = POSE @ turn @ np.diag([1.3, 0.8, 1.0]) @ np.linalg.inv(POSE)
    flags = cv2.INTER_CUBIC
    warped = cv2.warpPerspective(
        image, stretch, (100, 90), flags=flags, borderMode=cv2.BORDER_REFLECT
    )
    one = level_of("affine", image, smoothing=2.0)
    result = one.align(warped, stretch @ POSE, tolerance=1e-3, iterations=20)
    found = apply_homography(result.pose, one.corners)
    truth = apply_homography(stretch @ POSE, one.corners)
    # Measured 0.011 px, from two interpolations; smoothing the frames instead leaves 0.060 px.
    assert np.abs(found - truth).max() < 0.03


def test_what_does_not_vary_correlates_with_nothing():
    """Products of template, one and image over four pixels, the image being flat."""
    template, flat = np.array([1.0, 2.0, 4.0, 3.0]), np.full(4, 7.0)
    parts = np.stack([template, np.ones(4), flat])
    assert correlation(parts @ parts.T) == 0.0
    alike = np.stack([template, np.ones(4), 5 - 2 * template])
    assert correlation(alike @ alike.T) == pytest.approx(-1.0, abs=1e-12)
