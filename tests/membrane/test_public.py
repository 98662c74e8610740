"""The laws of every public name of the membranes."""

import numpy as np
import pytest

from microlib.membrane import capsule_modulus, elastic_modulus, model_moduli
from tests.laws import (
    NUMBER,
    MPa,
    Row,
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
    return {"rim_radius": A * u.um, "dimple_depth": 19.0 * u.um}


def wall(u) -> dict:
    return {"thickness": H * u.um, "probe_half_width": C * u.um}


def errors(u) -> dict:
    return {
        "values": {"force": 43.0 * u.uN, **dimple(u), **film(u)},
        "uncertainties": {"force": 2.0 * u.uN, "thickness": 0.2 * u.um, "poisson_ratio": 0.02},
        "dimple_covariance": np.array([[9.0, 0.8], [0.8, 0.2]]) * u.um**2,
    }


def geometry(u) -> dict:
    return dimple(u) | {"probe_half_width": C * u.um}


EXPONENTS = dict.fromkeys(("rim_radius", "depth", "probe_half_width", "capsule_radius"), NUMBER)
KINDS = ("disc, {}", "disc, {}, no pressure", "capsule, {}")
NAMES = [kind.format(law) for law in ("neo-hooke", "hooke") for kind in KINDS]
MODELS = dict.fromkeys(["point load", *NAMES], MPa)
LAWS = {
    "membrane.elastic_modulus": Row(lambda u: {"force": 43.0 * u.uN, **dimple(u), **film(u)},
        MPa),
    "membrane.finite_slope_modulus": Row(lambda u: {"force": 43.0 * u.uN, **dimple(u), **film(u)},
        MPa),
    "membrane.indentation_force": Row(lambda u: {"modulus": 0.7 * u.MPa, **dimple(u), **film(u)},
        uN),
    "membrane.dimple_depth": Row(lambda u: {"force": 43.0 * u.uN, "rim_radius": A * u.um,
        "modulus": 0.7 * u.MPa, **film(u)}, um),
    "membrane.dimple_profile": Row(lambda u: {"radius": np.array([20.0, 90.0, 200.0]) * u.um,
        **geometry(u)}, um),
    "membrane.membrane_stress": Row(lambda u: {"force": 43.0 * u.uN, **dimple(u), **wall(u)},
        MPa),
    "membrane.mean_strain": Row(lambda u: {**geometry(u), "small_slopes": False}, NUMBER),
    "membrane.steepest_depth": Row(lambda u: {"rim_radius": A * u.um,
        "probe_half_width": C * u.um}, um),
    "membrane.modulus_uncertainty": Row(errors, MPa),
    "membrane.modulus_samples": Row(lambda u: {"values": errors(u)["values"],
        "uncertainties": errors(u)["uncertainties"], "size": 7, "rng": 3}, MPa),
    "membrane.indent_disc": Row(lambda u: {"force": 91.0 * u.uN, "modulus": 0.7 * u.MPa,
        "rim_radius": A * u.um, **wall(u), **RUBBER, "pressure": 3e-4 * u.MPa, "pretension": 0.03},
        STATE, within=1e-6),
    "membrane.disc_modulus": Row(lambda u: {"force": 91.0 * u.uN, "rim_radius": A * u.um,
        "depth": 50.0 * u.um, **wall(u), **STEEL, "pressure": 3e-4 * u.MPa}, MPa, within=1e-6),
    "membrane.model_moduli": Row(lambda u: {"force": 91.0 * u.uN, "rim_radius": 190.0 * u.um,
        "dimple_depth": 70.0 * u.um, **film(u), "capsule_radius": R * u.um}, MODELS, within=1e-6),
    "membrane.indent_capsule": Row(lambda u: {"force": 91.0 * u.uN, "modulus": 0.7 * u.MPa,
        "capsule_radius": R * u.um, **wall(u), **RUBBER, "inflation": 1.04}, STATE, within=1e-6),
    "membrane.capsule_modulus": Row(lambda u: {"force": 91.0 * u.uN, "rim_radius": 190.0 * u.um,
        "depth": 70.0 * u.um, "capsule_radius": R * u.um, **wall(u), **STEEL}, {"modulus": MPa,
        "inflation": NUMBER, "exponents": EXPONENTS, "state": STATE}, within=1e-6),
}  # fmt: skip


@pytest.mark.parametrize(("law", "name"), laws_of(LAWS))
def test_law_holds(law, name):
    law(name, LAWS[name])


@pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
def test_models_differ_for_shallow_dimples_too():
    """A disc has its true stress; (5.2) a uniform one. The deep dimple is that of Table 5.6."""
    sizes = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}
    shallow = model_moduli(1.0, 246.95, 8.0, **sizes)
    assert shallow["disc, hooke"] == pytest.approx(0.402 * shallow["point load"], rel=3e-3)
    assert shallow["disc, hooke, no pressure"] == pytest.approx(
        0.667 * shallow["point load"], rel=3e-3
    )
    deep = model_moduli(197.24, 246.95, 121.22, **sizes, capsule_radius=600.0)
    by_hand = capsule_modulus(197.24, 246.95, 121.22, **sizes, capsule_radius=600.0)
    assert deep["point load"] == elastic_modulus(197.24, 246.95, 121.22, **sizes)
    assert deep["capsule, neo-hooke"] == pytest.approx(by_hand.modulus)
    # No capsule of this radius has the dimple, and a probe as wide as the dimple is an error.
    assert set(model_moduli(197.24, 246.95, 121.22, **sizes, capsule_radius=250.0)) == {
        name for name in ("point load", *NAMES) if not name.startswith("capsule")
    }
