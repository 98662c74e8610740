"""Pixel sizes, positions and times from the metadata of TIFF, in µm and s."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import suppress
from typing import Any
from xml.etree.ElementTree import ParseError

import numpy as np
import tifffile

from microlib._common import MICROMETERS, SOFTWARE, Array
from microlib.io._stack import Choice

#: Units of time in OME metadata, s.
_SECONDS = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "min": 60.0, "h": 3600.0}
#: What parsing of OME metadata raises that are missing or not as they should be.
_WRONG_XML = (ParseError, LookupError, TypeError, AttributeError)
#: Side of a square pixel, µm/px, and positions of the frames, µm; None where they are not known.
Scale = tuple[float | None, Array | None]


def tiff_scale(tiff: tifffile.TiffFile, name: str, count: int, choice: Choice) -> Scale:
    """Return the scale of `count` frames from OME or ImageJ metadata or from the resolution."""
    if tiff.is_ome:
        try:
            return _ome_scale(_ome_pixels(tiff, choice), name, count, choice)
        except _WRONG_XML:
            return None, None
    page = tiff.pages[0].aspage()
    tagged = "XResolution" in page.tags and "YResolution" in page.tags
    x, y = (1 / n if n else np.nan for n in (page.get_resolution() if tagged else (0, 0)))
    if tiff.is_imagej and (about := tiff.imagej_metadata):
        # An axis without a unit of its own has that of x.
        unit_x, unit_y, unit_z = (
            str(about.get(key, about.get("unit"))).lower() for key in ("unit", "yunit", "zunit")
        )
        step = _converted(about.get("spacing"), unit_z)
        size = _square(_converted(x, unit_x), _converted(y, unit_y), name)
        return size, _even_positions(step, count)
    if page.resolutionunit != tifffile.RESUNIT.CENTIMETER:
        return None, None
    x, y = _converted(x, "cm"), _converted(y, "cm")
    # Up to 1200 dots per inch it is a printer's resolution, which other software writes unasked.
    return None if x > 20 and page.software != SOFTWARE else _square(x, y, name), None


def tiff_times(tiff: tifffile.TiffFile, count: int, choice: Choice) -> Array | None:
    """Return the times of `count` frames along axis T since the first, s, if they are known."""
    interval, times = np.nan, np.empty(0)
    if tiff.is_ome:
        with suppress(*_WRONG_XML):
            pixels = _ome_pixels(tiff, choice)
            unit = pixels.get("TimeIncrementUnit", "s")
            interval = _converted(pixels.get("TimeIncrement"), unit, _SECONDS)
            planes = _ome_planes(pixels, "T", choice)
            stated = ((p.get("DeltaT"), p.get("DeltaTUnit", "s")) for p in planes)
            times = np.array([_converted(*each, _SECONDS) for each in stated])
    elif tiff.is_imagej and (about := tiff.imagej_metadata):
        interval = _converted(about.get("finterval"), "s", _SECONDS)
    if len(times) == count and (np.diff(times) > 0).all():
        return times - times[0]
    return interval * np.arange(count) if interval > 0 else None


def _ome_pixels(tiff: tifffile.TiffFile, choice: Choice) -> Any:
    """Return the element Pixels of the series in OME metadata."""
    images = _as_list(tifffile.xml2dict(tiff.ome_metadata or "")["OME"]["Image"])
    return images[choice.get("series", 0)]["Pixels"]


def _ome_planes(pixels: Any, axis: str, choice: Choice) -> list[Any]:
    """Return the elements Plane along an axis, in the order of their numbers."""
    wanted = {"TheC": choice.get("channel", 0), "TheT": choice.get("time", 0), "TheZ": 0}
    number = f"The{axis}"
    del wanted[number]
    planes = (p for p in _as_list(pixels.get("Plane", [])) if wanted.items() <= p.items())
    return sorted(planes, key=lambda plane: plane.get(number, 0))


def _ome_scale(pixels: Any, name: str, count: int, choice: Choice) -> Scale:
    sizes = [f"PhysicalSize{axis}" for axis in "XYZ"]
    x, y, step = (_converted(pixels.get(key), pixels.get(f"{key}Unit", "µm")) for key in sizes)
    planes = _ome_planes(pixels, choice.get("axis", "Z"), choice)
    # Positions without a unit of length are in one of the microscope's own.
    named = all(str(p.get("PositionZUnit")) in MICROMETERS for p in planes)
    z = np.array(
        [_converted(p.get("PositionZ"), p["PositionZUnit"] if named else "µm") for p in planes]
    )
    size, even = _square(x, y, name), _even_positions(step, count)
    if not len(z) == count > 1 or not np.isfinite(z).all():
        return size, even
    gaps, unit = np.diff(z), "µm" if named else "(no unit)"
    apart, rises = abs(gaps.mean()), (gaps > 0).all() or (gaps < 0).all()
    placed = f"planes {apart:g} {unit} apart"
    if not rises:
        k = np.argmin(gaps * (np.sign(gaps.sum()) or 1))
        placed = f"planes that do not all rise or fall, as {z[k]:g} and {z[k + 1]:g} {unit}"
    used = "former" if named and rises else "latter"
    if even is not None and (abs(apart - step) > 0.1 * step or not rises):
        warnings.warn(
            f"{name} has {placed}, and a spacing of {step:g} µm: the {used} is used", stacklevel=2
        )
    return size, z if used == "former" else even


def _as_list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _converted(value: Any, unit: object, units: Mapping[str, float] = MICROMETERS) -> float:
    """Return a length in µm, or a value in other units; NaN if it is no number or of no unit."""
    try:
        return float(value) * units.get(str(unit), np.nan)
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


def _even_positions(step: float, count: int) -> Array | None:
    return step * np.arange(count, dtype=float) if step and np.isfinite(step) else None
