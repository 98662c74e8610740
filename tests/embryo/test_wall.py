"""The wall of a profile against truth, against scipy's curve_fit, and its stated uncertainty."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import curve_fit
from scipy.special import ndtr

from microlib.embryo._wall import locate_wall

D = np.arange(-6.0, 6.01, 0.5)


def wall(d, shift, ground, step, bump, width):
    scaled = (d - shift) / width
    return ground + step * ndtr(scaled) + bump * np.exp(-(scaled**2) / 2)


@settings(deadline=None, max_examples=25)
@given(
    shifts=st.lists(st.floats(-2.4, 2.4), min_size=5, max_size=20),
    width=st.floats(0.7, 1.8),
    step=st.floats(-60, 60),
)
def test_position_is_exact_for_exact_profiles(shifts, width, step):
    profiles = np.array([wall(D, s, 200.0, step, -40.0, width) for s in shifts])
    found = locate_wall(profiles, D, weights=np.ones_like(profiles))
    # A third of what noise of 2/255 moves a point by.
    np.testing.assert_allclose(found.position, shifts, atol=0.02)
    assert found.blur == pytest.approx(width, abs=0.02)


def test_position_matches_curve_fit_and_std_matches_scatter():
    rng = np.random.default_rng(2)
    shifts = rng.uniform(-1.0, 1.0, 400)
    # Independent noise wants samples one px apart: closer ones share what the sensor saw.
    d = np.arange(-6.0, 6.01)
    profiles = np.array([wall(d, s, 190.0, -27.0, -35.0, 1.05) for s in shifts])
    profiles += rng.normal(0.0, 2.0, profiles.shape)
    found = locate_wall(profiles, d, weights=np.ones_like(profiles))
    pulls = (found.position - shifts) / found.std
    assert abs(pulls.mean()) < 4 / 20  # four standard errors of 400 pulls
    assert pulls.std() == pytest.approx(1.0, abs=0.15)  # four standard errors of their spread
    for k in range(5):
        start = [0.0, 190.0, -27.0, -35.0]
        fit, _ = curve_fit(
            lambda x, *p: wall(x, *p, found.blur), d, profiles[k], p0=start, xtol=1e-12
        )
        assert found.position[k] == pytest.approx(fit[0], abs=1e-4)


def test_samples_of_zero_weight_are_not_used():
    profiles = np.array([wall(D, 0.4, 190.0, -27.0, -35.0, 1.05)] * 3)
    spoiled = profiles.copy()
    spoiled[:, D < -2] = 40.0
    weights = np.ones_like(profiles)
    weights[:, D < -2] = 0
    np.testing.assert_allclose(locate_wall(spoiled, D, weights=weights).position, 0.4, atol=0.02)
    off = locate_wall(spoiled, D, weights=np.ones_like(profiles)).position
    assert not np.allclose(off, 0.4, atol=0.1)


def test_position_is_nan_without_wall():
    profiles = np.array([wall(D, s, 190.0, -27.0, -35.0, 1.05) for s in (0.0, 0.5, 4.5)])
    weights = np.ones_like(profiles)
    weights[1, D < 1.0] = 0  # only its inner side is seen
    found = locate_wall(profiles, D, weights=weights)
    assert np.isfinite(found.position).tolist() == [True, False, False]
    with pytest.raises(ValueError, match="at least 6 samples"):
        locate_wall(profiles, D, weights=np.zeros_like(profiles))


def test_wall_beyond_search_range_is_not_found():
    far = np.array([wall(D, s, 190.0, -27.0, -35.0, 1.1) for s in (-2.6, 0.0, 2.6)])
    found = locate_wall(far, D, weights=np.ones_like(far))
    assert np.isfinite(found.position).tolist() == [False, True, False]
    np.testing.assert_array_equal(np.isnan(found.std), np.isnan(found.position))
