"""The rules that refuse a depth, each at the limit that its constants set, on maps made by hand."""

import numpy as np
import pytest

from microlib.focus._measures import (
    blur,
    multiscale_measure,
    noise_level,
    noise_response,
    noise_sample,
)
from microlib.focus._reliability import (
    below_noise_mask,
    blurred_edge_mask,
    incoherent_mask,
    isolated_mask,
    set_to_nan,
    small_component_mask,
)


def scattered(middle: int, by: int, seed: int = 0) -> np.ndarray:
    """Numbers of best frames: 30 % lie lower by `by`, 40 % in the middle, 30 % higher."""
    rng = np.random.default_rng(seed)
    return (middle + by * rng.choice([-1, 0, 1], (80, 80), p=[0.3, 0.4, 0.3])).astype(np.uint16)


def test_frames_that_differ_by_more_than_two_are_incoherent():
    # More than half deviate, by as much as is drawn; the medians of 25 miss some of the 60 %.
    assert incoherent_mask(scattered(20, 3), 40).mean() > 0.6
    assert not incoherent_mask(scattered(20, 2), 40).any()
    slope = np.tile(np.arange(80, dtype=np.uint16) // 2, (80, 1))
    assert not incoherent_mask(slope, 40).any()
    assert incoherent_mask(slope, 40).shape == (40, 40)


def test_coherence_does_not_depend_on_where_the_frames_are_counted_from():
    """Numbers above 255 do not fit into the 8 bits that are enough for short stacks."""
    low = incoherent_mask(scattered(20, 3), 256)
    np.testing.assert_array_equal(incoherent_mask(scattered(256, 3), 300), low)
    np.testing.assert_array_equal(incoherent_mask(scattered(252, 3), 256), low)


def test_single_frames_that_stray_are_not_incoherent():
    index = np.full((60, 60), 9, np.uint16)
    index[np.random.default_rng(1).random(index.shape) < 0.2] = 0
    assert not incoherent_mask(index, 20).any()


def test_a_mask_of_every_second_pixel_stands_for_two_by_two():
    depth = np.zeros((5, 7))
    mask = np.zeros((3, 4), bool)
    mask[1, 1] = mask[2, 3] = True
    set_to_nan(depth, mask)
    wanted = np.zeros((5, 7), bool)
    wanted[2:4, 2:4] = wanted[4, 6] = True
    np.testing.assert_array_equal(np.isnan(depth), wanted)


@pytest.mark.parametrize(("count", "limit"), [(1, 1.46), (21, 1.804), (300, 2.1045)])
def test_a_peak_is_judged_by_the_number_of_frames(count, limit):
    for share in (0.999, 1.001):  # the limits are rounded to 3e-4
        ratio = np.full((20, 20), share * limit, np.float32)
        assert (below_noise_mask(ratio, count) == (share < 1)).all()


def test_the_peaks_of_noise_are_averaged_before_they_are_judged():
    ratio = np.ones((81, 81), np.float32)
    ratio[40, 40] = 300.0  # over the 452 px of a Gaussian of 6 px, 0.7 more
    found = below_noise_mask(ratio, 1)
    assert not found[40, 40]
    assert found[40, 56:].all()


@pytest.mark.parametrize("count", [12, 40])
def test_the_limit_is_just_above_what_noise_reaches(count):
    rng = np.random.default_rng(count)
    frames = np.clip(np.rint(128 + 3 * rng.standard_normal((count, 160, 160))), 0, 255)
    noise = noise_level([noise_sample(frames[0].astype(np.uint8))])
    measure = multiscale_measure(noise)
    peak = np.max([measure(frame, slice(0, 160)) for frame in frames], axis=0)
    ratio = (peak / noise_response(noise)).astype(np.float32)
    assert below_noise_mask(ratio, count).mean() > 0.999
    # 99.9 % stay 5 % below the limit, so that a tenth above some do not; see `_NOISE_PEAK`.
    assert below_noise_mask(1.2 * ratio, count).mean() < 0.99


def beside_a_bright_edge(depth: float, weight: float) -> np.ndarray:
    """Mask of a map of depth 5 and weight 1 along a stripe, and of other depths beside it."""
    level = np.full((120, 200), depth)
    strength = np.full(level.shape, weight)
    level[:, 90:110], strength[:, 90:110] = 5.0, 1.0
    return blurred_edge_mask(level, strength)


def test_faint_peaks_at_another_depth_beside_strong_ones_are_a_blurred_edge():
    mask = beside_a_bright_edge(9.0, 0.01)
    assert mask.shape == (60, 100)
    # Boxes of twice 9 reach 8 of every second pixel; nothing further away is known to be outshone.
    assert mask[10:-10, 42:45].all()
    assert mask[10:-10, 55:58].all()
    assert not mask[:, :36].any()
    assert not mask[:, 64:].any()
    assert not mask[:, 46:54].any()


def test_what_is_bright_itself_or_near_in_depth_is_no_blurred_edge():
    assert not beside_a_bright_edge(9.0, 1.0).any()
    assert not beside_a_bright_edge(6.9, 0.01).any()
    assert beside_a_bright_edge(7.4, 0.01).any()
    # Beside an edge about half of the surroundings are strong: the mean weight is 0.5 + w / 2, and
    # w is faint below a fifth of it, which is 0.11.
    assert not beside_a_bright_edge(9.0, 0.16).any()
    assert beside_a_bright_edge(9.0, 0.05).any()


def test_unknown_depths_have_no_weight_in_the_blurred_edge():
    level = np.full((60, 60), 9.0)
    level[:, 30:] = np.nan
    known = blurred_edge_mask(level, np.where(np.isnan(level), 1e6, 1.0))[:, :15]
    assert not known.any()


@pytest.mark.parametrize(
    ("sides", "higher", "goes"),
    [
        ((5, 10), 3.0, True),
        ((3, 17), 3.0, False),
        ((5, 10), 1.6, True),
        ((5, 10), 1.4, False),
        ((5, 10), -3.0, True),
    ],
)
def test_a_component_of_up_to_fifty_pixels_that_stands_apart_goes(sides, higher, goes):
    depth = np.full((40, 40), 7.0)
    part = np.s_[10 : 10 + sides[0], 10 : 10 + sides[1]]
    depth[part] += higher
    depth[30, 30] = np.nan
    wanted = np.zeros(depth.shape, bool)
    wanted[part] = goes
    wanted[30, 30] = True
    np.testing.assert_array_equal(small_component_mask(depth, 0.0), wanted)


def test_steps_high_above_the_lowest_depth_are_seen_up_to_512_frames():
    depth = np.zeros((40, 40))
    depth[:, 20:] = 500.0
    depth[5:8, 30:33] = 503.0
    assert small_component_mask(depth, 0.0).sum() == 9


def test_what_has_fewer_known_depths_around_it_than_unknown_ones_is_isolated():
    depth = np.full((60, 60), np.nan)
    depth[:, :30] = 1.0
    # On a straight border the known are just more than half on its inner side.
    np.testing.assert_array_equal(isolated_mask(depth), np.isnan(depth))
    depth[:, 45:48] = 1.0
    assert isolated_mask(depth)[:, 45:48].all()


def test_surroundings_reach_six_pixels():
    """A known strip of w px fills erf(w / 2 / (σ √2)) of a Gaussian: half at w = 1.35 σ = 8.1."""
    for width, alone in ((6, True), (11, False)):
        depth = np.full((61, 61), np.nan)
        depth[:, 30 - width // 2 : 30 - width // 2 + width] = 1.0
        assert isolated_mask(depth)[30, 30] == alone
    spot = np.zeros((61, 61), np.float32)
    spot[30, 30] = 1
    assert blur(spot, 6.0)[30, 14] >= 0
