"""What ``_static/surfaces.js`` needs to let a reader turn a surface, from its figure's data."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
from book_tables import script_json
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from compendium.figures.surfaces import HK_COLORS, vertical_scale
from microlib.curvature import HK_NAMES


def surface_script(data: Path) -> str:
    """Return the script element of a surface that `show_surface` kept; nothing for other data.

    Heights are written to 1/65534 of their span, and 0 is a hole.
    """
    with np.load(data) as kept:
        if "height" not in kept:
            return ""
        height, labels = kept["height"].astype(float), kept.get("labels")
        pixel_size, unit = float(kept["pixel_size"]), str(kept["unit"])
        height_unit = str(kept["height_unit"])
    tall, note = vertical_scale(height, pixel_size, known=unit == height_unit)
    low, high = np.nanmin(height), np.nanmax(height)
    digits = 3 - int(np.ceil(np.log10(max(high - low, 1e-9))))
    part = (height - low) / max(high - low, 1e-9)
    if labels is None:
        colors = [to_hex(color) for color in colormaps["viridis"](np.arange(256))]
        kinds, key = np.nan_to_num(255 * part).round(), {}
    else:
        colors, kinds = list(HK_COLORS), labels
        key = {f"{k} {HK_NAMES[k]}": HK_COLORS[k] for k in HK_NAMES if k in kinds}
    surface = {
        "rows": part.shape[0],
        "cols": part.shape[1],
        "pitch": pixel_size,
        "low": f"{low.round(digits) + 0:g}",  # no -0
        "high": f"{high.round(digits) + 0:g}",
        "unit": unit,
        "heightUnit": height_unit,
        "tall": tall,
        "note": note,
        "key": key,
        "colors": colors,
        "heights": _base64(np.nan_to_num(1 + 65534 * part).round().astype("<u2")),
        "kinds": _base64(kinds.astype(np.uint8)),
    }
    return f'<script type="application/json" class="surface">{script_json(surface)}</script>'


def _base64(values: NDArray) -> str:
    return base64.b64encode(values.tobytes()).decode()
