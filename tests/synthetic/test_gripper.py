"""The rendered frames move by exactly what they say, and the same seed draws the same frames."""

import numpy as np
import pytest
from skimage.registration import phase_cross_correlation

from microlib.synthetic import gripper_scene


@pytest.mark.parametrize("pixel_size", [6.23, 1.55])
def test_gripper_moves_by_the_shift(pixel_size):
    scene = gripper_scene(np.random.default_rng(3), pixel_size=pixel_size)
    assert scene.opening == pytest.approx(100 / pixel_size)
    np.testing.assert_allclose(scene.cover, scene.cover[::-1], atol=0.4)  # to a quarter px
    noise = np.subtract(*(scene.frame((0, 0), seed).astype(float) for seed in (1, 2)))
    assert noise.std() == pytest.approx(np.sqrt(2 * (2.0**2 + 1 / 12)), rel=0.02)
    rng = np.random.default_rng(0)
    shift = np.array([7.3, -4.6])
    with pytest.raises(ValueError, match="shift must lie within"):
        scene.frame((0, 1000), rng)
    # The ground rests, so compare the gripper alone.
    scene.ground[:] = 0.0
    first, second = (scene.frame(s, rng, noise=0.0).astype(float) for s in ((0, 0), shift))
    window = np.s_[40:200, 60:200]
    found = phase_cross_correlation(second[window], first[window], upsample_factor=20)[0]
    # The jaw enters and leaves the window of the peer.
    np.testing.assert_allclose(found[::-1], shift, atol=0.15)
    at, moved = (scene.box(20, s)[:2] for s in ((0, 0), (7, -3)))
    assert moved == tuple(np.add(at, (7, -3)))
    np.testing.assert_allclose(np.add(at, 9.5), (159.5, 119.5), atol=0.5)  # the middle
