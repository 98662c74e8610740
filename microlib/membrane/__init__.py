"""The membrane of chapter 4 under a point load: force, dimple, stress and modulus (4.1–4.7)."""

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
from microlib.membrane._uncertainty import modulus_samples, modulus_std

__all__ = [
    "SmallSlopeWarning",
    "dimple_depth",
    "dimple_profile",
    "elastic_modulus",
    "finite_slope_modulus",
    "indentation_force",
    "mean_strain",
    "membrane_stress",
    "modulus_samples",
    "modulus_std",
    "steepest_depth",
]
