"""The rendered frames move by exactly what they say, and the same seed draws the same frames."""

import numpy as np
import pytest
from skimage.registration import phase_cross_correlation

from microlib.synthetic import (
    camera_frame,
    gripper_scene,
    mixed_texture,
    texture_sequence,
    warped_pair,
)


def test_texture_has_the_correlation_of_a_blurred_noise():
    texture = mixed_texture((400, 400), np.random.default_rng(0), scales=1.5, std=30.0)
    assert texture.mean() == pytest.approx(128.0)
    assert texture.std() == pytest.approx(30.0)
    centered = texture - texture.mean()
    # White noise through a Gaussian of σ has the autocorrelation exp(−d²/(4σ²)); 400² pixels know
    # it to about 1 %.
    for distance in (1, 2, 3):
        correlation = np.mean(centered * np.roll(centered, distance, axis=1)) / centered.var()
        assert correlation == pytest.approx(np.exp(-(distance**2) / (4 * 1.5**2)), abs=0.03)


@pytest.mark.parametrize("warp", ["shift", "affine", "homography"])
def test_corners_move_by_the_distance_asked_for(warp):
    pair = warped_pair(np.random.default_rng(1), 6.0, warp=warp)
    x, y, width, height = pair.box
    corners = [[x, y], [x + width - 1, y], [x + width - 1, y + height - 1], [x, y + height - 1]]
    moved = pair.corners - corners
    assert np.sqrt(np.mean(np.sum(moved**2, axis=1))) == pytest.approx(6.0)
    if warp == "affine":  # opposite corners: an affine map keeps the parallelogram
        np.testing.assert_allclose(moved[0] + moved[2], moved[1] + moved[3], atol=1e-12)


def test_a_shifted_pair_agrees_with_phase_correlation():
    pair = warped_pair(np.random.default_rng(2), 4.3, noise=0.0, gain=1.0)
    moved = pair.corners[0] - pair.box[:2]
    found = phase_cross_correlation(
        pair.second, pair.first, upsample_factor=50, normalization=None
    )[0]
    # Resolution of the peer: 1/50 px.
    np.testing.assert_allclose(found[::-1], moved, atol=0.03)


@pytest.mark.parametrize("pixel_size", [6.23, 1.55])
def test_the_gripper_moves_by_the_shift(pixel_size):
    scene = gripper_scene(np.random.default_rng(3), pixel_size=pixel_size)
    assert scene.opening == pytest.approx(100 / pixel_size)
    rng = np.random.default_rng(0)
    shift = np.array([7.3, -4.6])
    # The ground rests, so compare the gripper alone.
    scene.ground[:] = 0.0
    first, second = (scene.frame(s, rng, noise=0.0).astype(float) for s in ((0, 0), shift))
    window = np.s_[40:200, 60:200]
    found = phase_cross_correlation(second[window], first[window], upsample_factor=20)[0]
    # The jaw enters and leaves the window of the peer.
    np.testing.assert_allclose(found[::-1], shift, atol=0.15)


def test_a_square_sits_where_it_is_put():
    rng = np.random.default_rng(4)
    still, moved = texture_sequence([[20.0, 20.0], [23.0, 21.0]], rng, noise=0.0)
    # Whole pixels: the square is copied, up to the rounding of two cameras.
    inner, shifted = still[22:68, 22:68].astype(int), moved[23:69, 25:71].astype(int)
    assert np.abs(inner - shifted).max() <= 1
    assert np.array_equal(still[:19], moved[:19])


def test_the_camera_counts_in_grey_levels():
    frame = camera_frame(np.full((200, 200), 100.0), np.random.default_rng(6), noise=2.0, gain=1.2)
    assert frame.dtype == np.uint8
    # 40,000 pixels: the mean to 0.01, the spread to 0.4 %, and 1/12 of rounding variance.
    assert frame.mean() == pytest.approx(120.0, abs=0.05)
    assert frame.std() == pytest.approx(np.hypot(2.0, 12**-0.5), rel=0.02)
