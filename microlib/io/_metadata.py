"""Pixel sizes and positions from the metadata of TIFF, in µm."""

from __future__ import annotations

import warnings
from typing import Any
from xml.etree.ElementTree import ParseError

import numpy as np
import tifffile

from microlib._common import MICROMETERS, Array
from microlib.io._stack import Choice

#: Side of a square pixel, µm/px, and positions of the frames, µm; None where they are not known.
Scale = tuple[float | None, Array | None]


def tiff_scale(tiff: tifffile.TiffFile, name: str, count: int, choice: Choice) -> Scale:
    """Return the scale of `count` frames from OME or ImageJ metadata or from the resolution."""
    if tiff.is_ome and tiff.ome_metadata:
        try:
            images = _as_list(tifffile.xml2dict(tiff.ome_metadata)["OME"]["Image"])
            return _ome_scale(images[choice.get("series", 0)]["Pixels"], name, count, choice)
        except (ParseError, LookupError, TypeError, AttributeError):
            return None, None
    page = tiff.pages[0].aspage()
    tagged = "XResolution" in page.tags and "YResolution" in page.tags
    x, y = (1 / n if n else np.nan for n in (page.get_resolution() if tagged else (0, 0)))
    if tiff.is_imagej and (about := tiff.imagej_metadata):
        # An axis without a unit of its own has that of x.
        unit_x, unit_y, unit_z = (
            str(about.get(key, about.get("unit"))).lower() for key in ("unit", "yunit", "zunit")
        )
        step = abs(_micrometers(about.get("spacing"), unit_z))
        size = _square(_micrometers(x, unit_x), _micrometers(y, unit_y), name)
        return size, _even_positions(step, count)
    if page.resolutionunit != tifffile.RESUNIT.CENTIMETER:
        return None, None
    x, y = _micrometers(x, "cm"), _micrometers(y, "cm")
    # Up to 1200 dots per inch it is a printer's resolution, which software writes unasked.
    return None if x > 20 else _square(x, y, name), None


def _ome_scale(pixels: Any, name: str, count: int, choice: Choice) -> Scale:
    sizes = [f"PhysicalSize{axis}" for axis in "XYZ"]
    x, y, step = (_micrometers(pixels.get(key), pixels.get(f"{key}Unit", "µm")) for key in sizes)
    number = f"The{choice.get('axis', 'Z')}"  # which counts the frames
    wanted = {"TheC": choice.get("channel", 0), "TheT": choice.get("time", 0), "TheZ": 0}
    del wanted[number]
    planes = sorted(
        (p for p in _as_list(pixels.get("Plane", [])) if wanted.items() <= p.items()),
        key=lambda plane: plane.get(number, 0),
    )
    # Positions without a unit of length are in one of the microscope's own.
    named = all(str(p.get("PositionZUnit")) in MICROMETERS for p in planes)
    z = np.array(
        [_micrometers(p.get("PositionZ"), p["PositionZUnit"] if named else "µm") for p in planes]
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


def _micrometers(value: Any, unit: object) -> float:
    """Return a length in µm, NaN if it is no number or its unit no length."""
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


def _even_positions(step: float, count: int) -> Array | None:
    return step * np.arange(count, dtype=float) if step and np.isfinite(step) else None
