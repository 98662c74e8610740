"""What is stated where the light changes from frame to frame."""

import numpy as np
import pytest

from microlib import synthetic
from microlib.focus import depth_from_focus
from microlib.focus._flicker import flicker_variance, watched

SIZES = np.ones(21, np.intp)
#: A peak of standard deviation 1 frame.
WIDTH = 2.5


def test_drift_pulls_a_gaussian_by_its_variance_times_the_slope():
    """Two factors exp(g k) of the measure: -(k - z)²/2 + 2 g k is highest at z + 2 g."""
    depth = np.linspace(6, 14, 90).reshape(9, 10)
    levels = 100 * np.exp(0.02 * np.arange(21))
    pull = np.sqrt(flicker_variance(depth, levels, SIZES, WIDTH))
    np.testing.assert_allclose(pull, 0.04, rtol=0.02)  # a mean over a frame of uneven places
    # Peaks twice as wide, and frames averaged in pairs: the same in frames of their own.
    pairs = flicker_variance(depth / 2, np.repeat(levels, 2), 2 * SIZES, 2 * WIDTH)
    np.testing.assert_allclose(np.sqrt(pairs), 0.04, rtol=0.02)


def test_one_bright_frame_pulls_its_neighbors_and_no_others():
    levels = np.full(21, 100.0)
    levels[10] *= 1.1
    pull = np.sqrt(flicker_variance(np.arange(21.0)[None], levels, SIZES, WIDTH))[0]
    assert (pull[[9, 11]] > 0.04).all()
    assert pull[[3, 17]].max() < 0.005


def test_steady_light_and_light_that_is_not_known_pull_nothing():
    depth = np.array([[3.0, np.nan], [12.0, 20.0]])
    assert not flicker_variance(depth, np.full(21, 50.0), SIZES, WIDTH).any()
    assert not flicker_variance(depth, np.linspace(-1, 1, 21), SIZES, WIDTH).any()
    wild = flicker_variance(depth, np.geomspace(1e-3, 1e30, 21), SIZES, WIDTH)
    assert np.isfinite(wild).all()
    assert wild[0, 1] == 0


def test_levels_are_the_means_of_the_frames_that_pass():
    frames, levels = [np.full((4, 5), k, np.uint8) for k in (3, 9)], []
    assert [int(frame[0, 0]) for frame in watched(frames, levels)] == [3, 9]
    assert levels == [3.0, 9.0]


@pytest.mark.parametrize("drift", [False, True])
def test_errors_from_flicker_are_stated(drift):
    """Of 15 % a frame, or of a factor of two over the stack; else ratios of 4 to 8."""
    height = 4 + synthetic.tilted_plane((144, 144), 5 / 144, 2 / 144)
    rng = np.random.default_rng(3)
    texture = synthetic.mixed_texture(height.shape, rng)
    positions = np.arange(15.0)
    stack = synthetic.focal_stack(texture, height, positions, blur_rate=1.0, noise=2.0, rng=rng)
    gain = 2 ** (positions / 14) if drift else 1 + rng.uniform(-0.15, 0.15, 15)
    shown = np.clip(0.6 * gain[:, None, None] * stack, 0, 255).astype(np.uint8)
    found = depth_from_focus(shown, positions)
    inner = np.s_[10:-10, 10:-10]
    error = np.sqrt(np.mean((found.depth - height)[inner] ** 2))
    assert error > 0.05
    assert 0.6 < error / np.sqrt(np.mean(found.uncertainty[inner] ** 2)) < 1.5
