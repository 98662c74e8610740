"""The calls of every public function of the membranes: their units and what they refuse."""

import numpy as np
import pytest

from microlib import membrane
from microlib.membrane import capsule_modulus, elastic_modulus, model_moduli
from tests.checks import (
    BROKEN,
    NEGATIVE,
    NO_NUMBER,
    NOT_POSITIVE,
    Wrong,
    hold_call,
    hold_refused,
    hold_scaled,
    no_map,
    not_finite,
)

pytestmark = pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
RUBBER = {"law": "mooney-rivlin", "poisson_ratio": 0.5}
STEEL = {"law": "hooke", "poisson_ratio": 0.3}
#: A rim of µm and an egg, neither of them a round multiple of another length.
A, R = 213.0, 570.0


def wall(um: float) -> dict:
    return {"thickness": 2.6 * um, "probe_half_width": 17.0 * um}


def film(um: float) -> dict:
    return wall(um) | {"poisson_ratio": 0.31}


def dimple(um: float) -> dict:
    return {"rim_radius": A * um, "dimple_depth": 19.0 * um}


def geometry(um: float) -> dict:
    return dimple(um) | {"probe_half_width": 17.0 * um}


def pressed(um: float, uN: float) -> dict:
    return {"force": 43.0 * uN, **dimple(um), **film(um)}


def errors(um: float, uN: float) -> dict:
    return {"force": 2.0 * uN, "thickness": 0.2 * um, "poisson_ratio": 0.02}


#: A valid call of each function, in any units of length and force.
CALLS = {
    membrane.elastic_modulus: pressed,
    membrane.finite_slope_modulus: pressed,
    membrane.indentation_force: lambda um, uN: {
        "modulus": 0.7 * uN / um**2,
        **dimple(um),
        **film(um),
    },
    membrane.dimple_depth: lambda um, uN: {
        "force": 43.0 * uN,
        "rim_radius": A * um,
        "modulus": 0.7 * uN / um**2,
        **film(um),
    },
    membrane.dimple_profile: lambda um, uN: {
        "radius": np.array([20.0, 90.0, 200.0]) * um,
        **geometry(um),
    },
    membrane.membrane_stress: lambda um, uN: {"force": 43.0 * uN, **dimple(um), **wall(um)},
    membrane.mean_strain: lambda um, uN: {**geometry(um), "small_slopes": False},
    membrane.steepest_depth: lambda um, uN: {"rim_radius": A * um, "probe_half_width": 17.0 * um},
    membrane.modulus_uncertainty: lambda um, uN: {
        "values": pressed(um, uN),
        "uncertainties": errors(um, uN),
        "dimple_covariance": np.array([[9.0, 0.8], [0.8, 0.2]]) * um**2,
    },
    membrane.modulus_samples: lambda um, uN: {
        "values": pressed(um, uN),
        "uncertainties": errors(um, uN),
        "size": 7,
        "rng": 3,
    },
    membrane.indent_disc: lambda um, uN: {
        "force": 91.0 * uN,
        "modulus": 0.7 * uN / um**2,
        "rim_radius": A * um,
        **wall(um),
        **RUBBER,
        "pressure": 2.1e-4 * uN / um**2,
        "pretension": 0.03,
    },
    membrane.disc_modulus: lambda um, uN: {
        "force": 91.0 * uN,
        "rim_radius": A * um,
        "depth": 50.0 * um,
        **wall(um),
        **STEEL,
        "pressure": 3e-4 * uN / um**2,
        "pretension": 0.0,
    },
    membrane.model_moduli: lambda um, uN: {
        "force": 91.0 * uN,
        "rim_radius": 190.0 * um,
        "dimple_depth": 70.0 * um,
        **film(um),
        "capsule_radius": R * um,
    },
    membrane.indent_capsule: lambda um, uN: {
        "force": 91.0 * uN,
        "modulus": 0.7 * uN / um**2,
        "capsule_radius": R * um,
        **wall(um),
        **RUBBER,
        "inflation": 1.04,
    },
    membrane.capsule_modulus: lambda um, uN: {
        "force": 91.0 * uN,
        "rim_radius": 190.0 * um,
        "depth": 70.0 * um,
        "capsule_radius": R * um,
        **wall(um),
        **STEEL,
    },
}
each_call = pytest.mark.parametrize("function", CALLS, ids=lambda f: f.__name__)

#: Other units of length and force, and that of a modulus in them.
UM, UN = 1.7, 0.45
MPA = UN / UM**2
LENGTHS = dict.fromkeys(("depth", "approach", "rim_radius", "r", "z"), UM)
STATE = LENGTHS | dict.fromkeys(("stresses", "pressure"), MPA)
#: By what each result is multiplied.
FACTORS = {
    **dict.fromkeys(
        (membrane.elastic_modulus, membrane.finite_slope_modulus, membrane.membrane_stress), MPA
    ),
    **dict.fromkeys((membrane.modulus_uncertainty, membrane.modulus_samples), MPA),
    **dict.fromkeys((membrane.disc_modulus, membrane.model_moduli), MPA),
    **dict.fromkeys((membrane.dimple_depth, membrane.dimple_profile, membrane.steepest_depth), UM),
    membrane.indentation_force: UN,
    membrane.mean_strain: 1.0,
    **dict.fromkeys((membrane.indent_disc, membrane.indent_capsule), STATE),
    membrane.capsule_modulus: {"modulus": MPA, "state": STATE},
}


def refused(numbers: list, *positive: str) -> dict:
    """Return what a formula of lengths refuses; `numbers` is what is no number to it."""
    names = ("rim_radius", "dimple_depth", "thickness", "probe_half_width", *positive)
    film = {"poisson_ratio": [*numbers, -1, 0.6], "force": [*numbers, -1]}
    return film | {name: [*numbers, 0, -1] for name in names}


ARRAYS, NUMBERS = refused(BROKEN, "modulus"), refused(NO_NUMBER, "modulus", "capsule_radius")
VALUES = pressed(1.0, 1.0)
#: What is refused in place of each argument, beside `ARRAYS` or `NUMBERS`.
REFUSED = {
    membrane.elastic_modulus: {
        "rim_radius": [*BROKEN, 0, -1, 10.0],
        "probe_half_width": [*BROKEN, 0, -1, A],
    },
    membrane.finite_slope_modulus: {"probe_half_width": [*NOT_POSITIVE, 300.0]},
    membrane.dimple_profile: {
        "radius": lambda valid: [*not_finite(valid), np.zeros(3), -valid, [10.0]]
    },
    membrane.modulus_uncertainty: {
        "values": [{"force": 1.0}, VALUES | {"force": np.nan}],
        "uncertainties": [
            Wrong({"mass": 1.0}, "mass"),
            Wrong({"force": np.nan}, "force"),
            Wrong({"dimple_depth": 1.0}, "dimple_covariance"),
        ],
        "dimple_covariance": lambda valid: [*no_map(valid), np.eye(3)],
    },
    membrane.modulus_samples: {
        "rng": NEGATIVE,
        "uncertainties": [Wrong({"poisson_ratio": 1e5}, "poisson_ratio")],
    },
    membrane.indent_disc: {
        "force": [*NEGATIVE, 5e3],
        "pressure": NEGATIVE,
        "pretension": NEGATIVE,
        "probe_half_width": [*NOT_POSITIVE, A],
        "poisson_ratio": [*NEGATIVE, 0.4],
    },
    membrane.disc_modulus: {"pressure": NEGATIVE, "pretension": NEGATIVE},
    membrane.indent_capsule: {
        "inflation": [*NOT_POSITIVE, 0.9],
        "probe_half_width": [*NOT_POSITIVE, R],
    },
    membrane.capsule_modulus: {
        "rim_radius": [*NOT_POSITIVE, 10.0, R],
        "depth": [*NOT_POSITIVE, 1300.0, 500.0, 0.01],
    },
}
#: Formulas that work on arrays.
ELEMENTWISE = [
    membrane.elastic_modulus,
    membrane.indentation_force,
    membrane.dimple_depth,
    membrane.membrane_stress,
    membrane.mean_strain,
]


@each_call
def test_call_gives_the_same_for_the_same_numbers(function):
    hold_call(function, lambda: CALLS[function](1.0, 1.0), exact=("poisson_ratio",))


@each_call
def test_results_follow_units_of_length_and_force(function):
    found, plain = function(**CALLS[function](UM, UN)), function(**CALLS[function](1.0, 1.0))
    factor = FACTORS[function]
    known = factor if isinstance(factor, dict) else {"factor": factor}
    hold_scaled(found, plain, within=1e-6, **known)  # large deflections are solved to 1e-6


@each_call
def test_wrong_arguments_are_refused_by_name(function):
    given = CALLS[function](1.0, 1.0)
    arrays = function in (*ELEMENTWISE, membrane.dimple_profile)
    wrong = (ARRAYS if arrays else NUMBERS) | REFUSED.get(function, {})
    hold_refused(function, given, {name: wrong[name] for name in given if name in wrong})


@pytest.mark.parametrize("function", ELEMENTWISE, ids=lambda f: f.__name__)
def test_scalars_give_a_scalar_and_arrays_an_array(function):
    given = CALLS[function](1.0, 1.0)
    one = function(**given)
    assert isinstance(one, float)
    radius = A * np.array([[1.0], [1.1], [1.2]])
    several = function(**given | {"probe_half_width": [17.0, 30.0], "rim_radius": radius})
    assert isinstance(several, np.ndarray)
    assert several.shape == (3, 2)
    assert several[0, 0] == pytest.approx(one, rel=1e-12)


def test_moduli_of_models_are_those_of_their_functions():
    """Of the dimple of Table 5.6."""
    sizes = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}
    deep = model_moduli(197.24, 246.95, 121.22, **sizes, capsule_radius=600.0)
    by_hand = capsule_modulus(197.24, 246.95, 121.22, **sizes, capsule_radius=600.0)
    assert deep["point load"] == elastic_modulus(197.24, 246.95, 121.22, **sizes)
    assert deep["capsule, neo-hooke"] == pytest.approx(by_hand.modulus)
    # No capsule of this radius has the dimple, and a probe as wide as the dimple is an error.
    without = model_moduli(197.24, 246.95, 121.22, **sizes, capsule_radius=250.0)
    assert set(without) == {name for name in deep if not name.startswith("capsule")}
