"""The three-point peak against (3.13), and the parts of the default measure one by one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microlib.focus import three_point_peak
from microlib.focus.multiscale import (
    _fit,
    _peaks,
    _relief,
    _rules,
    _settings,
    _tiles,
)
from tests.scenes.focus import gaussian_blur, inner, rms


@settings(deadline=None, max_examples=100)
@given(
    center=st.floats(1.0, 5.0),
    width=st.floats(0.5, 3.0),
    gaps=st.lists(st.floats(0.5, 1.5), min_size=6, max_size=6),
    falling=st.booleans(),
)
def test_peak_of_gaussian_profile_is_exact(center, width, gaps, falling):
    """Both fits are exact on a Gaussian, at uneven and falling positions too."""
    positions = np.concatenate([[0.0], np.cumsum(gaps)])
    if falling:
        positions = positions[::-1].copy()
    profile = 1000 * np.exp(-((positions - center) ** 2) / (2 * width**2))
    best = int(profile.argmax())
    if not 0 < best < len(positions) - 1:
        return
    index = np.full((1, 1), best, np.uint8)
    three = profile[best - 1 : best + 2, None, None].astype(np.float32)
    # float32 measures: 6e-8 relative, over the curvature 0.25 / 3².
    assert three_point_peak(three, index, positions)[0, 0] == pytest.approx(center, abs=1e-4)
    frames = np.arange(best - 3, best + 4)
    seven = np.where((frames >= 0) & (frames <= 6), profile[np.clip(frames, 0, 6)], 0)
    window = seven[:, None, None].astype(np.float32)
    steps = np.abs(positions - positions[0])
    found = _fit.fit_peaks(window, index, steps)[0][0, 0]
    # A fit divides by the third and fourth moments of the frames that have a weight.
    assert found == pytest.approx(abs(center - positions[0]), abs=5e-4)


def test_peak_at_an_end_must_exceed_its_neighbor():
    window = np.array([[0, 5.0, 5], [5, 5, 0], [0, 5, 4], [4, 5, 0], [5, 5, 5]]).T[..., None]
    index = np.array([0, 4, 0, 4, 2])[:, None]
    found = three_point_peak(window, index, np.array([7.0, 8, 10, 13, 17]))
    np.testing.assert_array_equal(found[:, 0], [np.nan, np.nan, 7, 17, np.nan])


def documented_fit(profile, steps, best, reach, power, center):
    """The fit pixel by pixel: np.polyfit with the documented weights, twice."""
    count = len(steps)
    frames = np.arange(max(best - reach, 0), min(best + reach, count - 1) + 1)
    t, y = steps[frames] - steps[best], profile[frames]
    far = min(best, count - 1 - best, reach) or 2
    near, wide = (
        max(abs(steps[k] - steps[best]) for k in (best - n, best + n) if 0 <= k < count)
        for n in (1, far)
    )
    half = wide + near * (0.5 if far > 1 else 1.0)
    for _ in range(2):
        weight = y**power * np.maximum(1 - ((t - center) / half) ** 2, 0) ** 2
        a, b, _ = np.polyfit(t, np.log(y), 2, w=np.sqrt(weight))
        center = -b / (2 * a)
    return steps[best] + center


def test_fit_peaks_equals_polyfit_with_documented_weights():
    """On profiles with long tails, on which other weights give other depths."""
    rng = np.random.default_rng(0)
    steps = np.cumsum(rng.uniform(0.8, 1.2, 13))
    steps -= steps[0]
    for center in rng.uniform(3.5, 8.5, 20):
        profile = 1 / (1 + ((steps - center) / 1.7) ** 2) + 0.03 * rng.random(13)
        best = int(profile.argmax())
        window = profile[best - 3 : best + 4, None, None].astype(np.float32)
        for power, near in ((0.75, None), (1.0, np.full((1, 1), center + 0.3, np.float32))):
            index, start = np.full((1, 1), best), 0.0 if near is None else near.item() - steps[best]
            found = _fit.fit_peaks(window, index, steps, near=near, within=1.5)[0].item()
            wanted = documented_fit(profile, steps, best, 3, power, start)
            assert found == pytest.approx(wanted, abs=1e-4)


# --- The noise of a frame, and the axis ----------------------------------------------------------


def test_noise_level_is_that_of_untextured_ground():
    rng = np.random.default_rng(4)
    for sigma in (2.0, 5.0):
        frame = 128 + sigma * rng.standard_normal((200, 200))
        frame[:, :150] += 40 * rng.standard_normal((200, 150))
        seen = _tiles.sample_tiles(np.clip(np.rint(frame), 0, 255).astype(np.uint8))
        # The quietest twentieth lies two scatters of a 3 px window below the mean.
        assert 0.7 * sigma < _tiles.noise_level(seen) < 1.1 * sigma
    assert _tiles.noise_level(_tiles.sample_tiles(np.zeros((32, 32), np.float32))) > 0


# --- Relief ------------------------------------------------------------------------------------


def test_find_relief_keeps_what_both_directions_show_and_drops_what_one_shows():
    rng, shape, settings = np.random.default_rng(6), (120, 150), _settings.FocusSettings()
    y, x = np.indices(shape, np.float32)
    waves, squared = 0.6 * np.sin(x / 2) * np.sin(y / 2.5), 1 / 2**2 + 1 / 2.5**2
    # Smooth as the noise of a measure is; of a standard deviation of 1 step.
    rough = [gaussian_blur(np.float32(rng.standard_normal(shape)), 1.0) for _ in range(2)]
    noise = np.array([image / image.std() for image in rough])
    found, half_difference = _relief.find_relief(*(0.03 * noise + waves), 0 * x + 1, settings)
    # The coarsest mean of 2.8 px keeps a share of the waves, and the rest is divided by an MTF.
    gain = np.exp(settings.mtf_correction * squared) * (1 - np.exp(-squared * 2.8**2 / 2))
    assert np.polyfit(waves.ravel(), found.ravel(), 1)[0] == pytest.approx(gain, rel=0.03)
    coarse = gaussian_blur(0.03 * (noise[0] - noise[1]) / 2, 2.8)
    assert rms(inner(half_difference - coarse)) < 0.15 * rms(coarse)  # two boxes for a Gaussian
    noisy, _ = _relief.find_relief(*(0.3 * noise + waves), 0 * x + 1, settings)
    assert rms(noisy - waves) < 0.85 * rms(0.3 * noise.mean(axis=0))
    flat, _ = _relief.find_relief(*(0.3 * noise), 0 * x + 1, settings)
    assert rms(flat) < 0.01


# --- Rules that reject a peak --------------------------------------------------------------------


def test_relief_is_finite_beside_ground_without_weight():
    """Sums that run along a row leave a rounding residue there, by which nothing may be divided."""
    rng, weight = np.random.default_rng(7), np.zeros((120, 160), np.float32)
    weight[:, :60] = rng.uniform(0.01, 1, (120, 60))
    for _ in range(10):
        along, down = (
            (rng.normal(0, 1, weight.shape) * 10.0 ** rng.uniform(-9, 0, weight.shape)).astype("f4")
            for _ in range(2)
        )
        found = _relief.find_relief(along, down, weight, _settings.FocusSettings())
        assert np.abs(found).max() < 10


def test_rules_reject_doubted_faint_small_and_isolated_depths_only():
    """Pieces of 14 px, half a circle of 3 px, and depths where most of such a circle has none.

    Measures disagree in three places, of which the wide depth confirms one.
    """
    depth = np.full((60, 72), 5.0, np.float32)
    small, large, alone = np.s_[10:13, 10:14], np.s_[30:35, 10:15], np.s_[20:24, 50:54]
    halo, unknown, off, confirmed = (np.s_[42:47, k : k + 5] for k in (2, 10, 18, 26))
    depth[small] = depth[large] = depth[halo] = 8.0
    depth[:, 36:] = np.nan
    depth[alone] = 5.0
    zero = np.zeros_like(depth)
    weight, disagreement, low, high = zero + 1, zero.copy(), zero.copy(), zero + 9
    weight[halo], low[unknown], low[off] = 0.05, np.nan, 7.0
    disagreement[unknown] = disagreement[off] = disagreement[confirmed] = 1.0
    no, best = zero > 0, zero.astype(np.uint16)
    peaks = _peaks.Peaks(depth, weight, zero, disagreement, no, no, low, high, zero, best, 5)
    for rule in _rules.RULES:
        peaks = peaks.without(rule(peaks, _settings.FocusSettings()))
    for rejected in (small, alone, halo, unknown, off):
        depth[rejected] = np.nan
    np.testing.assert_array_equal(peaks.depth, depth)
