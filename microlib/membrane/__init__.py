"""The membrane of chapter 4 under a point load: force, dimple, stress and modulus (4.1–4.7)."""

from microlib.membrane._finite_slope import finite_slope_modulus, steepest_depth
from microlib.membrane._point_load import (
    SMALL_SLOPE_LIMIT,
    ModulusSensitivity,
    SmallSlopeWarning,
    areal_strain,
    dimple_depth,
    dimple_profile,
    elastic_modulus,
    indentation_force,
    mean_strain,
    membrane_stress,
    modulus_sensitivity,
)
from microlib.membrane._uncertainty import modulus_samples, modulus_std

__all__ = [
    "SMALL_SLOPE_LIMIT",
    "ModulusSensitivity",
    "SmallSlopeWarning",
    "areal_strain",
    "dimple_depth",
    "dimple_profile",
    "elastic_modulus",
    "finite_slope_modulus",
    "indentation_force",
    "mean_strain",
    "membrane_stress",
    "modulus_samples",
    "modulus_sensitivity",
    "modulus_std",
    "steepest_depth",
]
