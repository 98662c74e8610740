"""The Gaussian sum, its fit and the dimple read off it, against scipy and Table 5.5."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import curve_fit

from compendium import thesis
from microlib.embryo import GaussianSum, dimple_geometry, fit_gaussians


@pytest.fixture(scope="module")
def printed() -> GaussianSum:
    return thesis.outline_curve()


def test_printed_dimple(printed: GaussianSum) -> None:
    dimple = dimple_geometry(printed, pixel_size=thesis.EMBRYO_PIXEL)
    # Values of the decoded table, recomputed independently to two decimals.
    assert dimple.rim == pytest.approx((131.07, 94.15), abs=0.005)
    assert dimple.bottom == pytest.approx((194.69, 62.93), abs=0.005)
    assert dimple.dimple_radius == pytest.approx(
        thesis.EMBRYO_PIXEL * (dimple.bottom[0] - dimple.rim[0])
    )
    assert dimple.dimple_depth == pytest.approx(
        thesis.EMBRYO_PIXEL * (dimple.rim[1] - dimple.bottom[1])
    )


def test_the_rim_is_the_nearest_maximum_in_the_upper_half() -> None:
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


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: fit_gaussians(np.arange(23.0), np.arange(23.0)), "x must hold at least 24 points"),
        (lambda: fit_gaussians([1, 2, 3], [1, 2], terms=1), "x and y must have the same length"),
        (lambda: fit_gaussians([1, np.nan, 3], [1, 2, 3], terms=1), "x must be finite"),
        (lambda: fit_gaussians([2, 2, 2], [1, 2, 3], terms=1), "x must have an extent"),
        (lambda: fit_gaussians([1, 2, 3], [1, 2, 3], terms=0), "terms must be a whole number"),
        (lambda: GaussianSum([1], [1, 2], [1], domain=(0, 1)), "amplitudes and centers must have"),
        (lambda: GaussianSum([1], [1], [0], domain=(0, 1)), "widths must be positive"),
        (lambda: GaussianSum([1], [1], [1], domain=(1, 1)), "domain must run from"),
        (
            lambda: dimple_geometry(GaussianSum([1], [1], [1], domain=(0, 1)), pixel_size=0),
            "pixel_size must be positive",
        ),
        (
            lambda: dimple_geometry(GaussianSum([9], [0], [5], domain=(-9, 9)), pixel_size=1),
            "curve must have a minimum between two maxima",
        ),
    ],
)
def test_impossible_input_is_refused_by_name(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
