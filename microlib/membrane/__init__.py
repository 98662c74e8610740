"""Elastic modulus of a membrane from the dimple that a probe makes.

The top level of this package is the method of the thesis: the point-load model (4.1)–(4.7) and
(5.2), its correction for finite slopes, and its uncertainty. The sub-package `large` goes beyond
the thesis: it solves discs and capsules at any depth.

The point load assumes a uniform stress, which no clamped membrane has. `model_moduli` computes the
modulus of one dimple by all models. The :ref:`table of models <which-model>` says which of them
suits which dimple.

The table says which function is for which membrane. Its last column gives the difference of the
modulus of (5.2), `elastic_modulus`, from the modulus of that function, measured at c/a = 0.1 and
ν = 0.5. w_d/a is the relative depth of the dimple.

====================================  ==========================  =================================
membrane                              function                    difference of (5.2)
====================================  ==========================  =================================
uniform stress and small slopes,      `elastic_modulus`,          none
w_d/a ≤ 0.1 (the thesis' model)       `indentation_force`
uniform stress and finite slopes,     `finite_slope_modulus`      −1 % at w_d/a = 0.05, −5 % at
w_d/a ≤ 0.25 (`steepest_depth`)                                   0.1, −20 % at 0.2
flat disc with a clamped rim and the  `disc_modulus`,             +143 to 146 % at 0.1, +124 to
pressure F/(π a²) below it            `indent_disc`               136 % at 0.2, +41 to 83 % at
                                                                  0.49, depending on the law
the same disc over an open hole       `disc_modulus` with         +48 % at 0.1, +39 to 45 % at
                                      ``pressure=0``              0.2, −2 to +21 % at 0.49
closed, fluid-filled capsule such as  `capsule_modulus`,          +35 to 520 % at 0.25, −27 to
an egg, of known rim, depth and       `indent_capsule`            +102 % at 0.49 (R = 600 µm,
radius                                                            h = 3 µm, inflation 1 to 8 %);
                                                                  +16 to 51 % for the dimple of
                                                                  the thesis
====================================  ==========================  =================================

A depth at which a model has no equilibrium raises a `ValueError` in every function. The formulas of
the thesis have a value at every depth, and warn with a `SmallSlopeWarning` where w_d/a exceeds 0.1.
`elastic_modulus`, `finite_slope_modulus`, and `disc_modulus` without pretension reject a depth
below the thickness, where bending carries most of the force.
`modulus_uncertainty` and `modulus_samples` compute the error of (5.2) that follows from the errors
of its inputs.
"""

from microlib.membrane._finite_slope import finite_slope_modulus, steepest_depth
from microlib.membrane._point_load import (
    SmallSlopeWarning,
    dimple_depth,
    dimple_profile,
    elastic_modulus,
    indentation_force,
    mean_strain,
    membrane_stress,
)
from microlib.membrane._uncertainty import modulus_samples, modulus_uncertainty
from microlib.membrane.large._capsule import CapsuleModulus, capsule_modulus, indent_capsule
from microlib.membrane.large._disc import disc_modulus, indent_disc
from microlib.membrane.large._models import model_moduli
from microlib.membrane.large._solver import MembraneState

__all__ = [
    "CapsuleModulus",
    "MembraneState",
    "SmallSlopeWarning",
    "capsule_modulus",
    "dimple_depth",
    "dimple_profile",
    "disc_modulus",
    "elastic_modulus",
    "finite_slope_modulus",
    "indent_capsule",
    "indent_disc",
    "indentation_force",
    "mean_strain",
    "membrane_stress",
    "model_moduli",
    "modulus_samples",
    "modulus_uncertainty",
    "steepest_depth",
]
