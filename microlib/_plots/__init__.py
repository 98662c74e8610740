"""Plots of results by Matplotlib, which is imported only when a plot is drawn."""

from microlib._plots._axes import default_style
from microlib._plots._calibration import marks, micrometers
from microlib._plots._embryo import outline
from microlib._plots._focus import maps
from microlib._plots._tracking import path

__all__ = ["default_style", "maps", "marks", "micrometers", "outline", "path"]
