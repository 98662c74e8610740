"""Parts of the second-order minimization against other libraries and numerical derivatives."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.ndimage import map_coordinates

from microlib.synthetic import mixed_texture
from microlib.tracking import _sampling
from microlib.tracking._esm import make_level
from microlib.tracking._geometry import GENERATORS, apply_homography, retract
from microlib.tracking._sampling import half_pixel, sample
from microlib.tracking.robust._photometric import make_photometric

BOX = (30, 24, 40, 36)
POSE = np.array([[20.0, 0, 49.5], [0, 20.0, 41.5], [0, 0, 1]])


def level_of(motion, image, smoothing=1.0):
    return make_level(image, BOX, POSE, smoothing=smoothing, motion=motion)


def texture(seed=0):
    return mixed_texture((90, 100), np.random.default_rng(seed), scales=3.0).astype(np.float32)


@settings(deadline=None, max_examples=60)
@given(
    entries=st.lists(st.floats(-3, 3), min_size=8, max_size=8),
    motion=st.sampled_from(list(GENERATORS)),
)
def test_exponential_agrees_with_scipy(entries, motion):
    basis = GENERATORS[motion]
    step = np.array(entries[: len(basis)])
    matrix = np.tensordot(step, basis, 1)
    # Relative to the largest entry: both are accurate to a few roundings of it.
    scale = np.abs(expm(matrix)).max()
    np.testing.assert_allclose(
        retract(np.eye(3), step, basis), expm(matrix), rtol=0, atol=1e-12 * scale
    )


def test_homographies_are_generated_with_unit_determinant():
    basis = GENERATORS["homography"]
    assert np.trace(basis, axis1=1, axis2=2) == pytest.approx(np.zeros(8), abs=0)
    # Eight independent directions and nothing more: the whole of sl(3).
    assert np.linalg.matrix_rank(basis.reshape(8, 9)) == 8


@pytest.mark.parametrize("motion", list(GENERATORS))
def test_alignment_inverts_a_small_warp_of_its_group(motion):
    image = texture(1)
    one = level_of(motion, image, smoothing=0.0)
    rng = np.random.default_rng(2)
    start = retract(POSE, rng.normal(0, 0.02, len(one.basis)), one.basis)
    result = one.align(image, start, tolerance=1e-4, iterations=20)
    assert not result.failure
    # No noise and no resampling at the solution: what is left is the single precision of the patch.
    np.testing.assert_allclose(
        apply_homography(result.pose, one.corners), apply_homography(POSE, one.corners), atol=2e-3
    )
    assert result.correlation > 0.99999


def test_esm_step_is_of_second_order():
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


def test_half_pixel_samples_agree_with_a_sinusoid():
    x, y = np.meshgrid(np.arange(40.0), np.arange(30.0))
    wave = lambda x, y: np.sin(0.9 * x + 0.3) * np.cos(0.7 * y)  # noqa: E731
    fine = half_pixel(wave(x, y).astype(np.float32))
    np.testing.assert_array_equal(fine[::2, ::2], wave(x, y).astype(np.float32))
    inner = fine[6:-6, 6:-6]
    x, y = np.meshgrid(np.arange(6, 74) / 2, np.arange(6, 54) / 2)
    # The six-tap interpolator is wrong by 0.3 % at 0.9 rad/px, linear interpolation by 10 %.
    assert np.abs(inner - wave(x, y)).max() < 0.004


@pytest.mark.parametrize("rounds", [False, True])
def test_patches_are_bilinear_samples_at_exact_places(rounds, monkeypatch):
    """By OpenCV's own sampler, if it does not round, and by the one in its place."""
    if not rounds and _sampling._ROUNDS:
        pytest.skip("this OpenCV rounds places to 1/32 px")
    monkeypatch.setattr(_sampling, "_ROUNDS", rounds)
    image = texture(2)
    turn = np.array([[0.9, -0.3, 30.2], [0.25, 1.1, 10.7], [1e-3, -5e-4, 1]])
    away = turn.copy()
    away[0, 2] += 60  # partly beyond the image
    rows, columns = np.mgrid[:30, :40]
    for warp in (turn, away):
        patch, shown = sample(image, warp, (40, 30), exact=True)
        x, y = apply_homography(warp, np.column_stack([columns.ravel(), rows.ravel()])).T
        truth = map_coordinates(image, [y, x], order=1, mode="nearest").reshape(30, 40)
        # Places in single precision, 10⁻⁵ px, times a gradient of 50 levels/px.
        np.testing.assert_allclose(patch, truth, atol=1e-3)
        beyond = (x < 0) | (x > 99) | (y < 0) | (y > 89)
        np.testing.assert_array_equal(shown.ravel(), ~beyond)


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


@pytest.mark.parametrize(("width", "height"), [(40, 36), (40, 37), (41, 37)])
def test_photometric_gain_and_bias_are_those_at_the_middle(width, height):
    x, y, _, _ = box = (*BOX[:2], width, height)
    pose = np.array([[20, 0, x + (width - 1) / 2], [0, 20, y + (height - 1) / 2], [0, 0, 1.0]])
    image = 100 + 40 * texture()

    def cut(one):
        return make_level(
            half_pixel(one), box, pose, density=2, smoothing=0.6, motion="translation"
        )

    level = make_photometric(cut(image), cut(cv2.GaussianBlur(image, (0, 0), 0.8)), 5)
    right = np.arange(image.shape[1], dtype=np.float32) - np.float32(pose[0, 2])
    frame = 1.2 * image + 20 + 0.5 * right
    fit = level.align_photometric(half_pixel(frame), pose, 1.0, np.inf)
    # No noise: single precision, and the half px from the middle of an even side to its pixel.
    assert fit.gain == pytest.approx(1.2, abs=1e-3)
    assert fit.bias == pytest.approx(20, abs=0.25 + 0.01)
