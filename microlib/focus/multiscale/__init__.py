"""What goes beyond the thesis: the default method of `depth_from_focus`, and checks of peaks.

The default method finds peaks at several scales, rejects some and refines the others. Checks of the
significance and of the symmetry of peaks are applied to every measure.
"""

from microlib.focus.multiscale._depth import multiscale_depth
from microlib.focus.multiscale._significance import peak_significance
from microlib.focus.multiscale._symmetry import find_symmetry, shape_error

__all__ = [
    "find_symmetry",
    "multiscale_depth",
    "peak_significance",
    "shape_error",
]
