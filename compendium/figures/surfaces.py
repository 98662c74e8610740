"""Height maps, surface types and a lens, drawn for chapters 3 and 5."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import plotly.graph_objects as go
import plotly.io
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from compendium.figures.style import COLORS
from microlib import optics
from microlib.curvature import HK_NAMES

__all__ = [
    "HK_COLORS",
    "draw_labels",
    "draw_lens",
    "draw_surface",
    "label_legend",
    "turnable_surface",
]

#: Convex in blues, concave in oranges, saddles and flats between; label 0 (unknown) is white.
HK_COLORS = {
    1: "#08519C",
    2: "#4292C6",
    3: "#9ECAE1",
    4: "#000000",
    5: "#D9D9D9",
    6: "#009E73",
    7: "#993404",
    8: "#EC7014",
    9: "#FEC44F",
}
#: Points along each side of a surface that is sent to the browser: some 50 kB.
_MOST_POINTS = 100


def draw_lens() -> Figure:
    """Draw figure 3.1: rays from a point in focus and from a nearer one, through a thin lens."""
    focal, sensor, aperture = 40.0, 100.0, 14.0  # mm
    focused = float(optics.image_distance(sensor, focal))
    lens = {"focal_length": focal, "sensor_distance": sensor, "aperture_radius": aperture}
    figure, axes = plt.subplots(figsize=(7.2, 3.4))
    for distance, color, name in (
        (focused, "blue", "in focus"),
        (focused - 16, "orange", "too near"),
    ):
        radius = float(optics.blur_radius(distance, **lens))
        for side in (-1, 1):
            axes.plot(
                [-distance, 0, sensor],
                [0, side * aperture, side * radius],
                color=COLORS[color],
                lw=1.6,
                label=name if side > 0 else None,
            )
        axes.plot([-distance], [0], "o", color=COLORS[color])
        if radius > 1e-9:
            ends = (sensor + 3, -radius), (sensor + 3, radius)
            axes.annotate("", *ends, arrowprops={"arrowstyle": "<->"})
            axes.text(sensor + 6, 0, "$2 r_b$", va="center")
    axes.plot([0, 0], [-1.25 * aperture, 1.25 * aperture], color="black", lw=3)
    axes.plot([sensor, sensor], [-aperture, aperture], color=COLORS["grey"], lw=3)
    axes.axhline(0, color=COLORS["grey"], lw=0.8, ls=":")
    axes.text(0, 1.35 * aperture, "lens", ha="center")
    axes.text(sensor, 1.08 * aperture, "sensor", ha="center")
    axes.set(xlabel="distance from the lens (mm)", ylabel="height (mm)")
    axes.set(xlim=(-75, 120), ylim=(-21, 24))
    axes.legend(loc="upper left")
    return figure


def draw_labels(axes: Axes, labels: NDArray[np.uint8], *, legend: bool = True) -> None:
    """Show a map of surface types, with a legend of those that occur in it."""
    colors = ListedColormap(["#FFFFFF", *HK_COLORS.values()])
    axes.imshow(
        labels, cmap=colors, norm=BoundaryNorm(np.arange(-0.5, 10), 10), interpolation="nearest"
    )
    axes.set(xlabel="x (px)", ylabel="y (px)")
    axes.grid(False)
    if legend:
        label_legend(axes, labels)


def label_legend(axes: Axes, labels: NDArray[np.uint8]) -> None:
    """Put a legend of the surface types that occur in `labels` beside the axes."""
    present = [label for label in HK_NAMES if np.any(labels == label)]
    patches = [Patch(color=HK_COLORS[k], label=f"{k} {HK_NAMES[k]}") for k in present]
    axes.legend(handles=patches, loc="upper left", bbox_to_anchor=(1.01, 1), fontsize=10)


def draw_surface(
    axes: Any,  # Axes3D, which has no types
    height: NDArray,
    pixel_size: float,
    *,
    labels: NDArray[np.uint8] | None = None,
    unit: str = "µm",
) -> None:
    """Draw a height map as a surface, colored by height or, if given, by surface type."""
    stride = max(1, -(-max(height.shape) // 80))
    rows, cols = height.shape
    x, y = np.meshgrid(pixel_size * np.arange(cols), pixel_size * np.arange(rows))
    if labels is None:
        look: dict[str, Any] = {"cmap": "viridis"}
    else:
        palette = ListedColormap(["#FFFFFF", *HK_COLORS.values()])
        look = {"facecolors": palette(labels[::stride, ::stride])}
    part = np.s_[::stride, ::stride]
    axes.plot_surface(
        x[part], y[part], height[part], rstride=1, cstride=1, linewidth=0, antialiased=False, **look
    )
    axes.set(xlabel=f"x ({unit})", ylabel=f"y ({unit})", zlabel=f"height ({unit})")
    axes.view_init(elev=35, azim=-60)


def turnable_surface(
    height: NDArray,
    pixel_size: float,
    *,
    name: str,
    title: str,
    labels: NDArray[np.uint8] | None = None,
    unit: str = "µm",
) -> HTML:
    """
    Return a height map that readers of the book can turn, as HTML without plotly's library.

    Parameters
    ----------
    height : ndarray, shape (rows, cols)
        Heights, in `unit`; NaN leaves a hole.
    pixel_size : float
        Distance between pixels, in `unit`.
    name : str
        Identifier of the HTML element, unique on its page.
    title : str
        What it shows.
    labels : ndarray of uint8, optional
        Surface types for the colors; the height otherwise.
    unit : str
        Unit of the axes.

    Returns
    -------
    IPython.display.HTML
        The element and its data, at most 100 points a side, rounded to a thousandth of the range.
    """
    stride = max(1, -(-max(height.shape) // _MOST_POINTS))
    part = height[::stride, ::stride]
    rows, cols = part.shape
    digits = max(
        0, 3 - int(np.floor(np.log10(max(float(np.nanmax(part) - np.nanmin(part)), 1e-9))))
    )
    surface: dict[str, Any] = {
        "x": _rounded(stride * pixel_size * np.arange(cols), 3),
        "y": _rounded(stride * pixel_size * np.arange(rows), 3),
        "z": [_rounded(row, digits) for row in part],
    }
    if labels is None:
        surface |= {"colorscale": "Viridis", "colorbar": {"title": f"height ({unit})", "len": 0.7}}
    else:
        steps = [[(k + end) / 9, HK_COLORS[k + 1]] for k in range(9) for end in (0, 1)]
        surface |= {
            "surfacecolor": labels[::stride, ::stride].tolist(),
            "colorscale": steps,
            "cmin": 0.5,
            "cmax": 9.5,
            "colorbar": {
                "tickvals": list(HK_NAMES),
                "ticktext": list(HK_NAMES.values()),
                "len": 0.9,
            },
        }
    figure = go.Figure(go.Surface(**surface))
    figure.update_layout(
        title=title,
        height=460,
        margin={"l": 0, "r": 0, "t": 40, "b": 0},
        scene={
            "xaxis_title": f"x ({unit})",
            "yaxis": {"title": f"y ({unit})", "autorange": "reversed"},
            "zaxis_title": f"height ({unit})",
            "aspectmode": "manual",
            "aspectratio": {"x": 1, "y": rows / cols, "z": 0.5},
        },
        template="plotly_white",
    )
    return HTML(
        plotly.io.to_html(
            figure,
            include_plotlyjs=False,
            full_html=False,
            div_id=name,
            config={"responsive": True, "displaylogo": False},
        )
    )


def _rounded(values: NDArray, digits: int) -> list[float | None]:
    """Return plain numbers, which JSON writes short; None for NaN."""
    return [round(float(v), digits) if np.isfinite(v) else None for v in values]
