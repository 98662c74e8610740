"""Elastic modulus of a chorion from an image of the indented embryo."""

import microlib._common._opencv  # noqa: F401 – its error explains how to install it
from microlib.embryo._boundary import extract_boundary
from microlib.embryo._dimple import dimple_geometry, fit_dimple
from microlib.embryo._gaussian_sum import GaussianSum, fit_gaussians
from microlib.embryo._loess import loess
from microlib.embryo._modulus import modulus_from_image
from microlib.embryo._outline import dimple_from_outline, read_outline

__all__ = [
    "GaussianSum",
    "dimple_from_outline",
    "dimple_geometry",
    "extract_boundary",
    "fit_dimple",
    "fit_gaussians",
    "loess",
    "modulus_from_image",
    "read_outline",
]
