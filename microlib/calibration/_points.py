"""Points of a pattern and their images: the arguments of `calibrate`, checked."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, as_array, check_same_length
from microlib.calibration._detection import Detection
from microlib.calibration._fit import Photographs
from microlib.microscope import pitch_pair, whole_size

#: Points whose extent in one direction is below this part of the other lie on one line.
_ON_ONE_LINE = 1e-6
#: Smallest extent of points, µm or px: of exact points on one line, rounding errors remain.
_SMALLEST = 1e-9


def plane_points(least: int, **named: ArrayLike) -> list[Array]:
    """Checked points (N, 2) and their images: at least `least`, and not on one line."""
    pairs = [as_array(name, points, shape=(None, 2)) for name, points in named.items()]
    check_same_length(tuple(named), *pairs)
    for name, points in zip(named, pairs, strict=True):
        if len(points) < least:
            raise ValueError(f"{name} must hold at least {least} points, got {len(points)}")
        triangle = np.linalg.qr(points - points.mean(axis=0), mode="r")
        extent = np.linalg.svd(triangle, compute_uv=False)
        if not extent[-1] > max(_ON_ONE_LINE * extent[0], _SMALLEST):
            raise ValueError(f"{name} must not lie on one line, got {len(points)} points that do")
    return pairs


def photographs_of(
    world: Any, image: Any, pitch: Any, image_size: Any, **camera: Any
) -> Photographs:
    """Points of each view, from the arguments of `calibrate`; `camera` has its other fields."""
    if isinstance(world, (list, tuple)) and not world:
        raise ValueError("world must hold at least one view, got an empty list")
    several = isinstance(world, (list, tuple)) and (
        isinstance(world[0], Detection) or np.ndim(world[0]) > 1
    )
    views = list(world) if several else [world]
    detections = [each for each in views if isinstance(each, Detection)]
    if not detections:
        if pitch is not None:
            raise ValueError("pitch must be left out with points in µm, got one")
        if several and (not isinstance(image, (list, tuple)) or len(image) != len(views)):
            raise ValueError(f"image must hold one array for each of the {len(views)} views")
        return _of_points(views, list(image) if several else [image], image_size, camera)
    if image is not None or image_size is not None:
        raise ValueError("image and image_size must not be given with a detection")
    if len(detections) < len(views):
        raise ValueError("world must hold either detections or points, got both")
    return _of_detections(detections, pitch, camera)


def _of_points(
    worlds: list[Any], images: list[Any], image_size: Any, camera: dict[str, Any]
) -> Photographs:
    if image_size is None:
        raise ValueError("image_size must be given, (width, height) in px, got none")
    size = whole_size(image_size)
    # Radial alignment has six unknowns up to scale and one equation for each point.
    pairs = [plane_points(5, world=w, image=i) for w, i in zip(worlds, images, strict=True)]
    for _, points in pairs:
        outside = ((points < -1) | (points > size)).any(axis=1)
        if outside.any():
            raise ValueError(
                f"image must lie in the image_size of (width, height) = {size} px, got "
                f"{int(outside.sum())} of {len(points)} points beyond it, one at "
                f"{points[outside][0]}"
            )
    return Photographs([w for w, _ in pairs], [i for _, i in pairs], size, **camera)


def _of_detections(detections: list[Detection], pitch: Any, camera: dict[str, Any]) -> Photographs:
    if pitch is None:
        raise ValueError("pitch must be given with a detection, µm from mark to mark, got none")
    pitch = pitch_pair("pitch", pitch)
    size = detections[0].image_size
    sizes = {f"{width}×{height}" for width, height in (each.image_size for each in detections)}
    if len(sizes) > 1:
        raise ValueError(
            f"world must hold detections in images of one size, got {' and '.join(sorted(sizes))} "
            "px: leave out the images of another size"
        )
    squares = any(len(np.unique(each.group)) < len(each.group) for each in detections)
    if squares:
        camera = camera | {"mark_places": np.concatenate([each.grid // 2 for each in detections])}
    worlds = [pitch * each.positions for each in detections]
    return _of_points(worlds, [each.points for each in detections], size, camera)
