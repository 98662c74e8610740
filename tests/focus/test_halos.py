"""Halos of strong edges, told from things of their own by imaging the scene again."""

import numpy as np
import pytest
from skimage import data

from microlib import synthetic
from microlib.focus import depth_from_focus
from microlib.focus._halos import _differs, _growth, _misfit, _overhang, _wide_depth, check_halos
from microlib.focus._nearest import halved
from microlib.focus._questions import alone
from microlib.focus._window import Window

SHAPE = (160, 160)
#: Depths by two measures that agree.
AGREED = np.zeros(SHAPE, np.float32)
POSITIONS = np.arange(15.0)


def stack_of(texture, height, *, noise=1.0, seed=0, rate=1.0):
    rng = np.random.default_rng(seed)
    return synthetic.focal_stack(texture, height, POSITIONS, blur_rate=rate, noise=noise, rng=rng)


def halos(stack, depth, disagreement, noise):
    depth, apart = depth[::2, ::2], disagreement[::2, ::2]
    window = Window.whole(SHAPE)
    return alone(check_halos(lambda: iter(stack), 15, depth, apart, noise, window=window))


def inner(half):
    """How far the wide windows' parts in the image lie further inside."""
    rows, cols = half.shape
    return _overhang(Window.whole((2 * rows, 2 * cols)))


def lettering():
    """Bright strokes on a dark ground that has no texture to speak of."""
    texture = np.full(SHAPE, 40.0)
    for left in range(10, 160, 36):
        texture[20:140, left : left + 6] = 230
        texture[60:66, left : left + 20] = 230
    return texture


def test_a_halo_takes_the_depth_of_its_edge():
    height = np.full(SHAPE, 7.0)
    stack = stack_of(lettering(), height)
    depth = np.full(SHAPE, 7.0)
    depth[30:50, 18:28] = 11.0  # beside a stroke, as its blur has it
    depth[100:120, 60:70] = np.nan
    wide = halos(stack, depth, AGREED, 1.0)
    inner = np.s_[16:24, 10:13]
    assert wide.instead[inner].all()
    np.testing.assert_allclose(wide.depth[inner], 7.0, atol=0.2)
    assert wide.instead[51:59, 31:34].all()
    assert not wide.instead[40:50, 20:30].any()


def test_where_two_measures_have_no_peak_in_common_the_wide_depth_is_taken():
    """Random depths, some less than the usual gap from the wide one."""
    stack = stack_of(synthetic.mixed_texture(SHAPE, np.random.default_rng(4)), np.full(SHAPE, 7.0))
    depth = 7.0 + np.random.default_rng(5).uniform(-1, 1, SHAPE)
    apart = AGREED.copy()
    apart[:, :80] = 0.6
    wide = halos(stack, depth, apart, 1.0)
    far = np.abs(depth[::2, ::2] - 7.0) > 0.5
    assert wide.instead[10:-10, 10:30][far[10:-10, 10:30]].all()
    assert not wide.instead[10:-10, 50:-10].any()
    # One pixel alone may be far off: it is the mean that counts, and no pixel more than 3 frames.
    spike = AGREED.copy()
    spike[40, 40] = 1e3
    assert not halos(stack, depth, spike, 1.0).instead.any()


def test_random_depths_are_unknown_beside_a_step_and_where_the_wide_window_sees_nothing():
    height = 3.0 + synthetic.step(SHAPE, 7.0)
    texture = synthetic.mixed_texture(SHAPE, np.random.default_rng(6))
    depth = np.random.default_rng(7).uniform(0, 14, SHAPE)
    stack = stack_of(texture, height)
    step = halos(stack, depth, AGREED + 2, 1.0)
    beyond = (depth[::2, ::2] < 2.0) | (depth[::2, ::2] > 11.0)
    assert step.neither[14:-14, 36:44][beyond[14:-14, 36:44]].all()
    assert not step.instead[14:-14, 36:44].any()
    blank = stack_of(np.full(SHAPE, 100.0), height, noise=3.0)
    nothing = halos(blank, depth, AGREED + 2, 3.0)
    assert nothing.neither[np.isnan(nothing.depth)].all()
    assert np.isnan(nothing.depth).mean() > 0.9


def test_a_thing_with_texture_of_its_own_keeps_its_depth():
    """A patch four frames higher than strokes that are brighter and take the wide window."""
    texture, height = lettering(), np.full(SHAPE, 5.0)
    patch = np.s_[76:116, 90:116]
    texture[patch] = synthetic.mixed_texture(SHAPE, np.random.default_rng(3))[patch]
    height[patch] = 9.0
    stack = stack_of(texture, height)
    wide = halos(stack, height, AGREED, 1.0)
    inner = np.s_[43:53, 48:54]
    assert np.abs(wide.depth[inner] - 5.0).mean() < 2.0  # or there is nothing to keep
    assert wide.instead[inner].mean() < 0.2
    assert wide.neither[inner].mean() < 0.2


def test_the_blur_of_a_frame_is_measured():
    texture = synthetic.mixed_texture(SHAPE, np.random.default_rng(0))
    height = 7 + synthetic.tilted_plane(SHAPE, 6 / 160, 0.0)
    for rate in (0.6, 1.0, 1.6):
        stack = stack_of(texture, height, rate=rate)
        wide = np.asarray(height[::2, ::2], np.float32)
        scene = np.choose(np.rint(wide).astype(int), np.stack([halved(f) for f in stack]))
        # Of half the pixels, half the rate; the blurs tried are up to a third apart.
        assert _growth([_misfit(iter(stack), scene, wide)]) == pytest.approx(rate / 2, rel=0.2)


def test_the_wide_window_says_nothing_where_there_is_only_noise():
    texture = np.full(SHAPE, 100.0)
    texture[:, :40] = synthetic.mixed_texture(SHAPE, np.random.default_rng(0))[:, :40]
    stack = stack_of(texture, np.full(SHAPE, 6.0), noise=3.0)
    depth, _ = alone(_wide_depth(iter(stack), 15, 0.0))
    np.testing.assert_allclose(depth[:, :20], 6.0, atol=0.3)
    assert np.isnan(depth[:, 36:]).mean() > 0.99  # 26 px and the spread of the blur further


def test_depths_between_those_of_both_sides_of_a_step_are_believed():
    wide = np.zeros((60, 60), np.float32)
    wide[:, 30:] = 8.0
    narrow = np.full_like(wide, 4.0)
    differs = _differs(narrow, wide, inner(wide), 11)
    assert not differs[:, 26:34].any()
    assert differs[20:40, :20].all()
    wide[:, 30:] = np.nan
    assert not _differs(narrow, wide, inner(wide), 11)[:, 30:].any()


def test_a_slope_is_believed_up_to_the_border_where_the_wide_window_is_cut_off():
    """There it sees the inner side only, and is wrong by the slope times what it lacks."""
    slope = np.tile(0.25 * np.arange(80.0), (80, 1)).astype(np.float32)
    seen = np.clip(slope, 0.25 * 6.5, 0.25 * (79 - 6.5))
    assert not _differs(slope, seen, inner(seen), 11).any()
    flat = np.zeros_like(slope)
    assert _differs(flat + 1.3, flat, inner(flat), 11).all()


def test_a_photograph_with_bare_ground_has_depth_nearly_everywhere():
    """Coins on cloth: a fifth was unknown or wrong before the wide window was asked."""
    texture = data.coins()[:192, :192].astype(float)
    height = 5 + synthetic.paraboloid(texture.shape, 4.0)
    found = depth_from_focus(stack_of(texture, height, noise=2.0), POSITIONS)
    error = (found.depth - height)[10:-10, 10:-10]
    known = np.isfinite(error)
    assert known.mean() > 0.95
    # 0.005 before depths by two measures were compared.
    assert np.mean(np.abs(error[known]) > 1) < 0.003


def test_beside_a_step_the_wide_depth_takes_no_place():
    """The wide window takes the better lit side's depth up to 26 px beyond the edge."""
    height = 3.2 + synthetic.step(SHAPE, 7.7)
    texture = synthetic.mixed_texture(SHAPE, np.random.default_rng(1))
    texture[:, :80] = 128 + 0.2 * (texture[:, :80] - 128)
    stack = stack_of(texture, height)
    wide = halos(stack, height, AGREED, 1.0)
    late = np.abs(wide.depth - height[::2, ::2]) > 4
    assert late.mean() > 0.1  # or there is nothing to see
    assert not (wide.instead & late).any()
    wrong = np.abs(depth_from_focus(stack, POSITIONS).depth - height)[10:-10, 10:-10] > 1
    assert wrong.mean() < 0.02  # 0.069 if the wide depth were taken


@pytest.mark.parametrize("shape", [(1, 40), (40, 1), (2, 40), (40, 2), (1, 1)])
def test_a_stack_of_a_row_or_a_column_has_a_result(shape):
    frames = np.random.default_rng(0).integers(0, 255, (9, *shape)).astype(np.uint8)
    result = depth_from_focus(frames, np.arange(9.0))
    assert result.depth.shape == shape
    assert (np.isnan(result.uncertainty) == np.isnan(result.depth)).all()
