"""The rendered frames move by exactly what they say, and the same seed draws the same frames."""

import numpy as np
import pytest
from skimage.registration import phase_cross_correlation

from microlib.synthetic import (
    gripper_scene,
    warped_pair,
)


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
    at, moved = (scene.box(20, s)[:2] for s in ((0, 0), (7, -3)))
    assert moved == tuple(np.add(at, (7, -3)))
