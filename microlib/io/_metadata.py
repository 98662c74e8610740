"""Physical sizes and positions from the metadata of TIFF, OME-Zarr and labeled arrays, in µm."""

from __future__ import annotations

import warnings
from typing import Any
from xml.etree.ElementTree import ParseError

import numpy as np
import tifffile

from microlib._common import MICROMETERS, Array
from microlib.io._source import Choice


def tiff_scale(
    tiff: tifffile.TiffFile, name: str, count: int, choice: Choice
) -> tuple[float | None, Array | None]:
    """Return the side of a square pixel, µm/px, and the position of each of `count` frames, µm.

    None where neither OME or ImageJ metadata nor a resolution in centimeters contain them.
    """
    if tiff.is_ome and tiff.ome_metadata:
        return _ome(tiff.ome_metadata, name, count, choice)
    page = tiff.pages[0].aspage()
    tagged = "XResolution" in page.tags and "YResolution" in page.tags
    sides = [1 / per if per else np.nan for per in (page.get_resolution() if tagged else (0, 0))]
    if tiff.is_imagej and (about := tiff.imagej_metadata):
        # An axis without a unit of its own has that of x.
        units = [str(about.get(key, about.get("unit"))).lower() for key in ("yunit", "zunit")]
        x, y = _length(sides[0], str(about.get("unit")).lower()), _length(sides[1], units[0])
        return _square(x, y, name), _steps(abs(_length(about.get("spacing"), units[1])), count)
    if page.resolutionunit != tifffile.RESUNIT.CENTIMETER:
        return None, None
    x, y = (_length(side, "cm") for side in sides)
    # Up to 1200 dots per inch it is a printer's resolution, which software writes unasked.
    return None if x > 20 else _square(x, y, name), None


def _ome(text: str, name: str, count: int, choice: Choice) -> tuple[float | None, Array | None]:
    try:
        images = _listed(tifffile.xml2dict(text)["OME"]["Image"])
        pixels = images[choice.get("series", 0)]["Pixels"]
        planes = _listed(pixels.get("Plane", []))
    except (ParseError, LookupError, TypeError, AttributeError):
        return None, None
    sizes = [f"PhysicalSize{axis}" for axis in "XYZ"]
    x, y, z = (_length(pixels.get(key), pixels.get(f"{key}Unit", "µm")) for key in sizes)
    size, steps = _square(x, y, name), _steps(z, count)
    wanted = choice.get("channel", 0), choice.get("time", 0)
    planes = [each for each in planes if (each.get("TheC", 0), each.get("TheT", 0)) == wanted]
    planes.sort(key=lambda plane: plane.get("TheZ", 0))
    stated = [(plane.get("PositionZ"), plane.get("PositionZUnit")) for plane in planes]
    positions = np.array([_length(value, unit or "µm") for value, unit in stated])
    gaps = np.diff(positions)
    complete = [plane.get("TheZ", 0) for plane in planes] == list(range(count)) and count > 1
    if not complete or not ((gaps > 0).all() or (gaps < 0).all()):
        return size, steps
    apart = float(abs(gaps.mean()))
    agree = abs(apart - z) <= 0.1 * z
    # Without a unit, OME's positions are in one of the microscope's own.
    used = positions if agree or all(unit for _, unit in stated) else steps
    if steps is not None and not agree:
        which = "former" if used is positions else "latter"
        both = f"positions of planes {apart:g} µm apart and a spacing of {z:g} µm"
        warnings.warn(f"{name} has {both}: the {which} is used", stacklevel=2)
    return size, used


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _length(value: Any, unit: object) -> float:
    try:
        return float(value) * MICROMETERS.get(str(unit), np.nan)
    except (TypeError, ValueError):
        return np.nan


def _square(x: float, y: float, name: str) -> float | None:
    """Return the side of a pixel, None if its sides differ by more than one in a thousand."""
    if not (0 < x < np.inf and 0 < y < np.inf):
        return None
    if abs(y - x) > 1e-3 * x:
        warnings.warn(f"{name} has pixels of {x:g}×{y:g} µm, which are not square", stacklevel=2)
        return None
    return float(x)


def _steps(spacing: float, count: int) -> Array | None:
    return spacing * np.arange(count, dtype=float) if spacing and np.isfinite(spacing) else None


def labels_scale(
    frames: Any, dims: tuple[Any, ...]
) -> tuple[float | None, Array | None, tuple[float, float]]:
    """Return pixel size, positions and origin, µm, from an xarray.DataArray's coordinates."""
    z, y, x = (_coordinate(frames, dim) for dim in dims)
    if x is None or y is None or min(len(x), len(y)) < 2:
        return None, z, (0.0, 0.0)
    even = all(np.allclose(np.diff(c), c[1] - c[0], rtol=1e-3, atol=0.0) for c in (x, y))
    size = _square(np.diff(x).mean(), np.diff(y).mean(), "frames") if even else None
    return size, z, (float(x[0]), float(y[0])) if size else (0.0, 0.0)


def _coordinate(frames: Any, dim: Any) -> Array | None:
    """Return a coordinate in µm; None if there is none, or if it is the number of the pixel."""
    if dim not in frames.coords:
        return None
    values, unit = frames.coords[dim].values, frames.coords[dim].attrs.get("units")
    if values.dtype.kind not in "uif" or (unit is None and (np.diff(values) == 1).all()):
        return None
    factor = MICROMETERS.get("µm" if unit is None else str(unit))
    return None if factor is None else np.asarray(values, dtype=np.float64) * factor


def zarr_scale(
    image: dict[str, Any], axis: str, count: int, name: str
) -> tuple[float | None, Array | None]:
    """Return pixel size and positions, µm, from the metadata of an OME-Zarr image of full size."""
    changes = [
        *image["datasets"][0].get("coordinateTransformations", []),
        *image.get("coordinateTransformations", []),
    ]
    scales = np.prod([change["scale"] for change in changes if "scale" in change], axis=0)
    steps = {
        axis["name"]: _length(scale, axis.get("unit"))
        for axis, scale in zip(image["axes"], scales, strict=True)
    }
    z = steps.get("z", np.nan) if axis == "Z" else np.nan
    return _square(steps["x"], steps["y"], name), _steps(z, count)
