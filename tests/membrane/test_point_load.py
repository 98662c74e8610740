"""The point-load model against sympy, scipy's quadrature, mpmath and its own laws."""

from __future__ import annotations

import warnings

import mpmath
import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from microlib.membrane import (
    SmallSlopeWarning,
    dimple_depth,
    dimple_profile,
    elastic_modulus,
    finite_slope_modulus,
    indentation_force,
    mean_strain,
    membrane_stress,
    modulus_samples,
    modulus_std,
)

# Most dimples here are steeper than the model is good for, which its algebra does not mind.
pytestmark = [
    pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning"),
    pytest.mark.filterwarnings("ignore:a modulus of"),
]

FILM = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.4}
VALUES = {"force": 50.0, "dimple_radius": 250.0, "dimple_depth": 40.0, **FILM}

lengths = st.floats(20.0, 500.0)
ratios = st.floats(0.01, 0.99)


def test_printed_profile_and_force_follow_from_the_balance() -> None:
    """(4.2), (4.7) and (5.2) derived from (4.1), (4.5) and (4.6), symbolically."""
    r, a, force, h, stress, nu, depth = sp.symbols("r a F h s nu w", positive=True)
    zeta = sp.Symbol("zeta", positive=True)
    slope = force / (2 * sp.pi * stress * h) * (1 / r - r / a**2)
    balance = sp.pi * r**2 * force / (sp.pi * a**2) + stress * slope * 2 * sp.pi * r * h
    assert sp.simplify(balance - force) == 0  # (4.1) with p = F/(πa²)
    profile = sp.integrate(slope, (r, r, a))
    printed = -force / (4 * sp.pi * stress * h) * (1 - (r / a) ** 2 + sp.log((r / a) ** 2))
    assert sp.simplify(profile - printed) == 0  # (4.2)

    bracket = 1 - zeta**2 + sp.log(zeta**2)
    stress_of_depth = -force / (4 * sp.pi * depth * h) * bracket  # (4.3)
    squared = sp.expand(slope**2 * r)
    strain = sp.integrate(squared, (r, zeta * a, a)) / (2 * a**2 * (1 - zeta**2))  # (4.5)
    derived = stress_of_depth * (1 - nu) / strain.subs(stress, stress_of_depth)  # (4.6)
    numerator = 3 - 4 * zeta**2 + zeta**4 + 2 * sp.log(zeta**2)
    shape = numerator / ((1 - zeta**2) * bracket**3)
    printed_modulus = force * a**2 * (1 - nu) / (2 * sp.pi * h * depth**3) / shape  # (5.2)
    assert sp.simplify(sp.expand_log(derived / printed_modulus, force=True)) == 1


def test_stress_and_strain_equal_quadrature() -> None:
    a, c, depth = 250.0, 25.0, 40.0
    k = depth / quad(lambda r: 1 / r - r / a**2, c, a)[0]  # F/(2πσh) from the integral of (4.1)
    stress = 50.0 / (2 * np.pi * k * 3.0)
    strain = 0.25 * quad(lambda r: (k * (1 / r - r / a**2)) ** 2 * r, c, a)[0] / ((a**2 - c**2) / 2)
    geometry = (a, depth)
    # quad promises 1.5e-8; it reaches about 1e-14 on these smooth integrands.
    got = membrane_stress(50.0, *geometry, thickness=3.0, probe_half_width=c)
    assert float(got) == pytest.approx(stress, rel=1e-10)
    assert float(mean_strain(*geometry, probe_half_width=c)) == pytest.approx(strain, rel=1e-10)
    # (4.6) closes the loop: E = σ (1 − ν)/ε.
    assert float(elastic_modulus(**VALUES)) == pytest.approx(stress * 0.6 / strain, rel=1e-10)


@pytest.mark.parametrize("steepness", [0.01, 0.2, 0.49, 1.0])
@pytest.mark.parametrize("zeta", [0.01, 0.1, 0.6])
def test_exact_strain_equals_adaptive_quadrature(steepness: float, zeta: float) -> None:
    scale = -2 * steepness / (1 - zeta**2 + np.log(zeta**2))
    integral = quad(
        lambda r: (np.hypot(1, scale * (1 / r - r)) - 1) * r, zeta, 1, epsabs=0, epsrel=1e-12
    )[0]
    got = float(mean_strain(1.0, steepness, probe_half_width=zeta, small_slopes=False))
    # √(1+s²) − 1 in quad's integrand cancels to about 1e-12 relative at slopes of 0.01.
    assert got == pytest.approx(integral / (1 - zeta**2), rel=1e-9)


def test_small_slope_warning_limit_is_where_modulus_is_5_percent_low() -> None:
    depth = SmallSlopeWarning.limit * 250.0

    def too_low(steepness: float, half_width: float) -> float:
        """Share by which the modulus of small slopes falls short of that without them."""
        values = VALUES | {"dimple_depth": steepness * 250.0, "probe_half_width": half_width}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SmallSlopeWarning)
            return finite_slope_modulus(**values) / float(elastic_modulus(**values)) - 1

    # The rounding of the docstring's per cents.
    assert too_low(depth / 250.0, 25.0) == pytest.approx(0.05, abs=0.005)
    assert too_low(depth / 250.0, 50.0) == pytest.approx(0.04, abs=0.005)
    assert too_low(depth / 250.0, 10.0) == pytest.approx(0.13, abs=0.005)
    assert too_low(2 * depth / 250.0, 25.0) == pytest.approx(0.25, abs=0.005)


def test_profile_meets_rim_and_probe_and_balances_the_force() -> None:
    a, c, depth = 250.0, 25.0, 40.0
    r = np.linspace(c, a, 4001)
    w = dimple_profile(r, a, depth, probe_half_width=c)
    assert w[0] == pytest.approx(depth, rel=1e-12)
    assert w[-1] == pytest.approx(0.0, abs=1e-12)
    # (4.1) along the profile: pressure plus membrane carry F at every radius.
    stress = membrane_stress(50.0, a, depth, thickness=3.0, probe_half_width=c)
    slope = -np.gradient(w, r, edge_order=2)
    carried = 50.0 * (r / a) ** 2 + stress * slope * 2 * np.pi * r * 3.0
    np.testing.assert_allclose(carried, 50.0, rtol=2e-5)  # second-order differences on 0.056 µm


@settings(deadline=None, max_examples=60)
@given(force=st.floats(0.1, 1e3), a=lengths, zeta=ratios, depth=st.floats(0.5, 100.0))
def test_force_modulus_and_depth_invert_each_other(force, a, zeta, depth) -> None:
    data = {"thickness": 3.0, "probe_half_width": zeta * a, "poisson_ratio": 0.5}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        modulus = elastic_modulus(force, a, depth, **data)
        assert float(indentation_force(modulus, a, depth, **data)) == pytest.approx(
            force, rel=1e-12
        )
        assert float(dimple_depth(force, a, modulus, **data)) == pytest.approx(depth, rel=1e-12)


def test_dimple_covariance_replaces_two_standard_deviations() -> None:
    independent = {"dimple_radius": 1.0, "dimple_depth": 0.4}
    apart = modulus_std(VALUES, {}, dimple_covariance=[[1.0, 0.0], [0.0, 0.16]])
    assert apart == pytest.approx(modulus_std(VALUES, independent), rel=1e-12)
    unknown = modulus_std(VALUES, {}, dimple_covariance=np.full((2, 2), np.nan))
    assert np.isnan(unknown)
    assert modulus_std(VALUES | {"poisson_ratio": 0.0}, {"poisson_ratio": 0.01}) > 0


def test_samples_of_large_errors_are_possible_dimples() -> None:
    """A force of 150 ± 40 µN is never negative, and keeps its mean and standard deviation."""
    values = VALUES | {"force": 150.0}
    modulus = float(elastic_modulus(**values))
    forces = modulus_samples(values, {"force": 40.0}, size=100_000, rng=0) / modulus * 150
    assert forces.min() > 0
    # 100 000 draws know the mean to 0.13 µN and the deviation of a log-normal to 0.3 %.
    assert forces.mean() == pytest.approx(150.0, abs=0.5)
    assert forces.std() == pytest.approx(40.0, rel=0.015)
    # All but ν half as uncertain as they are large.
    wide = {name: values[name] / 2 for name in values if name != "poisson_ratio"}
    samples = modulus_samples(values, wide, size=20_000, rng=0)
    assert samples.shape == (20_000,)
    assert (samples > 0).all()
    # A probe hardly narrower than the dimple, and ν at the end of its range: E goes with 1 − ν.
    narrow = values | {"dimple_radius": 27.0}
    assert np.isfinite(modulus_samples(narrow, {"probe_half_width": 2.0}, size=5000, rng=0)).all()
    rubber = values | {"poisson_ratio": 0.5}
    ratio = 1 - modulus_samples(rubber, {"poisson_ratio": 0.02}, size=20_000, rng=0) / (
        2 * float(elastic_modulus(**rubber))
    )
    assert ratio.max() <= 0.5 + 1e-12
    # Half of a normal distribution: its mean lies √(2/π) deviations below 0.5.
    assert ratio.mean() == pytest.approx(0.5 - 0.02 * np.sqrt(2 / np.pi), abs=5e-4)


def test_deep_dimple_warns_of_small_slopes() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        elastic_modulus(**VALUES | {"dimple_depth": 0.999 * SmallSlopeWarning.limit * 250.0})
    with pytest.warns(SmallSlopeWarning, match=r"w_d/a = 0\.10 > 0.1: the small-slope"):
        elastic_modulus(**VALUES | {"dimple_depth": 1.001 * SmallSlopeWarning.limit * 250.0})
    with pytest.warns(SmallSlopeWarning, match=r"w_d/a = 0\.40"):
        elastic_modulus(**VALUES | {"dimple_depth": 100.0})
    with pytest.warns(SmallSlopeWarning):
        indentation_force(1.0, 250.0, 100.0, **FILM)
    with pytest.warns(SmallSlopeWarning):
        dimple_depth(5000.0, 250.0, 1.0, **FILM)


def test_singular_covariance_with_rounding_is_accepted() -> None:
    assert modulus_std(VALUES, {}, dimple_covariance=[[1.0, 0.5], [0.5 + 1e-16, 0.25]]) > 0


@pytest.mark.parametrize("zeta", [1e-6, 0.1012, 0.5, 0.974, 0.975, 0.99, 0.9999, 1 - 1e-9])
def test_force_matches_60_digit_arithmetic(zeta: float) -> None:
    """Both branches of the bracket, and the seam near ζ = 0.9747, against 60 digits."""
    with mpmath.workdps(60):
        z = mpmath.mpf(zeta)
        bracket = 1 - z**2 + mpmath.log(z**2)
        shape = (3 - 4 * z**2 + z**4 + 2 * mpmath.log(z**2)) / ((1 - z**2) * bracket**3)
    got = indentation_force(1.0, 1.0, 1.0, thickness=1.0, probe_half_width=zeta, poisson_ratio=0.0)
    # The closed form loses about x⁻³ = 8000 roundings at the seam, where x = 0.05.
    assert float(got) == pytest.approx(float(2 * mpmath.pi * shape), rel=1e-11)


def test_lengths_or_force_in_other_units_warn() -> None:
    """The thesis' dimple, 1.32 MPa, in metres and millimetres, and with its force in N."""
    right = {"force": 197.24, "dimple_radius": 246.95, "dimple_depth": 121.22, "thickness": 3.0}
    lengths = {"dimple_radius", "dimple_depth", "thickness", "probe_half_width"}
    right |= {"probe_half_width": 25.0, "poisson_ratio": 0.5}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", SmallSlopeWarning)
        assert float(elastic_modulus(**right)) == pytest.approx(1.324, abs=1e-3)  # as printed
    for factor, force in ((1e-6, 197.24), (1e-3, 197.24), (1.0, 197.24e-6)):
        wrong = {k: v * factor if k in lengths else v for k, v in right.items()} | {"force": force}
        with pytest.warns(
            UserWarning, match="is outside the range of membranes: lengths must be in µm"
        ):
            elastic_modulus(**wrong)
