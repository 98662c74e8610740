"""The picture of each result, by Matplotlib, which is imported when one is asked for."""

from microlib._plots import _calibration, _embryo, _focus, _tracking
from microlib._plots._axes import default_style, in_default_style

maps, marks = in_default_style(_focus.maps), in_default_style(_calibration.marks)
outline, path = in_default_style(_embryo.outline), in_default_style(_tracking.path)

__all__ = ["default_style", "maps", "marks", "outline", "path"]
