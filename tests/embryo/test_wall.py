"""The wall of a profile against scipy's curve_fit, and profiles without a visible wall."""

import numpy as np
import pytest
from scipy.optimize import curve_fit
from scipy.special import ndtr

from microlib.embryo._wall import locate_wall

D = np.arange(-6.0, 6.01)


def wall(d, shift, ground, step, bump, width):
    scaled = (d - shift) / width
    return ground + step * ndtr(scaled) + bump * np.exp(-(scaled**2) / 2)


def test_position_and_std_match_curve_fit_on_noisy_profiles():
    rng = np.random.default_rng(2)
    profiles = np.array([wall(D, s, 190.0, -27.0, -35.0, 1.05) for s in rng.uniform(-1, 1, 400)])
    profiles += rng.normal(0.0, 2.0, profiles.shape)
    found = locate_wall(profiles, D, weights=np.ones_like(profiles))
    start = [0.0, 190.0, -27.0, -35.0]
    for k in range(5):
        known = {"p0": start, "sigma": 2.0, "absolute_sigma": True, "xtol": 1e-12}
        fit, covariance = curve_fit(lambda x, *p: wall(x, *p, found.blur), D, profiles[k], **known)
        assert found.position[k] == pytest.approx(fit[0], abs=1e-4)
        # The noise is estimated to 1.2 %, from 400 profiles of nine degrees of freedom each.
        assert found.uncertainty[k] == pytest.approx(covariance[0, 0] ** 0.5, rel=0.04)


def test_position_is_nan_where_wall_is_hidden_or_out_of_range():
    profiles = np.array([wall(D, s, 190.0, -27.0, -35.0, 1.05) for s in (0, 0.5, -2.6, 0.4, 2.6)])
    weights = np.ones_like(profiles)
    weights[1, D < 1] = 0  # only the inner side of the wall is visible
    profiles[3, D < -2], weights[3, D < -2] = 40.0, 0  # a probe in front of the wall
    found = locate_wall(profiles, D, weights=weights)
    np.testing.assert_allclose(found.position, [0, np.nan, np.nan, 0.4, np.nan], atol=0.02)
    np.testing.assert_array_equal(np.isnan(found.uncertainty), np.isnan(found.position))
