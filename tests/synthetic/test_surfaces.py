"""The scenes themselves: what is called truth has to be true."""

import cv2
import numpy as np
import pytest

from microlib import synthetic
from microlib.curvature import surface_curvature

SHAPE = (40, 50)


def test_textures_have_the_given_contrast_and_scales():
    texture = synthetic.mixed_texture((256, 256), np.random.default_rng(0), mean=100, std=20)
    assert texture.mean() == pytest.approx(100, abs=1e-3)
    assert texture.std() == pytest.approx(20, rel=1e-4)
    octaves = [
        np.std(cv2.GaussianBlur(texture, (0, 0), s) - cv2.GaussianBlur(texture, (0, 0), 2 * s))
        for s in (0.7, 1.4, 2.8, 5.6)
    ]
    # Five scales of equal variance: no octave has less than a sixth of the contrast.
    assert min(octaves) > 20 / 6
    fine = synthetic.mixed_texture((400, 400), 0, scales=1.5, mean=0.0, std=1.0)
    # White noise through a Gaussian of σ has the autocorrelation exp(−d²/(4σ²)); 400² pixels know
    # it to about 1 %.
    for d in (1, 2, 3):
        correlation = np.mean(fine * np.roll(fine, d, axis=1))
        assert correlation == pytest.approx(np.exp(-(d**2) / (4 * 1.5**2)), abs=0.03)


def test_surfaces_have_the_expected_curvature():
    height, width = 500.0, 40.0
    parabola = synthetic.parabolic_cylinder((61, 71), height, width=width)
    default = synthetic.parabolic_cylinder((61, 71), height)  # as wide as the map
    np.testing.assert_allclose(default, synthetic.parabolic_cylinder((61, 71), height, width=70.0))
    found = surface_curvature(parabola, pixel_size=10.0, size=3)
    # z'' = -8 h / w² at the crest, w in µm; a window of 3 px is exact on a parabola.
    assert found.mean[30, 35] == pytest.approx(-4 * height / (10 * width) ** 2, rel=1e-9)
    assert found.gaussian[30, 35] == pytest.approx(0, abs=1e-15)
    ball = synthetic.sphere_on_plane((241, 241), radius=400.0, pixel_size=4.0)
    found = surface_curvature(ball, pixel_size=4.0)
    assert found.mean[120, 120] == pytest.approx(-1 / 400, rel=0.01)
    assert found.gaussian[120, 120] == pytest.approx(1 / 400**2, rel=0.01)
    assert ball.max() == pytest.approx(800, rel=1e-3)
    assert ball[0, 0] == 0


def test_noise_at_white_and_black_is_cut_off():
    for level in (0.0, 255.0):
        flat = np.full(SHAPE, level)
        frame = synthetic.focal_stack(flat, 0 * flat, [0.0], blur_rate=0.1, noise=3.0, rng=0)[0]
        assert np.abs(frame - level).max() < 20
        assert np.mean(frame == level) > 0.4


@pytest.mark.parametrize("height", [5.0, 12.0, -2.0], ids=["between", "above", "below"])
def test_blur_grows_with_the_distance_from_focus(height):
    rng, positions = np.random.default_rng(0), [0.0, 5.0, 10.0]
    texture = synthetic.mixed_texture(SHAPE, rng)
    stack = synthetic.focal_stack(texture, np.full(SHAPE, height), positions, blur_rate=0.3)
    for frame, position in zip(stack, positions, strict=True):
        sigma = np.hypot(0.5, 0.3 * (height - position))
        peer = cv2.GaussianBlur(texture, (31, 31), sigma, borderType=cv2.BORDER_REFLECT)
        # Half a grey level of rounding and what the ladder of blurs leaves.
        assert np.abs(frame - np.clip(peer, 0, 255)).max() < 0.8


def test_stacks_drawn_with_one_generator_have_independent_noise():
    rng, flat = np.random.default_rng(3), np.full((32, 32), 128.0)
    one, two = (
        synthetic.focal_stack(flat, 0 * flat, [0.0], blur_rate=0.1, noise=2.0, rng=rng)
        for _ in range(2)
    )
    # A correlation of 1024 independent pairs has the standard deviation 0.03.
    assert abs(np.corrcoef(one.ravel(), two.ravel())[0, 1]) < 0.2
