"""Pictures of embryos: the image to scale, and the outline that was found in it."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from compendium.figures.panels import photograph
from compendium.figures.style import COLORS
from microlib.embryo import Boundary


def show_image(ax: Axes, image: NDArray, *, box: tuple[int, int, int, int] | None = None) -> None:
    """Show a grey image, or its part `box` (x, y, width, height), in its own pixel coordinates."""
    x, y, width, height = box or (0, 0, image.shape[1], image.shape[0])
    extent = (x - 0.5, x + width - 0.5, y + height - 0.5, y - 0.5)
    part = image[y : y + height, x : x + width]
    photograph(ax, part, extent=extent)
    ax.set_axis_off()


def add_scale_bar(ax: Axes, length: float, pixel_size: float, *, color: str = "black") -> None:
    """Draw a bar of `length` µm into the lower left corner of an image."""
    left, right = sorted(ax.get_xlim())
    top, bottom = sorted(ax.get_ylim())
    x = left + 0.05 * (right - left)
    y = bottom - 0.06 * (bottom - top)
    ax.plot([x, x + length / pixel_size], [y, y], color=color, lw=4, solid_capstyle="butt")
    middle, above = x + length / pixel_size / 2, y - 0.02 * (bottom - top)
    label = ax.text(middle, above, f"{length:g} µm", color=color, ha="center", va="bottom")
    # Legible on any ground.
    around = "white" if color == "black" else "black"
    label.set_path_effects([withStroke(linewidth=3, foreground=around)])
    ax.set(xlim=(left, right), ylim=(bottom, top))


def show_outline(ax: Axes, boundary: Boundary) -> None:
    """Draw what `extract_boundary` found over its image, dotted where the probe hides it."""
    x, y = boundary.points.T
    seen = ~boundary.under_probe
    look: dict[str, Any] = {"color": COLORS["orange"], "lw": 1.5}
    middle = boundary.probe.tip[0]
    for side in (x < middle, x > middle):
        ax.plot(x[seen & side], y[seen & side], **look)
    hidden = np.flatnonzero(boundary.under_probe)
    ax.plot(x[hidden], y[hidden], ls=":", **look)
