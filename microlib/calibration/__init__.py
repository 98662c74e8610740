"""Calibration of a microscope: find a pattern in an image, fit the model of chapter 2 to it."""

from microlib.calibration._calibrate import Calibration, calibrate
from microlib.calibration._circles import detect_circles
from microlib.calibration._cramer_rao import cramer_rao
from microlib.calibration._detection import Detection
from microlib.calibration._micrometer import detect_micrometer
from microlib.calibration._radial_alignment import linear_intrinsics, radial_alignment
from microlib.calibration._squares import detect_squares
from microlib.calibration._stage import stage_affine

__all__ = [
    "Calibration",
    "Detection",
    "calibrate",
    "cramer_rao",
    "detect_circles",
    "detect_micrometer",
    "detect_squares",
    "linear_intrinsics",
    "radial_alignment",
    "stage_affine",
]
