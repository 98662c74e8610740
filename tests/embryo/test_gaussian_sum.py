"""The Gaussian sum and its fit, against scipy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import curve_fit

from microlib.embryo import GaussianSum, dimple_geometry, fit_gaussians


def test_rim_is_nearest_maximum_in_upper_half() -> None:
    # The hill at 100 px is the rim if it is higher than half the dimple, else the one behind it is.
    for height, rim in ((60.0, 100.0), (20.0, 50.0)):
        sizes = [80.0, height, 70.0, 70.0], [50.0, 100.0, 190.0, 350.0], [12.0, 12.0, 20.0, 20.0]
        curve = GaussianSum(*sizes, domain=(20, 330))  # lowest near 270, before a hill beyond it
        mirrored = GaussianSum(
            curve.amplitudes, -curve.centers, curve.widths, domain=(-330.0, -20.0)
        )
        found = dimple_geometry(curve, pixel_size=0.5)
        assert found.rim[0] == pytest.approx(rim, abs=1)
        way = 0.5 * np.subtract(found.rim, found.bottom)  # µm
        assert (found.rim_radius, found.dimple_depth) == pytest.approx((-way[0], way[1]))
        assert found.bottom[1] == pytest.approx(curve(np.linspace(100, 190, 999)).min(), abs=1e-3)
        other = dimple_geometry(mirrored, pixel_size=0.5, rim="right")
        assert other.rim_radius == pytest.approx(found.rim_radius, rel=1e-9)
        assert other.rim[0] == pytest.approx(-found.rim[0])


def test_fit_equals_that_of_curve_fit() -> None:
    """Points in random order; a narrow hill on a broad one."""
    x = np.random.default_rng(2).permutation(np.linspace(0, 120, 150))
    hills = np.array([[40.0, 20.0, 20.0], [30.0, 50.0, 100.0], [30.0, 12.0, 14.0]])

    def model(x, *parameters):
        return GaussianSum(*np.reshape(parameters, (3, 3)), domain=(0, 120))(x)

    y = model(x, *hills.ravel()) + np.random.default_rng(3).normal(0, 0.5, x.size)
    wanted, _ = curve_fit(model, x, y, p0=hills.ravel(), xtol=1e-12)
    fit = fit_gaussians(x, y, terms=3)
    found = np.concatenate([fit.amplitudes, fit.centers, fit.widths])
    # The search stops at relative changes of 1e-8 of its sum of squares.
    np.testing.assert_allclose(found, wanted, rtol=1e-4)


@settings(deadline=None, max_examples=20)
@given(x=st.floats(60.0, 260.0))
def test_derivatives_equal_differences(x: float) -> None:
    curve = GaussianSum(
        [89.4, 93.1, 9.0, 28.6],
        [129.5, 243.3, 203.7, 213.3],
        [44.3, 41.7, 6.9, 14.6],
        domain=(50, 265),
    )
    # The error of central differences is step² times a third derivative of order one.
    step = 1e-4
    for derivative, value in ((curve.slope, curve), (curve.second_derivative, curve.slope)):
        by_value = (value(x + step) - value(x - step)) / (2 * step)
        assert derivative(x) == pytest.approx(by_value, abs=1e-6)


def test_fit_does_not_depend_on_the_unit_of_the_outline():
    """A fit with eight terms, in px and in a unit of a thousand of them, ends at the same curve."""
    x = np.linspace(-40.0, 260.0, 150)
    dimple = -45 * np.exp(-(((x - 110) / 45) ** 2)) + 12 * np.exp(-(((x - 220) / 70) ** 2))
    y = 60 + dimple + np.random.default_rng(3).normal(0, 0.4, x.size)
    reference, scaled = fit_gaussians(x, y), fit_gaussians(x / 1000, y / 1000)
    np.testing.assert_allclose(1000 * scaled(x / 1000), reference(x), atol=1e-3)
    assert (len(reference.centers), reference.domain) == (8, (-40.0, 260.0))


def test_matrices_of_a_fit_to_many_points_are_too_small_for_threads(monkeypatch):
    """OpenBLAS shares matrices of more than 9216 numbers among threads that wait for each other."""
    sizes, qr = [], np.linalg.qr
    monkeypatch.setattr(np.linalg, "qr", lambda a, mode: sizes.append(a.size) or qr(a, mode))
    x = np.linspace(0, 300, 1500)
    fit = fit_gaussians(x, np.exp(-(((x - 100) / 90) ** 2)))
    assert max(sizes) < 9216
    np.testing.assert_allclose(fit(x), np.exp(-(((x - 100) / 90) ** 2)), atol=1e-3)
