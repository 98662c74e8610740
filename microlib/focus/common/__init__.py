"""What the method of the thesis and the default method share.

Nothing in this folder refers to either of them.
"""

from microlib.focus.common._depth_map import DepthMap
from microlib.focus.common._filters import TINY, blur, doubled, halved, ratio
from microlib.focus.common._planes import Spread, smooth_planes
from microlib.focus.common._significance import peak_significance
from microlib.focus.common._symmetry import Symmetry, find_symmetry, shape_error

__all__ = [
    "TINY",
    "DepthMap",
    "Spread",
    "Symmetry",
    "blur",
    "doubled",
    "find_symmetry",
    "halved",
    "peak_significance",
    "ratio",
    "shape_error",
    "smooth_planes",
]
