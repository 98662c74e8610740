"""The steps from a fitted depth to the default's, each on maps whose answer is known."""

import numpy as np
import pytest
from scipy import ndimage

from microlib.focus import _depth, _multiscale
from microlib.focus._nearest import filled
from microlib.focus._window import Window


def test_spikes_go_where_they_are_further_than_a_frame_from_the_median():
    depth = np.full((20, 20), 5.0, np.float32)
    depth[5, 5], depth[10, 10] = 6.0, 6.1
    found = _multiscale._without_spikes(depth, 5)
    assert found[5, 5] == 6.0
    assert found[10, 10] == 5.0


def test_a_pixel_at_a_step_takes_the_depth_of_its_own_side():
    """The broad depth puts the step two pixels too far; the fine one knows its place."""
    place = np.arange(40)
    fine = np.tile(np.where(place < 20, 0.0, 5.0), (40, 1)).astype(np.float32)
    broad = np.tile(np.where(place < 22, 0.0, 5.1), (40, 1)).astype(np.float32)
    sure = np.ones(fine.shape, bool)
    mended = _multiscale._choose_side(broad, fine, sure)
    np.testing.assert_allclose(mended, np.where(fine > 0, broad[0, -1], 0.0))
    np.testing.assert_array_equal(_multiscale._choose_side(broad, fine, ~sure), broad)
    far = np.tile(np.where(place < 25, 0.0, 5.1), (40, 1)).astype(np.float32)
    # Five pixels away the nearer neighbors see the wrong side still, those at six do not.
    np.testing.assert_allclose(_multiscale._choose_side(far, fine, sure), mended)


@pytest.mark.parametrize(("gap", "moves"), [(1.4, False), (1.6, True)])
def test_a_side_is_chosen_only_where_the_two_depths_differ_clearly(gap, moves):
    broad = np.zeros((30, 30), np.float32)
    broad[:, 15:] = gap
    fine = np.zeros_like(broad)
    fine[:, 16:] = gap  # one column is on the wrong side
    mended = _multiscale._choose_side(broad, fine, np.ones(fine.shape, bool))
    assert (mended[:, 15] == (0 if moves else np.float32(gap))).all()


def test_a_neighbor_that_does_not_agree_is_not_taken():
    broad, fine = np.full((30, 30), 4.0, np.float32), np.zeros((30, 30), np.float32)
    sure = np.ones(fine.shape, bool)
    np.testing.assert_array_equal(_multiscale._choose_side(broad, fine, sure), broad)
    broad[:, 15:] = 0.9  # with 0.05 a pixel: 1.05 at three
    assert (_multiscale._choose_side(broad, fine, sure)[:, :15] == 4.0).all()
    broad[:, 15:] = 0.8
    changed = _multiscale._choose_side(broad, fine, sure)[:, :15] < 4
    assert changed[:, 12:].all()
    assert not changed[:, :12].any()  # 0.8 + 6 · 0.05 is more than one


def test_windows_see_less_towards_the_border():
    inner = _multiscale._inside(Window.whole((30, 40)))
    np.testing.assert_allclose(inner[15, :9], [1 / 8, 2 / 8, 3 / 8, 0.5, 5 / 8, 6 / 8, 7 / 8, 1, 1])
    np.testing.assert_allclose(inner, inner[::-1, ::-1])
    np.testing.assert_allclose(inner.min(axis=1)[:2], 1 / 8)


def test_unknown_depths_are_filled_by_the_nearest():
    depth = np.tile(np.arange(8.0), (6, 1))
    depth[:, 3] = np.nan
    depth[2, 4] = np.nan
    found = filled(depth)
    assert np.isin(found[:, 3], [2.0, 4.0]).all()
    known = ~np.isnan(depth)
    np.testing.assert_array_equal(found[known], depth[known])
    np.testing.assert_array_equal(filled(np.full((3, 3), np.nan)), np.zeros((3, 3)))


def test_filled_depths_are_those_of_a_distance_transform():
    rng = np.random.default_rng(1)
    depth = rng.random((120, 150)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.97] = np.nan
    depth[40:80, 30:70] = np.nan
    distance = ndimage.distance_transform_edt(np.isnan(depth))
    found = filled(depth)
    # Of several that are as near any may be taken: how far it is tells.
    place = {value: divmod(k, 150) for k, value in enumerate(depth.ravel()) if value == value}
    y, x = (
        np.array([place[value] for value in found.ravel()]).reshape(120, 150, 2).transpose(2, 0, 1)
    )
    rows, cols = np.indices(depth.shape)
    np.testing.assert_allclose(np.hypot(y - rows, x - cols), distance)
    alone = np.full((200, 3), np.nan)
    alone[0] = 5.0
    np.testing.assert_array_equal(filled(alone)[:49], 5.0)
    assert not filled(alone)[49:].any()


def test_roughness_is_that_of_the_noise_and_not_of_the_slope():
    positions = np.arange(20.0)
    y, x = np.mgrid[:200, :200].astype(np.float32)
    slope = 5 + 0.02 * x + 0.01 * y
    index = np.zeros(slope.shape, np.uint16)
    inner = np.s_[64:-64, 64:-64]  # four means that reach 16 px each
    # float32 differences of depths around 10
    assert np.abs(_depth._roughness(slope, positions, index)[inner]).max() < 1e-4
    noise = 0.3 * np.random.default_rng(0).standard_normal(slope.shape).astype(np.float32)
    rough = _depth._roughness(slope + noise, positions, index)[inner]
    # 1 - 4 / (2 π σ²) = 0.96 of the variance is left by four means of σ = 4 in every second pixel,
    # and some more lost as the window's means are interpolated; 1300 values tell it to 4 %.
    assert np.sqrt(np.mean(rough**2)) == pytest.approx(0.3, rel=0.08)


def test_where_there_is_no_depth_the_roughness_is_that_of_the_best_frames():
    positions = 10 * np.arange(9.0)
    index = np.random.default_rng(1).integers(0, 9, (80, 80)).astype(np.uint16)
    unknown = np.full(index.shape, np.nan, np.float32)
    known = positions[index].astype(np.float32)
    np.testing.assert_allclose(
        _depth._roughness(unknown, positions, index), _depth._roughness(known, positions, index)
    )
