"""A calibration in the terms of other programs."""

from __future__ import annotations

import json
from collections.abc import Sequence

import cv2
import numpy as np

from microlib._common import Array
from microlib.microscope import Microscope, distort

#: Radii at which the distortion is expressed as OpenCV does.
_RADII = 64


def to_json(
    views: Sequence[Microscope],
    axis: Array,
    second: float,
    pixel: tuple[float, float, float],
    sigma: dict[str, float],
) -> str:
    """Text in JSON that OpenCV, Micro-Manager and ImageJ take their numbers from.

    Parameters
    ----------
    views : sequence of Microscope
        One for each view.
    axis : ndarray, shape (2,)
        Where the optical axis meets the sensor, px.
    second : float
        Second term of the distortion, 1/µm⁴.
    pixel : tuple of float
        µm per px and the ends of its interval.
    sigma : dict
        Standard deviations by parameter.
    """
    scope = views[0]
    distance = (scope.tube_length + scope.focal_length) / scope.cell
    terms, worst = _brown(scope, second)
    camera = [[distance[0], 0.0, axis[0]], [0.0, distance[1], axis[1]], [0.0, 0.0, 1.0]]
    turns = [cv2.Rodrigues(view.rotation)[0].ravel().tolist() for view in views]
    moves = [[view.tx, view.ty, view.focal_length + view.distance] for view in views]
    content = {
        "opencv": {
            "image_width": scope.image_size[0],
            "image_height": scope.image_size[1],
            "camera_matrix": [[float(n) for n in row] for row in camera],
            "distortion_coefficients": terms,
            "distortion_model_error_px": worst,
            "rotation_vectors": turns,
            "translation_vectors_um": moves,
        },
        "micro_manager": {"PixelSizeUm": pixel[0]},
        "imagej": {"unit": "µm", "pixel_width": pixel[0], "pixel_height": pixel[0]},
        "pixel_size_interval_um": list(pixel[1:]),
        "standard_deviations": {k: v if np.isfinite(v) else None for k, v in sigma.items()},
    }
    return json.dumps(content, indent=2, ensure_ascii=False)


def _brown(scope: Microscope, second: float) -> tuple[list[float], float]:
    """OpenCV's k₁, k₂, p₁, p₂, k₃ for the model's distortion, and how far they are off, px.

    OpenCV's radius is in principal distances, from undistorted to distorted points, where the
    model's polynomial leads back.
    """
    distance = scope.tube_length + scope.focal_length
    corner = float(np.linalg.norm(scope.cell * scope.image_size)) / 2
    radius = np.linspace(0, corner, _RADII + 1)[1:]
    seen = distort(np.column_stack([radius, 0 * radius]), scope.distortion)[:, 0]
    stretch = seen / radius * (1 + second * seen**4) - 1
    reached = np.isfinite(stretch)
    powers = (radius[:, None] / corner) ** [2, 4, 6]
    best = np.linalg.lstsq(powers[reached] * radius[reached, None], (stretch * radius)[reached])[0]
    worst = np.abs((powers @ best - stretch) * radius)[reached].max() / scope.cell.min()
    k1, k2, k3 = (float(b) * (distance / corner) ** p for b, p in zip(best, (2, 4, 6), strict=True))
    return [k1, k2, 0.0, 0.0, k3], float(worst)
