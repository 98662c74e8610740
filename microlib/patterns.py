"""Calibration targets: render them through a microscope, find them in an image.

The parts live in :mod:`microlib.pattern_rendering`, :mod:`microlib.circle_detection`,
:mod:`microlib.square_detection` and :mod:`microlib.grid_order`; this is where to import them from.
"""

from microlib.circle_detection import detect_circles
from microlib.detection import Detection
from microlib.grid_order import order_grid
from microlib.pattern_rendering import Imaging, render_circles, render_squares
from microlib.square_detection import detect_squares

__all__ = [
    "Detection",
    "Imaging",
    "detect_circles",
    "detect_squares",
    "order_grid",
    "render_circles",
    "render_squares",
]
