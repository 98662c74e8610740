"""Calibration of a microscope: find a pattern in an image, fit the model of chapter 2 to it."""

import microlib._common._opencv  # noqa: F401 – says how to install it
from microlib.calibration._calibrate import calibrate
from microlib.calibration._calibration import Calibration, ErrorSummary
from microlib.calibration._detection import Detection
from microlib.calibration._linear import linear_intrinsics, radial_alignment
from microlib.calibration._stage import StageAffine, stage_affine
from microlib.calibration.detection._detect import (
    detect_charuco,
    detect_circles,
    detect_micrometer,
    detect_pattern,
    detect_squares,
)
from microlib.calibration.detection._micrometer import Micrometer

__all__ = [
    "Calibration",
    "Detection",
    "ErrorSummary",
    "Micrometer",
    "StageAffine",
    "calibrate",
    "detect_charuco",
    "detect_circles",
    "detect_micrometer",
    "detect_pattern",
    "detect_squares",
    "linear_intrinsics",
    "radial_alignment",
    "stage_affine",
]
