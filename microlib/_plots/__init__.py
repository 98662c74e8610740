"""The picture of each result, by Matplotlib, which is imported when one is asked for."""

from microlib._plots._calibration import marks
from microlib._plots._embryo import outline
from microlib._plots._focus import maps
from microlib._plots._tracking import path

__all__ = ["maps", "marks", "outline", "path"]
