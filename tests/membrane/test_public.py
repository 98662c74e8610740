"""The laws of every public name of the membranes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from microlib.membrane import (
    elastic_modulus,
    indent_capsule,
    indent_disc,
    modulus_samples,
    modulus_std,
    viscoelastic_force,
)
from tests.laws import (
    NUMBER,
    MPa,
    Row,
    hold_coverage,
    hold_sigma,
    laws_of,
    um,
    uN,
)

RUBBER = {"law": "mooney-rivlin", "poisson_ratio": 0.5}
STEEL = {"law": "hooke", "poisson_ratio": 0.3}
#: A rim of µm, an egg and its probe, none of them a round multiple of another.
A, C, H, R = 213.0, 17.0, 2.6, 570.0
STATE = {
    **dict.fromkeys(("depth", "approach", "rim_radius", "r", "z"), um),
    **dict.fromkeys(("stresses", "pressure"), MPa),
    "stretches": NUMBER,
}


def film(u) -> dict:
    return {"thickness": H * u.um, "probe_half_width": C * u.um, "poisson_ratio": 0.31}


def dimple(u) -> dict:
    return {"dimple_radius": A * u.um, "dimple_depth": 19.0 * u.um}


def wall(u) -> dict:
    return {"thickness": H * u.um, "probe_half_width": C * u.um}


def errors(u) -> dict:
    return {
        "values": {"force": 43.0 * u.uN, **dimple(u), **film(u)},
        "stds": {"force": 2.0 * u.uN, "thickness": 0.2 * u.um, "poisson_ratio": 0.02},
        "dimple_covariance": np.array([[9.0, 0.8], [0.8, 0.2]]) * u.um**2,
    }


@cache
def capsule_outline() -> np.ndarray:
    egg = {"thickness": 3.0, "probe_half_width": 25.0, "radius": 600.0}
    state = indent_capsule(100.0, modulus=1.0, inflation=1.05, poisson_ratio=0.5, **egg)
    return np.column_stack([state.r, state.z])[::10]


def geometry(u) -> dict:
    return dimple(u) | {"probe_half_width": C * u.um}


LAWS = {
    "membrane.elastic_modulus": Row(lambda u: {"force": 43.0 * u.uN, **dimple(u), **film(u)},
        MPa),
    "membrane.finite_slope_modulus": Row(lambda u: {"force": 43.0 * u.uN, **dimple(u), **film(u)},
        MPa),
    "membrane.indentation_force": Row(lambda u: {"modulus": 0.7 * u.MPa, **dimple(u), **film(u)},
        uN),
    "membrane.dimple_depth": Row(lambda u: {"force": 43.0 * u.uN, "dimple_radius": A * u.um,
        "modulus": 0.7 * u.MPa, **film(u)}, um),
    "membrane.dimple_profile": Row(lambda u: {"radius": np.array([20.0, 90.0, 200.0]) * u.um,
        **geometry(u)}, um),
    "membrane.membrane_stress": Row(lambda u: {"force": 43.0 * u.uN, **dimple(u), **wall(u)},
        MPa),
    "membrane.mean_strain": Row(lambda u: {**geometry(u), "small_slopes": False}, NUMBER),
    "membrane.steepest_depth": Row(lambda u: {"dimple_radius": A * u.um,
        "probe_half_width": C * u.um}, um),
    "membrane.modulus_std": Row(errors, MPa),
    "membrane.modulus_samples": Row(lambda u: {"values": errors(u)["values"],
        "stds": errors(u)["stds"], "size": 7, "rng": 3}, MPa),
    "membrane.viscoelastic_force":
        Row(lambda u: {"time": u.t0 + np.array([0.0, 0.3, 1.1, 4.0]) * u.s,
        "elastic_force": np.array([[1.0, 5.0, 4.0, 4.0], [0.0, 2.0, 2.5, 1.0]]) * u.uN,
        "prony_coefficients": [0.3, 0.2], "relaxation_times": np.array([0.7, 5.0]) * u.s}, uN),
    "membrane.indent_disc": Row(lambda u: {"force": 91.0 * u.uN, "modulus": 0.7 * u.MPa,
        "radius": A * u.um, **wall(u), **RUBBER, "pressure": 3e-4 * u.MPa, "pretension": 0.03,
        "rim_inset": 0.02}, STATE, within=1e-6),
    "membrane.disc_modulus": Row(lambda u: {"force": 91.0 * u.uN, "rim_radius": A * u.um,
        "depth": 50.0 * u.um, **wall(u), **STEEL, "pressure": 3e-4 * u.MPa}, MPa, within=1e-6),
    "membrane.indent_capsule": Row(lambda u: {"force": 91.0 * u.uN, "modulus": 0.7 * u.MPa,
        "radius": R * u.um, **wall(u), **RUBBER, "inflation": 1.04}, STATE, within=1e-6),
    "membrane.capsule_modulus": Row(lambda u: {"force": 91.0 * u.uN, "rim_radius": 190.0 * u.um,
        "depth": 70.0 * u.um, "radius": R * u.um, **wall(u), **STEEL}, {"modulus": MPa,
        "inflation": NUMBER, "state": STATE}, within=1e-6),
    "membrane.fit_capsule": Row(lambda u: {"force": 100.0 * u.uN,
        "outline": capsule_outline() * u.um + [0.0, u.y0_um], "thickness": 3.0 * u.um,
        "probe_half_width": 25.0 * u.um, "radius": 600.0 * u.um, "start": (1.1 * u.MPa, 1.06)},
        {**dict.fromkeys(("modulus", "modulus_std"), MPa), "center": um.counted_from(None, "y0_um"),
        "radius": um, "misfit": um, "tilt": NUMBER, "inflation": NUMBER, "state": STATE},
        within=2e-3),
}  # fmt: skip


@pytest.mark.parametrize(("law", "name"), laws_of(LAWS))
def test_law_holds(law, name):
    law(name, LAWS[name])


@pytest.mark.parametrize(("pretension", "inset"), [(0.1, 0.04), (0.08, 0.0), (0.2, 0.1)])
def test_flat_disc_with_rim_inset_matches_lame_solution(pretension, inset):
    """Hooke's law in the plane: r = αX + β/X between a held hole and a rim that was drawn in."""
    nu, modulus = STEEL["poisson_ratio"], 0.7
    settings = {"modulus": modulus, "radius": A, "thickness": H, "probe_half_width": C}
    state = indent_disc(
        1e-5, pretension=pretension, rim_inset=inset, pressure=0.0, **settings, **STEEL
    )
    # Free of stress, the hole was smaller by the pretension, and the rim lay further out.
    inner, outer = C / (1 + pretension), A / (1 + pretension) / (1 - inset)
    alpha, beta = np.linalg.solve([[inner, 1 / inner], [outer, 1 / outer]], [C, A])

    def strains(x):
        return alpha - beta / x**2 - 1, alpha + beta / x**2 - 1

    x = state.r / state.stretches[1]
    np.testing.assert_allclose(state.stretches - 1, strains(x), atol=1e-7)
    e1, e2 = strains(x)
    stress = modulus * np.array([e1 + nu * e2, e2 + nu * e1]) / (1 - nu**2)
    np.testing.assert_allclose(state.stresses, stress, rtol=1e-5)


@pytest.mark.parametrize("size", [0.01, 0.03])
def test_modulus_std_and_samples_match_drawn_errors(size):
    """Of inputs that are drawn apart from the library, radius and depth together."""
    rng = np.random.default_rng(5)
    values = {"force": 43.0, "dimple_radius": A, "dimple_depth": 19.0, "thickness": H}
    values |= {"probe_half_width": C, "poisson_ratio": 0.31}
    stds = {name: size * values[name] for name in ("force", "thickness", "probe_half_width")}
    scales = size * np.array([A, 19.0])
    covariance = np.outer(scales, scales) * [[1.0, 0.8], [0.8, 1.0]]
    std = modulus_std(values, stds, dimple_covariance=covariance)
    drawn = {name: rng.normal(values[name], std_of, 400) for name, std_of in stds.items()}
    both = rng.multivariate_normal([A, 19.0], covariance, 400).T
    drawn |= {"dimple_radius": both[0], "dimple_depth": both[1], "poisson_ratio": 0.31}
    moduli = elastic_modulus(**drawn)
    hold_sigma(
        np.log(moduli / elastic_modulus(**values)), np.full(400, std) / elastic_modulus(**values)
    )
    drawn |= {"dimple_radius": rng.normal(A, scales[0], 400), "dimple_depth": 19.0}
    stds |= {"dimple_radius": scales[0]}
    samples, moduli = modulus_samples(values, stds, size=4000, rng=6), elastic_modulus(**drawn)
    for level in (0.5, 0.95):
        low, high = np.quantile(samples, [(1 - level) / 2, (1 + level) / 2])
        hold_coverage((low < moduli) & (moduli < high), level)


ERRORS = [{name: 0.2} for name in ("force", "thickness", "probe_half_width", "poisson_ratio")]


@pytest.mark.parametrize("error", [*ERRORS, *[{"dimple_radius": a, "dimple_depth": w} for a, w in
    ((0.7, 0.0), (0.0, 0.2), (0.7, 0.2), (0.7, -0.2))]])  # fmt: skip
@pytest.mark.parametrize("half_width", [C, 190.0])
def test_modulus_std_matches_numerical_derivative(error, half_width):
    """Of inputs that err together in a known direction, on either side of a wide probe, too."""
    values = {"force": 43.0, "dimple_radius": A, "dimple_depth": 19.0, "thickness": H}
    values |= {"probe_half_width": half_width, "poisson_ratio": 0.31}
    step = 1e-5
    up, down = (
        elastic_modulus(**values | {name: values[name] + by * std for name, std in error.items()})
        for by in (step, -step)
    )
    together = {}
    if "dimple_radius" in error:
        way = np.array([error["dimple_radius"], error["dimple_depth"]])
        error, together = {}, {"dimple_covariance": np.outer(way, way)}
    # Central differences: truncation of order step² and cancellation of order 1e-16/step.
    slope = abs(up - down) / (2 * step)
    assert modulus_std(values, error, **together) == pytest.approx(slope, rel=1e-6)


def test_first_elastic_force_is_applied_instantaneously():
    """And what relaxes is counted from there, whatever the clock said before."""
    time = 3.7 + np.array([0.0, 0.3, 1.1, 4.0])
    force = np.array([[1.0, 5.0, 4.0, 4.0], [2.0, 2.0, 2.5, 1.0]])
    law = {"prony_coefficients": [0.3, 0.2], "relaxation_times": [0.7, 5.0]}
    found = viscoelastic_force(time, force, **law)
    sooner = viscoelastic_force(
        np.append([1.0, time[0] - 1e-9], time), np.pad(force, ((0, 0), (2, 0))), **law
    )
    np.testing.assert_allclose(sooner[:, 2:], found, rtol=1e-8)
    # Forces add: each that is held falls by the same function of time.
    steps = viscoelastic_force(time, np.eye(4)[0] + np.zeros((2, 4)), **law)
    parts = viscoelastic_force(time, force - force[:, :1] * np.eye(4)[0], **law)
    np.testing.assert_allclose(parts + force[:, :1] * steps, found, rtol=1e-12)
