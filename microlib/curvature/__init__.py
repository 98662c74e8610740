"""Mean and Gaussian curvature of a height map, the surface types and the parts they tell apart.

Heights point to the viewer, so a dome has H < 0 and K > 0 (Table 3.1). Heights and `pixel_size`
share one unit, here µm; H is then in 1/µm and K in 1/µm².
"""

from microlib.curvature._labels import HK_NAMES, clean_labels, hk_labels, region_table
from microlib.curvature._recognition import PART_KINDS, recognize_part
from microlib.curvature._surface import curvature_windows, surface_curvature

__all__ = [
    "HK_NAMES",
    "PART_KINDS",
    "clean_labels",
    "curvature_windows",
    "hk_labels",
    "recognize_part",
    "region_table",
    "surface_curvature",
]
