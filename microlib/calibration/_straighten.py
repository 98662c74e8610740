"""Points and images of a calibrated lens, freed of its distortion."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, as_array
from microlib.calibration._several_views import without_terms
from microlib.microscope import Microscope, distort, undistort

#: A place that no pixel of an image is near, px.
_OUTSIDE = -9.0


def straighten_points(scope: Microscope, axis: Array, second: float, points: Array) -> Array:
    """Where points would be seen without distortion, px.

    Parameters
    ----------
    scope : Microscope
        With the sensor's cells and the first term of the distortion.
    axis : ndarray, shape (2,)
        Where the optical axis meets the sensor, px.
    second : float
        Second term of the distortion, 1/µm⁴.
    points : ndarray, shape (N, 2)
        px.
    """
    lens = np.array([0.0, 0.0, second, *axis])
    free = without_terms(lens, points, scope.cell) * scope.cell
    return undistort(free, scope.distortion) / scope.cell + axis


def straighten_image(
    scope: Microscope, axis: Array, second: float, image: ArrayLike
) -> NDArray[np.generic]:
    """Resample an image as the lens would show it without distortion, to the scale on the axis.

    Parameters as above; bicubic, and zero where the image does not reach.
    """
    width, height = scope.image_size
    array = as_array("image", image, dtype=np.float32)
    if array.ndim not in (2, 3) or array.shape[:2] != (height, width) or not array.size:
        raise ValueError(
            f"image must have the size of the calibration's, {width}×{height} px, got shape "
            f"{array.shape}"
        )
    y, x = np.mgrid[:height, :width].astype(np.float64)
    sensor = distort((np.stack([x, y], axis=-1) - axis) * scope.cell, scope.distortion)
    sensor *= 1 + second * (sensor**2).sum(axis=-1, keepdims=True) ** 2
    seen = np.nan_to_num(sensor / scope.cell + axis, nan=_OUTSIDE).astype(np.float32)
    straight = cv2.remap(array, seen[..., 0], seen[..., 1], cv2.INTER_CUBIC)
    kind = np.asarray(image).dtype
    if kind.kind not in "ui":
        return np.asarray(straight)
    limits = np.iinfo(kind)
    return np.clip(np.round(straight), limits.min, limits.max).astype(kind)
