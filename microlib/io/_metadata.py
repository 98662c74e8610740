"""Physical sizes and positions that TIFF files carry, in µm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import tifffile

from microlib._common import Array

__all__ = ["Scale", "tiff_scale"]

#: µm in the units that OME and ImageJ name; what is not here has no size, such as "pixel".
_MICROMETERS = {
    "nm": 1e-3,
    "µm": 1.0,
    "μm": 1.0,
    "um": 1.0,
    "\\u00b5m": 1.0,
    "micron": 1.0,
    "microns": 1.0,
    "micrometer": 1.0,
    "mm": 1e3,
    "cm": 1e4,
    "m": 1e6,
    "inch": 25400.0,
}
#: Difference of the sides of a pixel from which on it has no one size.
_SQUARE = 1e-3
_CENTIMETER = 3


@dataclass(frozen=True)
class Scale:
    """Sizes that a file tells.

    Attributes
    ----------
    pixel_size : float or None
        Side of a square pixel, µm/px.
    positions : ndarray, shape (count,), or None
        Position of each frame along the optical axis, µm.
    """

    pixel_size: float | None = None
    positions: Array | None = None


def tiff_scale(tiff: tifffile.TiffFile, count: int) -> Scale:
    """Return the sizes in the OME or ImageJ metadata of a file with that many frames."""
    if tiff.is_ome and tiff.ome_metadata:
        return _ome(tiff.ome_metadata, count)
    if tiff.is_imagej and tiff.imagej_metadata:
        return _imagej(tiff.imagej_metadata, _per_pixel(tiff), count)
    page = tiff.pages[0].aspage()
    unit = page.tags.get("ResolutionUnit")
    size = None
    if unit is not None and unit.value == _CENTIMETER:
        size = _square(*(_MICROMETERS["cm"] * side for side in _per_pixel(tiff)))
    return Scale(size)


def _ome(text: str, count: int) -> Scale:
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError:
        return Scale()
    pixels = next((node for node in root.iter() if node.tag.endswith("}Pixels")), None)
    if pixels is None:
        return Scale()
    x, y, z = (_length(pixels.attrib, f"PhysicalSize{axis}") for axis in "XYZ")
    planes = [node for node in pixels if node.tag.endswith("}Plane")]
    at = [_length(plane.attrib, "PositionZ") for plane in planes]
    order = [int(plane.attrib.get("TheZ", 0)) for plane in planes]
    positions = None
    if len(at) == count and None not in at and sorted(order) == list(range(count)):
        positions = _monotonic(np.array(at, float)[np.argsort(order)])
    if positions is None and z:
        positions = z * np.arange(count, dtype=float)
    return Scale(_square(x or 0.0, y or 0.0), positions)


def _length(attributes: Mapping[str, str], name: str) -> float | None:
    unit = _MICROMETERS.get(attributes.get(f"{name}Unit", "µm"))
    try:
        value = float(attributes[name])
    except (KeyError, ValueError):
        return None
    return None if unit is None or not np.isfinite(value) else value * unit


def _imagej(metadata: Mapping[str, object], sides: tuple[float, float], count: int) -> Scale:
    unit = _MICROMETERS.get(str(metadata.get("unit", "")).lower())
    if unit is None:
        return Scale()
    try:
        spacing = abs(float(str(metadata.get("spacing", 0)))) * unit
    except ValueError:
        spacing = 0.0
    positions = spacing * np.arange(count, dtype=float) if spacing > 0 else None
    return Scale(_square(*(unit * side for side in sides)), positions)


def _per_pixel(tiff: tifffile.TiffFile) -> tuple[float, float]:
    """Return width and height of a pixel in the unit of the resolution, 0 where not known."""
    page = tiff.pages[0].aspage()
    sides = []
    for name in ("XResolution", "YResolution"):
        tag = page.tags.get(name)
        number, per = tag.value if tag is not None else (0, 1)
        sides.append(per / number if number else 0.0)
    return sides[0], sides[1]


def _square(x: float, y: float) -> float | None:
    good = x > 0 and np.isfinite(x) and abs(y - x) <= _SQUARE * x
    return float(x) if good else None


def _monotonic(z: Array) -> Array | None:
    gaps = np.diff(z)
    return z if (gaps > 0).all() or (gaps < 0).all() else None
