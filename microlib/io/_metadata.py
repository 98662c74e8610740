"""Physical sizes and positions that TIFF files and labeled arrays carry, in µm."""

from __future__ import annotations

from typing import Any
from xml.etree.ElementTree import ParseError

import numpy as np
import tifffile

from microlib._common import Array

#: µm in the units that OME and ImageJ name; what is not here has no size, such as "pixel".
MICROMETERS = {
    "nm": 1e-3,
    **dict.fromkeys(("µm", "μm", "um", "\\u00b5m", "micron", "microns", "micrometer"), 1.0),
    "mm": 1e3,
    "cm": 1e4,
    "m": 1e6,
    "inch": 25400.0,
}


def tiff_scale(tiff: tifffile.TiffFile, count: int) -> tuple[float | None, Array | None]:
    """Return the side of a square pixel, µm/px, and the position of each of `count` frames, µm.

    None where the OME or ImageJ metadata, or a resolution in centimeters, do not tell.
    """
    if tiff.is_ome and tiff.ome_metadata:
        return _ome(tiff.ome_metadata, count)
    page = tiff.pages[0].aspage()
    in_cm = page.resolutionunit == tifffile.RESUNIT.CENTIMETER
    unit, spacing = MICROMETERS["cm"] if in_cm else np.nan, np.nan
    if tiff.is_imagej and (about := tiff.imagej_metadata):
        name = str(about.get("unit")).lower()
        unit, spacing = _micrometers(1, name), abs(_micrometers(about.get("spacing"), name))
    told = "XResolution" in page.tags and "YResolution" in page.tags
    x, y = (unit / per if per else np.nan for per in (page.get_resolution() if told else (0, 0)))
    return _square(x, y), _steps(spacing, count)


def _ome(text: str, count: int) -> tuple[float | None, Array | None]:
    try:
        image = tifffile.xml2dict(text)["OME"]["Image"]
        pixels = (image[0] if isinstance(image, list) else image)["Pixels"]
        planes = pixels.get("Plane", [])
    except (ParseError, KeyError, TypeError, AttributeError):
        return None, None
    planes = sorted(
        planes if isinstance(planes, list) else [planes], key=lambda plane: plane.get("TheZ", 0)
    )
    positions = np.array([_length(plane, "PositionZ") for plane in planes])
    gaps = np.diff(positions)
    each = [plane.get("TheZ", 0) for plane in planes] == list(range(count))
    one_way = np.isfinite(positions).all() and ((gaps > 0).all() or (gaps < 0).all())
    return (
        _square(_length(pixels, "PhysicalSizeX"), _length(pixels, "PhysicalSizeY")),
        positions if each and one_way else _steps(_length(pixels, "PhysicalSizeZ"), count),
    )


def _length(attributes: dict[str, Any], name: str) -> float:
    return _micrometers(attributes.get(name), attributes.get(f"{name}Unit", "µm"))


def _micrometers(value: Any, unit: object) -> float:
    try:
        return float(value) * MICROMETERS.get(str(unit), np.nan)
    except (TypeError, ValueError):
        return np.nan


def _square(x: float, y: float) -> float | None:
    """Return the side of a pixel, None if its sides differ by more than one in a thousand."""
    return float(x) if 0 < x < np.inf and abs(y - x) <= 1e-3 * x else None


def _steps(spacing: float, count: int) -> Array | None:
    return spacing * np.arange(count, dtype=float) if spacing and np.isfinite(spacing) else None


def labels_scale(frames: Any) -> tuple[float | None, Array | None, tuple[float, float]]:
    """Return pixel size, positions and origin, µm, as an xarray.DataArray's coordinates tell."""
    z, y, x = (_coordinate(frames, dim) for dim in frames.dims[:3])
    if x is None or y is None or min(len(x), len(y)) < 2:
        return None, z, (0.0, 0.0)
    steps = np.append(np.diff(x), np.diff(y))
    if not np.allclose(steps, steps[0], rtol=1e-3, atol=0.0) or steps[0] <= 0:
        return None, z, (0.0, 0.0)
    return float(steps.mean()), z, (float(x[0]), float(y[0]))


def _coordinate(frames: Any, dim: Any) -> Array | None:
    """Return a coordinate in µm; None if there is none, or if it is the number of the pixel."""
    if dim not in frames.coords:
        return None
    values, unit = frames.coords[dim].values, frames.coords[dim].attrs.get("units")
    if values.dtype.kind not in "uif" or (unit is None and (np.diff(values) == 1).all()):
        return None
    factor = MICROMETERS.get("µm" if unit is None else str(unit))
    return None if factor is None else np.asarray(values, dtype=np.float64) * factor
