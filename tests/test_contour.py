"""Gaussian sums and the dimples read off them: printed coefficients, derivatives, uncertainty."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from microlib.contour import GaussianSum, dimple_geometry, fit_gaussians

# Table 5.5.
AMPLITUDES = [89.38, 93.14, 9.011, 28.6, 44.78, 17.99, 40.7, 17.26]
CENTERS = [129.5, 243.3, 203.7, 213.3, 77.26, 182.5, 169.9, 48.01]
WIDTHS = [44.25, 41.71, 6.922, 14.61, 30.84, 13.58, 23.55, 18.9]


@pytest.fixture(scope="module")
def printed() -> GaussianSum:
    return GaussianSum(AMPLITUDES, CENTERS, WIDTHS, domain=(50.0, 265.0))


def dimpled(x: np.ndarray) -> np.ndarray:
    """An outline with a dimple: two broad hills."""
    return 60 * np.exp(-(((x - 60) / 40) ** 2)) + 62 * np.exp(-(((x - 150) / 42) ** 2))


def test_printed_coefficients_have_three_maxima(printed):
    maxima, minima = printed.extrema()
    assert len(maxima) == 3
    assert len(minima) == 2
    # The roots polished by an independent search on the curve itself; 1e-5 px is its own end.
    for x, sign in [*((m, -1) for m in maxima), *((m, 1) for m in minima)]:
        peer = minimize_scalar(
            lambda t, s=sign: s * printed(t), bounds=(x - 4, x + 4), method="bounded"
        )
        assert x == pytest.approx(peer.x, abs=1e-4)


def test_printed_dimple(printed):
    dimple = dimple_geometry(printed, pixel_size=4.65 / 1.2)
    # Tolerances: what the printed rounding of 24 coefficients leaves open.
    assert dimple.rim == pytest.approx((130.98, 94.1202), abs=0.35)
    assert dimple.bottom == pytest.approx((194.71, 62.8384), abs=0.25)
    assert np.isnan(dimple.covariance).all()


@settings(deadline=None, max_examples=20)
@given(x=st.floats(60.0, 260.0))
def test_derivatives_equal_differences(x):
    curve = GaussianSum(AMPLITUDES, CENTERS, WIDTHS, domain=(50.0, 265.0))
    step = 1e-4
    # Second-order differences: their error is step² times a third derivative of order one.
    assert curve.slope(x) == pytest.approx(
        (curve(x + step) - curve(x - step)) / (2 * step), abs=1e-6
    )
    assert curve.bend(x) == pytest.approx(
        (curve.slope(x + step) - curve.slope(x - step)) / (2 * step), abs=1e-6
    )
    parameters = np.concatenate([AMPLITUDES, CENTERS, WIDTHS])
    for k in (0, 2, 9, 11, 18, 22):
        moved = []
        for sign in (1, -1):
            p = parameters.copy()
            p[k] += sign * step
            moved.append(GaussianSum(*p.reshape(3, 8), domain=curve.domain))
        by_value = (moved[0](x) - moved[1](x)) / (2 * step)
        by_slope = (moved[0].slope(x) - moved[1].slope(x)) / (2 * step)
        assert curve.gradient(x)[k] == pytest.approx(by_value, abs=1e-6)
        assert curve.slope_gradient(x)[k] == pytest.approx(by_slope, abs=1e-6)


def test_fit_finds_the_printed_curve_again(printed):
    x = np.arange(30.0, 290.0)
    fit = fit_gaussians(x, printed(x))
    # Eight terms can imitate each other: the curve is what comes back, to a hundredth of a px.
    assert np.abs(fit(x) - printed(x)).max() < 0.05
    dimple = dimple_geometry(fit, pixel_size=1.0)
    assert dimple.bottom == pytest.approx((194.685, 62.926), abs=0.05)


def test_fit_finds_known_terms_from_its_own_start():
    x = np.linspace(0, 200, 120)
    truth = GaussianSum(
        [60.0, 62.0, -12.0], [60.0, 150.0, 105.0], [40.0, 42.0, 9.0], domain=(0, 200)
    )
    fit = fit_gaussians(x, truth(x), terms=3)
    order = np.argsort(truth.centers)
    np.testing.assert_allclose(fit.centers, truth.centers[order], atol=1e-3)
    np.testing.assert_allclose(fit.amplitudes, truth.amplitudes[order], atol=1e-3)


def test_covariance_of_the_dimple_is_what_noise_does():
    rng = np.random.default_rng(0)
    x = np.arange(0.0, 210.0)
    found, stated = [], []
    for _ in range(120):
        fit = fit_gaussians(x, dimpled(x) + rng.normal(0.0, 0.3, x.size), terms=2)
        dimple = dimple_geometry(fit, pixel_size=2.0)
        found.append([dimple.dimple_radius, dimple.dimple_depth])
        stated.append(np.sqrt(np.diag(dimple.covariance)))
    # 120 draws know a standard deviation to 6.5 %: four of those.
    ratio = np.std(found, axis=0, ddof=1) / np.mean(stated, axis=0)
    np.testing.assert_allclose(ratio, 1.0, atol=0.26)
    truth = dimple_geometry(
        GaussianSum([60.0, 62.0], [60.0, 150.0], [40.0, 42.0], domain=(0, 210)), pixel_size=2.0
    )
    off = np.mean(found, axis=0) - [truth.dimple_radius, truth.dimple_depth]
    assert (np.abs(off) < 4 * np.mean(stated, axis=0) / np.sqrt(120)).all()


def test_ripples_at_the_bottom_are_not_the_rim():
    curve = GaussianSum(
        [60.0, 60.0, 1.5], [60.0, 160.0, 108.0], [38.0, 38.0, 3.0], domain=(20.0, 200.0)
    )
    maxima, _ = curve.extrema()
    assert len(maxima) == 3
    assert dimple_geometry(curve, pixel_size=1.0).rim[0] == pytest.approx(60.0, abs=1.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: fit_gaussians(np.arange(24.0), np.ones(24)), "more than 24 points"),
        (lambda: fit_gaussians(np.ones(40), np.ones(40)), "x must have an extent"),
        (lambda: fit_gaussians(np.arange(40.0), np.ones(39)), "same length"),
        (lambda: fit_gaussians(np.arange(40.0), np.ones(40), terms=0), "terms must be"),
        (lambda: GaussianSum([1.0], [0.0, 1.0], [1.0], domain=(0, 1)), "same length"),
        (lambda: GaussianSum([1.0], [0.0], [0.0], domain=(0, 1)), "widths must be positive"),
        (lambda: GaussianSum([1.0], [0.0], [1.0], domain=(1, 0)), "domain must run"),
        (
            lambda: GaussianSum([1.0], [0.0], [1.0], domain=(0, 1), covariance=np.eye(2)),
            "covariance must have shape",
        ),
        (
            lambda: dimple_geometry(GaussianSum([1.0], [0.0], [1.0], domain=(-1, 1)), pixel_size=1),
            r"a minimum between two maxima \(a dimple\)",
        ),
        (
            lambda: dimple_geometry(GaussianSum([1.0], [0.0], [1.0], domain=(-1, 1)), pixel_size=0),
            "pixel_size must be positive",
        ),
    ],
)
def test_refusals(call, message):
    with pytest.raises(ValueError, match=message):
        call()
