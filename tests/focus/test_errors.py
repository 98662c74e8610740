"""What is stated of the error of a smoothed depth, part by part."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from microlib.focus._errors import (
    _edge_variance,
    _halo_variance,
    _never_falling,
    _noise_variance,
    _pull_variance,
    smooth_variance,
)
from microlib.focus._questions import alone

SHAPE = (160, 160)


def differences(deviation, seed=0):
    """Half differences of that deviation, with a grain of 3 px."""
    rough = gaussian_filter(np.random.default_rng(seed).standard_normal(SHAPE), 3.0)
    return (deviation * rough / rough.std()).astype(np.float32)


def textured(weight, seed=9):
    """Weights that vary by a tenth from place to place."""
    rough = gaussian_filter(np.random.default_rng(seed).standard_normal(SHAPE), 3.0)
    return (weight * (1 + 0.1 * rough / rough.std())).astype(np.float32)


def test_noise_follows_the_texture():
    """A third of the image has a quarter of the weight and twice the noise."""
    faint = np.arange(SHAPE[1]) > 106
    weight = textured(np.where(faint, 0.25, 1.0))
    deviation = np.broadcast_to(np.where(faint, 0.2, 0.1), SHAPE)
    variance = np.mean(
        [
            alone(_noise_variance(differences(deviation, seed), weight, np.ones(SHAPE, bool)))
            for seed in range(4)
        ],
        axis=0,
    )
    # 4 times some 400 independent differences: a few percent of either variance.
    assert variance[:, :90].mean() == pytest.approx(0.6 * 0.1**2, rel=0.1)
    assert variance[:, 120:].mean() == pytest.approx(0.6 * 0.2**2, rel=0.1)


def test_a_few_wrong_pixels_do_not_pass_for_noise():
    plain = differences(0.1)
    weight, known = textured(1.0), np.ones(SHAPE, bool)
    spoiled = plain.copy()
    spoiled[40:60, 40:80] = 1.5  # 3 % of the image, seven times its mean square
    before, after = (alone(_noise_variance(d, weight, known)).mean() for d in (plain, spoiled))
    assert after == pytest.approx(before, rel=0.1)


def test_noise_does_not_fall_with_less_texture():
    weight = textured(np.where(np.arange(SHAPE[1]) < 80, 1.0, 0.25))
    deviation = np.broadcast_to(np.where(np.arange(SHAPE[1]) < 80, 0.3, 0.1), SHAPE)
    variance = alone(_noise_variance(differences(deviation), weight, np.ones(SHAPE, bool)))
    assert variance[:, 120:].mean() >= 0.99 * variance[:, :40].mean()


def test_what_falls_is_put_to_the_mean():
    np.testing.assert_allclose(
        _never_falling(np.array([1.0, 3, 2, 4, 0])), [1, 2.25, 2.25, 2.25, 2.25]
    )
    np.testing.assert_allclose(_never_falling(np.array([3.0, 2, 1])), [2, 2, 2])
    np.testing.assert_allclose(_never_falling(np.array([1.0, 2, 3])), [1, 2, 3])


def test_level_depths_are_pulled_towards_frames_and_sloping_ones_shifted():
    error = [
        np.sqrt(_pull_variance(np.tile(slope * np.arange(SHAPE[1]) + 0.3, (SHAPE[0], 1))))
        for slope in (0.0, 0.2, 5.0)
    ]
    middle = [part[20:-20, 20:-20].max() for part in error]
    expected = [np.hypot(0.016, 0.0065), np.hypot(0.03, 0.0065), np.hypot(0.045, 0.0065)]
    np.testing.assert_allclose(middle, expected, rtol=0.01)


@pytest.mark.parametrize("height", [0.7, 6.0])
def test_a_step_has_the_error_of_its_height(height):
    base = np.tile(np.where(np.arange(60) < 30, 2.0, 2.0 + height), (50, 1))
    base[20, 5] = np.nan  # which is no step
    error = np.sqrt(_edge_variance(base)[10]) / height
    np.testing.assert_allclose(error[[29, 30]], np.hypot(0.4, 0.09), rtol=0.01)
    np.testing.assert_allclose(error[[26, 28, 31, 33]], 0.09, rtol=0.05)
    assert 0.003 < error[24] < 0.02
    assert error[5] < 0.002
    assert not _edge_variance(np.tile(0.7 * np.arange(60), (50, 1)))[:, 5:-5].any()  # a slope


def test_around_halos_the_error_is_a_share_of_the_range_of_depths():
    base = np.tile(np.where(np.arange(120) < 60, 2.0, 8.0), (120, 1))
    base[:, 100:] = np.nan
    halo = np.zeros(base.shape, bool)
    halo[40:80, 40:60] = True
    variance = _halo_variance(base, halo)
    # Half of what is around the border of the halo is halo; the step is within 21 and 11 px.
    assert variance[60, 59] == pytest.approx((0.006 + 0.0125) * 0.5 * 36, rel=0.15)
    assert variance[60, 20] < 1e-3
    assert not _halo_variance(base, np.zeros_like(halo)).any()
    assert np.isfinite(variance).all()


def test_where_nothing_is_known_there_is_no_error():
    nothing, zero = np.full(SHAPE, np.nan), np.zeros(SHAPE, np.float32)
    assert not alone(smooth_variance(nothing, zero, zero, np.ones(SHAPE, bool))).any()
    one = nothing.copy()
    one[30, 30] = 4.0
    variance = alone(smooth_variance(one, zero, zero, np.isnan(one)))
    assert np.isfinite(variance).all()
    assert variance[30, 30] > 0
