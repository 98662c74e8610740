"""The default method of `depth_from_focus`, which goes beyond the thesis.

It finds peaks at several scales, rejects some and refines the others.
"""

from microlib.focus.multiscale._depth import multiscale_depth

__all__ = ["multiscale_depth"]
