"""The membrane of chapter 4 under a point load (4.1–4.7), and discs and capsules at any depth."""

from microlib.membrane._bending import capsule_bending_force
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
    "capsule_bending_force",
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
