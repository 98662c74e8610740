"""Elastic modulus of a chorion from an image of the indented embryo."""

import microlib._common._opencv  # noqa: F401 – its error explains how to install it
from microlib.embryo._boundary import Boundary, extract_boundary
from microlib.embryo._dimple import DimpleFit, DimpleGeometry, dimple_geometry, fit_dimple
from microlib.embryo._gaussian_sum import GaussianSum, fit_gaussians
from microlib.embryo._loess import loess
from microlib.embryo._modulus import ImageEstimate, modulus_from_image
from microlib.embryo._outline import (
    OutlineDimple,
    OutlineTable,
    dimple_from_outline,
    read_outline,
)
from microlib.embryo._probe import Probe
from microlib.embryo._rotation import Rotation

__all__ = [
    "Boundary",
    "DimpleFit",
    "DimpleGeometry",
    "GaussianSum",
    "ImageEstimate",
    "OutlineDimple",
    "OutlineTable",
    "Probe",
    "Rotation",
    "dimple_from_outline",
    "dimple_geometry",
    "extract_boundary",
    "fit_dimple",
    "fit_gaussians",
    "loess",
    "modulus_from_image",
    "read_outline",
]
