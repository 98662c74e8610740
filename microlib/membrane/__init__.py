"""Membranes under a probe: the thesis' point load (4.1–4.7, 5.2), discs and capsules.

Which function is for which dimple, by its relative depth w_d/a, and how far the modulus of (5.2),
`elastic_modulus`, is from that function's, at c/a = 0.1 and ν = 0.5 (measured):

=============================================  ==========================  =======================
the membrane                                   its function                (5.2) beside it
=============================================  ==========================  =======================
the thesis' own: one stress everywhere, small  `elastic_modulus`,          –
slopes, w_d/a up to 0.1                        `indentation_force`
the same stress, but slopes that are not       `finite_slope_modulus`      −1 % at w_d/a = 0.05,
small; up to `steepest_depth`, w_d/a = 0.25                                −5 % at 0.1, −20 % at
                                                                           0.2
a flat disc, clamped at its rim, with the      `disc_modulus`,             +143 to 146 % at 0.1,
pressure F/(π a²) below it, at any depth       `indent_disc`               +124 to 136 % at 0.2,
                                                                           +41 to 83 % at 0.49, by
                                                                           law
the same disc over an open hole                `disc_modulus(…,            +48 %, +39 to 45 %, −2 to
                                               pressure=0)`                21 %
a closed capsule full of fluid, such as an     `capsule_modulus`,          +35 to 520 % at 0.25,
egg: rim, depth and radius are known           `indent_capsule`            −27 to +102 % at 0.49,
                                                                           for R = 600 µm, h =
                                                                           3 µm, inflated by 1 to
                                                                           8 %; +16 to 51 % for
                                                                           the thesis' dimple
the same, of which the outline is known        `fit_capsule`               as above
=============================================  ==========================  =======================

The first three lines are one model with its slopes small or whole; a stress that is the same at all
radii is an assumption that no clamped disc meets. `modulus_std` and `modulus_samples` give the
error of (5.2) that its inputs make, and `viscoelastic_force` the force of a wall that relaxes.
"""

from microlib.membrane._capsule import capsule_modulus, indent_capsule
from microlib.membrane._disc import disc_modulus, indent_disc
from microlib.membrane._finite_slope import finite_slope_modulus, steepest_depth
from microlib.membrane._outline import fit_capsule
from microlib.membrane._point_load import (
    SmallSlopeWarning,
    dimple_depth,
    dimple_profile,
    elastic_modulus,
    indentation_force,
    mean_strain,
    membrane_stress,
)
from microlib.membrane._uncertainty import modulus_samples, modulus_std
from microlib.membrane._viscoelastic import viscoelastic_force

__all__ = [
    "SmallSlopeWarning",
    "capsule_modulus",
    "dimple_depth",
    "dimple_profile",
    "disc_modulus",
    "elastic_modulus",
    "finite_slope_modulus",
    "fit_capsule",
    "indent_capsule",
    "indent_disc",
    "indentation_force",
    "mean_strain",
    "membrane_stress",
    "modulus_samples",
    "modulus_std",
    "steepest_depth",
    "viscoelastic_force",
]
