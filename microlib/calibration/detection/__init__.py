"""From an image to marks on a lattice; its public functions are those of the package above."""

from microlib.calibration.detection._detect import (
    detect_charuco,
    detect_circles,
    detect_micrometer,
    detect_pattern,
    detect_squares,
)

__all__ = [
    "detect_charuco",
    "detect_circles",
    "detect_micrometer",
    "detect_pattern",
    "detect_squares",
]
