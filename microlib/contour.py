"""From an image to a dimple, step by step, under one roof.

1. `extract_boundary` finds the probe and follows the upper outline of the embryo
   (`microlib.boundary`).
2. `loess` smooths it and `fit_gaussians` describes it by eight Gaussians, (5.1), as the thesis does
   (`microlib.loess`, `microlib.gaussian_sum`).
3. `dimple_geometry` reads radius and depth off that curve, (5.3); `fit_dimple` finds them without
   it, from the membrane's own profile (4.2) (`microlib.dimple`).

`microlib.characterization` puts the steps together.
"""

from microlib.boundary import Boundary, Probe, extract_boundary, find_probe, remove_probe
from microlib.dimple import DimpleFit, DimpleGeometry, dimple_geometry, fit_dimple
from microlib.gaussian_sum import GaussianSum, fit_gaussians
from microlib.loess import loess

__all__ = [
    "Boundary",
    "DimpleFit",
    "DimpleGeometry",
    "GaussianSum",
    "Probe",
    "dimple_geometry",
    "extract_boundary",
    "find_probe",
    "fit_dimple",
    "fit_gaussians",
    "loess",
    "remove_probe",
]
