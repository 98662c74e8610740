"""What the method of the thesis and the default method share.

Nothing in this folder refers to either of them.
"""

from microlib.focus.common._bands import Band, bands
from microlib.focus.common._depth_map import END_REACH, DepthMap, Frame
from microlib.focus.common._filters import TINY, blur, doubled, halved, ratio
from microlib.focus.common._planes import smooth_planes
from microlib.focus.common._shape import peak_centers, shape_error
from microlib.focus.common._significance import peak_significance
from microlib.focus.common._threads import Spread, run_jobs

__all__ = [
    "END_REACH",
    "TINY",
    "Band",
    "DepthMap",
    "Frame",
    "Spread",
    "bands",
    "blur",
    "doubled",
    "halved",
    "peak_centers",
    "peak_significance",
    "ratio",
    "run_jobs",
    "shape_error",
    "smooth_planes",
]
