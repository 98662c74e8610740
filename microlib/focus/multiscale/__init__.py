"""The default method of `depth_from_focus`, which goes beyond the thesis.

It finds peaks at several scales, rejects some and refines the others.
"""

from microlib.focus.multiscale._depth import multiscale_depth
from microlib.focus.multiscale._rules import RULES
from microlib.focus.multiscale._settings import FocusSettings

__all__ = ["RULES", "FocusSettings", "multiscale_depth"]
