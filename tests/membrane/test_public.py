"""The calls of every public function of the membranes: their units and what they refuse."""

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
import pytest

from microlib import membrane
from microlib.membrane import capsule_modulus, disc_modulus, elastic_modulus, model_moduli
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
WALL = {"thickness": 2.6, "probe_half_width": 17.0}
FILM = {**WALL, "poisson_ratio": 0.31}
GEOMETRY = {"rim_radius": A, "dimple_depth": 19.0, "probe_half_width": 17.0}
VALUES = {"force": 43.0, **GEOMETRY, **FILM}
ERRORS = {"force": 2.0, "thickness": 0.2, "poisson_ratio": 0.02}
COVARIANCE = np.array([[9.0, 0.8], [0.8, 0.2]])
DENTED = {"force": 91.0, "rim_radius": 190.0}

#: A valid call of each function, in µm, µN and MPa.
CALLS: dict[Callable[..., Any], dict[str, Any]] = {
    membrane.elastic_modulus: VALUES,
    membrane.finite_slope_modulus: VALUES,
    membrane.indentation_force: {"modulus": 0.7, **GEOMETRY, **FILM},
    membrane.dimple_depth: {"force": 43.0, "rim_radius": A, "modulus": 0.7, **FILM},
    membrane.dimple_profile: {"radius": np.array([20.0, 90.0, 200.0]), **GEOMETRY},
    membrane.membrane_stress: {"force": 43.0, **GEOMETRY, **WALL},
    membrane.mean_strain: {**GEOMETRY, "small_slopes": False},
    membrane.steepest_depth: {"rim_radius": A, "probe_half_width": 17.0},
    membrane.modulus_uncertainty: {
        "values": VALUES, "uncertainties": ERRORS, "dimple_covariance": COVARIANCE,
    },
    membrane.modulus_samples: {"values": VALUES, "uncertainties": ERRORS, "size": 7, "rng": 3},
    membrane.indent_disc: {
        "force": 91.0, "modulus": 0.7, "rim_radius": A, **WALL, **RUBBER,
        "pressure": 2.1e-4, "pretension": 0.03,
    },
    membrane.disc_modulus: {
        "force": 91.0, "rim_radius": A, "depth": 50.0, **WALL, **STEEL,
        "pressure": 3e-4, "pretension": 0.0,
    },
    membrane.model_moduli: {**DENTED, "dimple_depth": 70.0, **FILM, "capsule_radius": R},
    membrane.indent_capsule: {
        "force": 91.0, "modulus": 0.7, "capsule_radius": R, **WALL, **RUBBER, "inflation": 1.04,
    },
    membrane.capsule_modulus: {**DENTED, "depth": 70.0, "capsule_radius": R, **WALL, **STEEL},
}  # fmt: skip
each_call = pytest.mark.parametrize("function", CALLS, ids=lambda f: f.__name__)

#: Other units of length and force, in which all are below 1, and that of a modulus in them.
UM, UN = 0.0015, 0.003
MPA = UN / UM**2
LENGTH = ("rim_radius", "dimple_depth", "depth", "radius", "capsule_radius", *WALL)
#: By what each argument that has a unit is multiplied.
UNITS = dict.fromkeys(LENGTH, UM) | {"force": UN, "dimple_covariance": UM**2}
UNITS |= dict.fromkeys(("modulus", "pressure"), MPA)
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
    film = {"poisson_ratio": [*numbers, -1, 0.6, [0.3, -1.4], [0.6, 0.3]], "force": [*numbers, -1]}
    return film | {name: [*numbers, 0, -1] for name in names}


ARRAYS, NUMBERS = refused(BROKEN, "modulus"), refused(NO_NUMBER, "modulus", "capsule_radius")
#: What is refused in place of each argument, beside `ARRAYS` or `NUMBERS`.
REFUSED = {
    membrane.elastic_modulus: {
        "rim_radius": [*BROKEN, 0, -1, Wrong([16.0, 10.0, 300.0], "got 17 and 10 µm")],
        "probe_half_width": [*BROKEN, 0, -1, A, Wrong([10.0, 300.0, 20.0], "got 300 and 213 µm")],
    },
    membrane.finite_slope_modulus: {"probe_half_width": [*NOT_POSITIVE, 300.0]},
    membrane.dimple_profile: {
        "radius": lambda valid: [
            *(*not_finite(valid), np.zeros(3), -valid, [10.0], Wrong([90.0, 250.0], "got 250 µm")),
        ]
    },
    membrane.modulus_uncertainty: {
        "values": [{"force": 1.0}, VALUES | {"force": np.nan}],
        "uncertainties": [
            Wrong({"mass": 1.0}, "mass"),
            Wrong({"force": np.nan}, "force"),
            *(Wrong({name: 1.0}, "dimple_covariance") for name in ("rim_radius", "dimple_depth")),
        ],
        "dimple_covariance": lambda valid: [
            *(*no_map(valid), np.eye(3), -np.eye(2), [[1.0, 5.0], [5.0, 1.0]]),
            [[1.0, 0.2], [0.9, 1.0]],
        ],
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


def in_other_units(given: dict[str, Any]) -> dict[str, Any]:
    """Return the same arguments in the other units, also those in a mapping."""
    inside = {name: in_other_units(each) for name, each in given.items() if isinstance(each, dict)}
    return given | inside | {name: given[name] * UNITS[name] for name in given.keys() & UNITS}


@each_call
def test_call_gives_the_same_for_the_same_numbers(function):
    hold_call(function, lambda: deepcopy(CALLS[function]), exact=("poisson_ratio",))


@each_call
def test_results_follow_units_of_length_and_force(function):
    found, plain = function(**in_other_units(CALLS[function])), function(**CALLS[function])
    factor = FACTORS[function]
    known = factor if isinstance(factor, dict) else {"factor": factor}
    hold_scaled(found, plain, within=1e-6, **known)  # large deflections are solved to 1e-6


@each_call
def test_wrong_arguments_are_refused_by_name(function):
    given = CALLS[function]
    arrays = function in (*ELEMENTWISE, membrane.dimple_profile)
    wrong = (ARRAYS if arrays else NUMBERS) | REFUSED.get(function, {})
    hold_refused(function, given, {name: wrong[name] for name in given if name in wrong})


@pytest.mark.parametrize("function", ELEMENTWISE, ids=lambda f: f.__name__)
def test_scalars_give_a_scalar_and_arrays_an_array(function):
    given = CALLS[function]
    assert isinstance(function(**given), float)
    for name in [name for name, value in given.items() if isinstance(value, float)]:
        other = "rim_radius" if name == "probe_half_width" else "probe_half_width"
        columns, rows = given[name] * np.array([1.0, 1.1]), given[other] * np.array([1.0, 1.1, 1.2])
        wanted = [[function(**given | {name: x, other: y}) for x in columns] for y in rows]
        found = function(**given | {name: columns, other: rows[:, None]})
        np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_moduli_of_models_are_those_of_their_functions():
    """Of the dimple of Table 5.6."""
    dimple, sizes = (197.24, 246.95, 121.22), {"thickness": 3.0, "probe_half_width": 25.0}
    found = model_moduli(*dimple, **sizes, poisson_ratio=0.3, capsule_radius=600.0)
    wanted = {"point load": elastic_modulus(*dimple, **sizes, poisson_ratio=0.3)}
    for law, ratio in (("neo-hooke", 0.5), ("hooke", 0.3)):
        wall = {**sizes, "law": law, "poisson_ratio": ratio}
        wanted[f"disc, {law}"] = disc_modulus(*dimple, **wall)
        wanted[f"disc, {law}, no pressure"] = disc_modulus(*dimple, **wall, pressure=0)
        capsule = capsule_modulus(*dimple, **wall, capsule_radius=600.0)
        wanted[f"capsule, {law}"] = capsule.modulus
    assert found == pytest.approx(wanted)
    # No capsule of this radius has the dimple, and a probe as wide as the dimple is an error.
    without = model_moduli(*dimple, **sizes, poisson_ratio=0.3, capsule_radius=250.0)
    assert without == {name: E for name, E in found.items() if not name.startswith("capsule")}
