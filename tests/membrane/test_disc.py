"""The clamped disc, against a closed form, another program's ratios, and its own energy."""

from typing import Any

import numpy as np
import pytest

from microlib.membrane import disc_modulus, elastic_modulus, indent_disc
from tests.membrane.energy import stored, stresses

A, H, C, F = 246.95, 3.0, 25.0, 197.24
DISC: dict[str, Any] = {"thickness": H, "probe_half_width": C, "poisson_ratio": 0.5}


@pytest.mark.parametrize("force", [1e-6, 1e-3])
def test_force_matches_closed_form_for_small_slopes(force: float) -> None:
    # ν = 1/3, no pressure: no point moves sideways, N₁ falls with X^(−2/3).
    cork = DISC | {"poisson_ratio": 1 / 3}
    depth = indent_disc(force, A, modulus=1.0, law="hooke", pressure=0, **cork).depth
    wanted = np.pi / 3 * H * depth**3 / (A**2 * (1 - (C / A) ** (2 / 3)) ** 3)
    assert force == pytest.approx(wanted, rel=1e-3 * (depth / A / 0.0085) ** 2)


@pytest.mark.parametrize(
    ("law", "pressure", "steepness", "ratio"),
    [
        ("neo-hooke", "balance", 0.1, 0.413),
        ("neo-hooke", "balance", 0.4908, 0.704),
        ("hooke", "balance", 0.1, 0.408),
        ("hooke", "balance", 0.4908, 0.549),
        ("neo-hooke", 0, 0.1, 0.681),
        ("neo-hooke", 0, 0.4908, 1.028),
    ],
)
@pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
def test_ratio_to_point_load_modulus_matches_independent_solver(
    law: str, pressure: float | str, steepness: float, ratio: float
) -> None:
    got = disc_modulus(F, A, steepness * A, law=law, pressure=pressure, **DISC)
    thesis = float(elastic_modulus(F, A, steepness * A, **DISC))
    assert got / thesis == pytest.approx(ratio, rel=2e-3)
    state = indent_disc(F, A, modulus=got, law=law, pressure=pressure, **DISC)
    assert state.depth == pytest.approx(steepness * A, rel=1e-8)


@pytest.mark.parametrize(
    "kw",
    [
        {"pressure": 0},
        {},
        {"pretension": 0.03},
        {"law": "hooke", "poisson_ratio": 0.3},
        {"law": "mooney-rivlin", "pretension": 0.05},
    ],
)
def test_work_of_force_and_pressure_equals_energy(kw: dict[str, Any]) -> None:
    given = {"law": "neo-hooke", **DISC, **kw}
    less, more = states = [indent_disc(k * F, A, modulus=1.0, **given) for k in (0.98, 1.02)]
    energies = [stored(s, given["law"], 1.0, H, given["poisson_ratio"]) for s in states]
    wanted = stresses(given["law"], less.stretches, given["poisson_ratio"])
    np.testing.assert_allclose(less.stresses, wanted, atol=1e-7)
    # Between the disc and its rim's plane, that below the probe included.
    volumes = [np.pi * C**2 * s.depth - np.trapezoid(2 * np.pi * s.r * s.z, s.r) for s in states]
    p = (less.pressure + more.pressure) / 2
    work = F * (more.depth - less.depth) - p * (volumes[1] - volumes[0])
    # The trapezoids' second differences over 4 % of the force.
    assert energies[1] - energies[0] == pytest.approx(work, rel=3e-4)


def test_state_joins_probe_and_rim_with_level_tangent() -> None:
    state = indent_disc(F, A, modulus=1.3, **DISC)
    assert (state.r[0], state.r[-1]) == pytest.approx((C, A))
    assert (state.rim_radius, state.approach) == pytest.approx((A, state.depth))
    assert (state.z[0], state.z[-1]) == (pytest.approx(-state.depth), 0)
    assert state.pressure == pytest.approx(F / (np.pi * A**2))
    usual = {"law": "neo-hooke", "pressure": F / (np.pi * A**2), "pretension": 0.0, **DISC}
    assert indent_disc(F, A, modulus=1.3, **usual).depth == pytest.approx(state.depth, rel=1e-9)
    assert disc_modulus(F, A, state.depth, **DISC) == pytest.approx(1.3, rel=1e-6)
    # The pressure carries the whole force at the rim.
    slope = (state.z[-1] - state.z[-2]) / (state.r[-1] - state.r[-2])
    assert slope == pytest.approx(0, abs=5e-3)


def test_tight_disc_is_a_linear_spring() -> None:
    """The stress N = E λ⁻¹(λ − λ⁻⁵)/3 of the pretension carries F, as in a drumhead."""
    small = indent_disc(1e-4, A, modulus=1.0, pretension=0.1, pressure=0, **DISC).depth
    tension = H * (1 - 1.1**-6) / 3
    assert small == pytest.approx(1e-4 * np.log(A / C) / (2 * np.pi * tension), rel=1e-3)
    # Also if it is less deep than thick.
    found = disc_modulus(1e-4, A, small, pretension=0.1, pressure=0, **DISC)
    assert found == pytest.approx(1.0, rel=1e-5)


@pytest.mark.parametrize("narrow", [0.005, 0.001])
@pytest.mark.parametrize("steepness", [0.005, 0.02, 0.1])
def test_disc_modulus_is_found_for_narrow_probe(narrow: float, steepness: float) -> None:
    # At these depths a thicker disc resists by bending.
    thin = H / 10
    settings: dict[str, Any] = {"thickness": thin, "law": "hooke", "pressure": 0.0}
    settings["probe_half_width"] = narrow * A
    soft, found, stiff = (
        disc_modulus(1e-3 * F, A, steepness * A, poisson_ratio=ratio, **settings)
        for ratio in (0.5, 1 / 3, 0.3)
    )
    assert soft < found < stiff
    if steepness == 0.005:
        shape = (1 - narrow ** (2 / 3)) ** 3 * A**2 / (thin * (steepness * A) ** 3)
        # Slopes at the probe are not small: 0.3 at a thousandth of the radius.
        assert found == pytest.approx(1e-3 * F * shape * 3 / np.pi, rel=0.02)


def test_error_of_a_depth_beyond_the_folds_names_it_and_the_pressure() -> None:
    sizes = {"thickness": 3.0, "probe_half_width": 100.0, "poisson_ratio": 0.5}
    with pytest.raises(ValueError, match=r"at w_d/a = 4, c/a = 0.4; under pressure .* pressure=0"):
        disc_modulus(100.0, 250.0, 1000.0, **sizes)
    assert disc_modulus(100.0, 250.0, 1000.0, pressure=0, **sizes) > 0
