"""The point-load model against quadrature, 60-digit arithmetic and drawn errors."""

import warnings
from collections.abc import Callable
from functools import partial

import mpmath
import numpy as np
import pytest
from scipy.integrate import quad

from microlib.membrane import (
    SmallSlopeWarning,
    capsule_modulus,
    dimple_depth,
    dimple_profile,
    disc_modulus,
    elastic_modulus,
    finite_slope_modulus,
    indentation_force,
    mean_strain,
    membrane_stress,
    modulus_samples,
    modulus_uncertainty,
)

# Most dimples here are steeper than the small slopes that the model assumes.
pytestmark = [
    pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning"),
    pytest.mark.filterwarnings("ignore:a modulus of"),
]

FILM = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.4}
VALUES = {"force": 50.0, "rim_radius": 250.0, "dimple_depth": 40.0, **FILM}


@pytest.mark.parametrize("steepness", [0.01, 0.2, 0.49, 1.0])
@pytest.mark.parametrize("zeta", [0.01, 0.1, 0.6])
def test_mean_strain_equals_adaptive_quadrature(steepness: float, zeta: float) -> None:
    scale = -2 * steepness / (1 - zeta**2 + np.log(zeta**2))

    def mean(stretch: Callable[[float], float]) -> float:
        integral = quad(
            lambda r: stretch(scale * (1 / r - r)) * r, zeta, 1, epsabs=0, epsrel=1e-12
        )[0]
        return integral / (1 - zeta**2)

    exact = mean_strain(1.0, steepness, probe_half_width=zeta, small_slopes=False)
    # √(1+s²) − 1 in the integrand cancels to about 1e-12 relative at slopes of 0.01.
    assert float(exact) == pytest.approx(mean(lambda slope: np.hypot(1, slope) - 1), rel=1e-9)
    small = mean_strain(1.0, steepness, probe_half_width=zeta)
    assert float(small) == pytest.approx(mean(lambda slope: slope**2 / 2), rel=1e-10)


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
    # (4.6): E = σ (1 − ν)/ε.
    modulus = stress * 0.6 / mean_strain(a, depth, probe_half_width=c)
    assert float(elastic_modulus(**VALUES)) == pytest.approx(float(modulus), rel=1e-10)


@pytest.mark.parametrize("zeta", [0.01, 0.2, 0.97, 0.99])
def test_force_modulus_and_depth_invert_each_other(zeta: float) -> None:
    data = {"thickness": 3.0, "probe_half_width": zeta * 213.0, "poisson_ratio": 0.3}
    modulus = elastic_modulus(43.0, 213.0, 17.0, **data)
    force = indentation_force(modulus, 213.0, 17.0, **data)
    assert float(force) == pytest.approx(43.0, rel=1e-12)
    assert float(dimple_depth(43.0, 213.0, modulus=modulus, **data)) == pytest.approx(
        17.0, rel=1e-12
    )


def test_samples_have_stated_mean_and_std_and_are_possible_dimples() -> None:
    modulus = float(elastic_modulus(**VALUES))
    # Small errors of all inputs scatter as the first order says.
    small = {name: 0.01 * value for name, value in VALUES.items()}
    samples = modulus_samples(VALUES, small, size=20_000, rng=0)
    backwards = dict(reversed(VALUES.items()))
    other = modulus_samples(backwards, small, size=20_000, rng=0)
    np.testing.assert_allclose(other, samples, rtol=1e-12)
    assert samples.std() == pytest.approx(modulus_uncertainty(VALUES, small), rel=0.02)
    # 100 000 draws know the mean of 50 ± 13 µN to 0.04 and a log-normal's deviation to 0.3 %.
    forces = modulus_samples(VALUES, {"force": 13.0}, size=100_000, rng=0) / modulus * 50
    assert forces.min() > 0
    assert forces.mean() == pytest.approx(50.0, abs=0.2)
    assert forces.std() == pytest.approx(13.0, rel=0.015)
    # A probe hardly narrower than the dimple.
    narrow = VALUES | {"rim_radius": 27.0}
    assert np.isfinite(modulus_samples(narrow, {"probe_half_width": 2.0}, size=5000, rng=0)).all()
    # E is proportional to 1 − ν. Half of a normal distribution has its mean √(2/π) σ below 0.5.
    rubber = VALUES | {"poisson_ratio": 0.5}
    drawn = modulus_samples(rubber, {"poisson_ratio": 0.02}, size=20_000, rng=0)
    ratio = 1 - drawn / (2 * float(elastic_modulus(**rubber)))
    assert ratio.max() <= 0.5 + 1e-12
    assert ratio.mean() == pytest.approx(0.5 - 0.02 * np.sqrt(2 / np.pi), abs=5e-4)


ERRORS = [{name: 0.2} for name in VALUES if name not in ("rim_radius", "dimple_depth")]
JOINT = [(0.7, 0.0), (0.0, 0.2), (0.7, 0.2), (0.7, -0.2)]
WIDE, CORK = {"probe_half_width": 190.0}, {"poisson_ratio": 0.0}


@pytest.mark.parametrize(
    "error", [*ERRORS, *({"rim_radius": a, "dimple_depth": w} for a, w in JOINT)]
)
@pytest.mark.parametrize("changed", [{}, WIDE, CORK], ids=["usual", "wide probe", "no Poisson"])
def test_modulus_uncertainty_matches_numerical_derivative(error, changed) -> None:
    """Radius and depth are fully correlated: their covariance is singular."""
    values = VALUES | changed
    step = 1e-5
    up, down = (
        elastic_modulus(**values | {name: values[name] + by * std for name, std in error.items()})
        for by in (step, -step)
    )
    given = {"uncertainties": error}
    if "rim_radius" in error:
        std = [error["rim_radius"], error["dimple_depth"]]
        given = {"uncertainties": {}, "dimple_covariance": np.outer(std, std)}
    # Central differences: truncation of order step² and cancellation of order 1e-16/step.
    by_differences = abs(up - down) / (2 * step)
    assert modulus_uncertainty(values, **given) == pytest.approx(by_differences, rel=1e-6)
    assert np.isnan(modulus_uncertainty(values, {}, dimple_covariance=np.full((2, 2), np.nan)))


@pytest.mark.parametrize(
    ("function", "changed"),
    [
        (elastic_modulus, {"force": 50.0, "dimple_depth": 25.1}),
        (indentation_force, {"modulus": 1.0, "dimple_depth": 25.1}),
        (dimple_depth, {"force": 5.0, "modulus": 1.0}),
    ],
)
def test_depth_above_a_tenth_of_the_radius_warns_of_small_slopes(function, changed) -> None:
    given = {"rim_radius": 250.0, **FILM, **changed}
    with pytest.warns(SmallSlopeWarning, match=r"w_d/a = 0\.\d\d > 0.1: small slopes"):
        function(**given)
    shallow = {"dimple_depth": 24.9} if "dimple_depth" in changed else {"force": 0.5}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        function(**given | shallow)


def test_steep_dimple_beside_shallow_one_warns_and_has_its_own_modulus() -> None:
    depths = np.array([[10.0, 240.0], [24.0, 30.0]])
    with pytest.warns(SmallSlopeWarning, match="w_d/a = 0.96") as caught:
        both = elastic_modulus(50.0, 250.0, depths, **FILM)
    assert len(caught) == 1
    assert np.isfinite(both).all()
    # E falls with the third power of the depth.
    np.testing.assert_allclose(both * depths**3, both[0, 0] * 10.0**3)


#: Each model of a disc without pretension.
MODELS = [elastic_modulus, finite_slope_modulus, partial(disc_modulus, law="hooke")]


@pytest.mark.parametrize(("depth", "times"), [(3.2, 2.5), (5.9, 0.8)])
def test_depth_at_which_bending_carries_the_force_warns(depth: float, times: float) -> None:
    """A clamped plate that only bends, F = 16π D w/a², has a wrong modulus by (5.2)."""
    plate = 16 * np.pi * 1.3 * 3.0**3 / (12 * (1 - FILM["poisson_ratio"] ** 2)) * depth / 250.0**2
    with pytest.warns(UserWarning, match="because the model omits bending") as caught:
        moduli = [float(model(plate, 250.0, depth, **FILM)) for model in MODELS]
    assert len(caught) == 3
    with pytest.warns(UserWarning, match="because the model omits bending"):
        elastic_modulus(plate, 250.0, [20.0, depth], **FILM)  # beside a deeper dimple
    assert moduli[0] > times * 1.3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for model in MODELS:
            model(plate, 250.0, 6.1, **FILM)


@pytest.mark.parametrize(
    ("model", "depth", "thickness", "times"),
    [
        *((model, 2.9, 3.0, r"0\.97") for model in MODELS),
        (elastic_modulus, [1.5, 20.0], 3.0, r"0\.5"),
        (elastic_modulus, 2.9, [1.0, 3.0], r"0\.97"),
    ],
)
def test_depth_below_the_thickness_raises_also_beside_others(
    model, depth, thickness, times
) -> None:
    with pytest.raises(
        ValueError, match=rf"depth must be at least the thickness.*{times} times: is the unit right"
    ):
        model(0.01, 250.0, depth, **FILM | {"thickness": thickness})


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


@pytest.mark.parametrize(("length", "force"), [(1e-3, 1.0), (1.0, 1e-6)], ids=["mm", "N"])
def test_lengths_or_force_in_other_units_warn(length: float, force: float) -> None:
    """The dimple of the thesis, of which the modulus is printed, in other units."""
    right = np.array([197.24, 246.95, 121.22, 3.0, 25.0])

    def modulus(model, load, a, depth, h, c):
        sizes = {"thickness": h, "probe_half_width": c, "poisson_ratio": 0.5}
        return model(load, a, depth, **sizes)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", SmallSlopeWarning)
        assert float(modulus(elastic_modulus, *right)) == pytest.approx(1.324, abs=1e-3)
    wrong = right * [force, *[length] * 4]
    capsule = partial(capsule_modulus, capsule_radius=600.0 * length)
    for model in (elastic_modulus, disc_modulus, capsule):
        with pytest.warns(UserWarning, match="the range of membranes: lengths must be in µm"):
            modulus(model, *wrong)
