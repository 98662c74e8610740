"""The default method of `depth_from_focus`: peaks at several scales, rejected and refined."""

from microlib.focus.multiscale._blocks import depth_in_blocks, is_in_blocks
from microlib.focus.multiscale._depth import multiscale_depth

__all__ = ["depth_in_blocks", "is_in_blocks", "multiscale_depth"]
