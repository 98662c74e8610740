"""The Gaussian sum and its fit, against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import curve_fit

from microlib.embryo import GaussianSum, _gaussian_sum, dimple_geometry, fit_gaussians


def test_rim_is_nearest_maximum_in_upper_half() -> None:
    # Behind a hill that is higher than half the dimple, or not, is the highest one.
    for height, rim in ((60.0, 100.0), (20.0, 50.0)):
        curve = GaussianSum(
            [80.0, height, 70.0], [50.0, 100.0, 190.0], [12.0, 12.0, 20.0], domain=(20, 220)
        )
        mirrored = GaussianSum(
            curve.amplitudes, -curve.centers, curve.widths, domain=(-220.0, -20.0)
        )
        found = dimple_geometry(curve, pixel_size=2.0)
        assert found.rim[0] == pytest.approx(rim, abs=1)
        other = dimple_geometry(mirrored, pixel_size=2.0, rim="right")
        assert other.dimple_radius == pytest.approx(found.dimple_radius, rel=1e-9)
        assert other.rim[0] == pytest.approx(-found.rim[0])


def test_fit_equals_curve_fit_on_noisy_data() -> None:
    rng = np.random.default_rng(3)
    x = np.linspace(0, 120, 150)
    truth = GaussianSum([40.0, 35.0], [30.0, 85.0], [20.0, 24.0], domain=(0, 120))
    y = truth(x) + rng.normal(0, 0.5, x.size)

    def model(x, a1, a2, b1, b2, c1, c2):
        return GaussianSum([a1, a2], [b1, b2], [c1, c2], domain=(0, 120))(x)

    want, _ = curve_fit(model, x, y, p0=[30, 30, 25, 90, 15, 15])
    fit = fit_gaussians(x, y, terms=2)
    got = np.concatenate([fit.amplitudes, fit.centers, fit.widths])
    np.testing.assert_allclose(got, want, rtol=1e-4)  # both stop at relative changes of 1e-8


def test_order_of_start_terms_changes_nothing(monkeypatch) -> None:
    x = np.linspace(0, 120, 90)
    truth = GaussianSum([40.0, 5.0], [30.0, 85.0], [20.0, 9.0], domain=(0, 120))
    y = truth(x) + np.random.default_rng(4).normal(0, 0.5, x.size)
    plain, starts = fit_gaussians(x, y, terms=2), _gaussian_sum._starts

    def exchanged(*given):
        return (each.reshape(3, 2)[:, ::-1].ravel() for each in starts(*given))

    monkeypatch.setattr(_gaussian_sum, "_starts", exchanged)
    other = fit_gaussians(x, y, terms=2)
    np.testing.assert_allclose(other.centers, plain.centers, rtol=1e-5)
    # Both searches stop at relative changes of 1e-8; the errors of the two hills differ by ten.
    np.testing.assert_allclose(other.covariance, plain.covariance, rtol=1e-3, atol=1e-7)


@settings(deadline=None, max_examples=20)
@given(x=st.floats(60.0, 260.0))
def test_derivatives_equal_differences(x: float) -> None:
    curve = GaussianSum(
        [89.4, 93.1, 9.0, 28.6],
        [129.5, 243.3, 203.7, 213.3],
        [44.3, 41.7, 6.9, 14.6],
        domain=(50, 265),
    )
    step = 1e-4
    # Second-order differences: their error is step² times a third derivative of order one.
    assert curve.slope(x) == pytest.approx(
        (curve(x + step) - curve(x - step)) / (2 * step), abs=1e-6
    )
    assert curve.second_derivative(x) == pytest.approx(
        (curve.slope(x + step) - curve.slope(x - step)) / (2 * step), abs=1e-6
    )
    parameters = np.concatenate([curve.amplitudes, curve.centers, curve.widths])
    for k in range(12):
        moved = []
        for sign in (1, -1):
            p = parameters.copy()
            p[k] += sign * step
            moved.append(GaussianSum(*p.reshape(3, 4), domain=curve.domain))
        by_value = (moved[0](x) - moved[1](x)) / (2 * step)
        assert curve.gradient(x)[k] == pytest.approx(by_value, abs=1e-6)
