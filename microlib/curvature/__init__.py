"""Mean and Gaussian curvature of a height map, the surface types and the parts they tell apart.

Heights point to the viewer, so a dome has H < 0 and K > 0 (Table 3.1). Heights and `pixel_size`
share one unit, here µm; H is then in 1/µm and K in 1/µm².
"""

from microlib.curvature import _labels, _recognition
from microlib.curvature._labels import clean_labels, hk_labels, region_table
from microlib.curvature._recognition import recognize_part
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

#: Table 3.1: the surface type of each label. A smooth surface has H² ≥ K, so label 4 (H = 0 and K
#: > 0) cannot occur but through noise or thresholds that do not match.
HK_NAMES = _labels.HK_NAMES
#: What `recognize_part` can name: a ball or its cap, a rod or its cap, a cone, a plane, a saddle
#: and a straight step.
PART_KINDS = _recognition.PART_KINDS
