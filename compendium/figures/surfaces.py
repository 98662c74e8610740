"""Height maps, surface types and a lens, drawn for chapters 3 and 5."""

from __future__ import annotations

import base64
import io
from html import escape
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import plotly.graph_objects as go
import plotly.io
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from compendium.figures.panels import length, photograph
from compendium.figures.style import COLORS
from microlib import optics
from microlib.curvature import HK_NAMES

#: Convex in blues, concave in oranges, saddles and flats between; label 0 (unknown) is white.
HK_COLORS = (
    "#FFFFFF",
    *("#08519C", "#4292C6", "#9ECAE1"),
    *("#000000", "#D9D9D9", "#009E73"),
    *("#993404", "#EC7014", "#FEC44F"),
)
_PALETTE = ListedColormap(HK_COLORS)
#: Points along each side of a surface that is sent to the browser: some 50 kB.
_MOST_POINTS = 100


def draw_lens() -> Figure:
    """Draw figure 3.1: rays from a point in focus and from a nearer one, through a thin lens."""
    focal, sensor, aperture = 40.0, 100.0, 14.0  # mm
    focused = float(optics.image_distance(sensor, focal))
    lens = {"focal_length": focal, "sensor_distance": sensor, "aperture_radius": aperture}
    figure, axes = plt.subplots(figsize=(6.4, 3.4))
    points = {"in focus": (focused, "blue"), "too near": (focused - 16, "orange")}
    for name, (distance, color) in points.items():
        radius = float(optics.blur_radius(distance, **lens))
        across = [-distance, 0, sensor]
        for side, label in ((-1, None), (1, name)):
            ray = [0, side * aperture, side * radius]
            axes.plot(across, ray, color=COLORS[color], lw=1.6, label=label)
        axes.plot([-distance], [0], "o", color=COLORS[color])
        if radius > 1e-9:
            length(axes, (sensor + 3, -radius), (sensor + 3, radius), "$2 r_b$", (9, 0))
    axes.plot([0, 0], [-1.25 * aperture, 1.25 * aperture], color="black", lw=3)
    axes.plot([sensor, sensor], [-aperture, aperture], color=COLORS["grey"], lw=3)
    axes.axhline(0, color=COLORS["grey"], lw=0.8, ls=":")
    axes.text(0, 1.35 * aperture, "lens", ha="center")
    axes.text(sensor, 1.08 * aperture, "sensor", ha="center")
    axes.set(xlabel="distance from the lens (mm)", ylabel="height (mm)")
    axes.set(xlim=(-75, 120), ylim=(-21, 24))
    axes.legend(loc="upper left")
    return figure


def draw_sinking_stage() -> Figure:
    """Draw figure 3.2: a hill on a stage that sinks until its top is in focus."""
    across = np.linspace(-1, 1, 300)
    top = 0.75  # d_s, the height of S, in units of the drawing
    surface = top * np.exp(-((across / 0.45) ** 2))
    sinks = {"d = 0:\nthe ground is sharp": 0.0, "d < $d_s$:\nthe flank is sharp": 0.45}
    sinks["d = $d_s$:\nthe top is sharp"] = top
    figure, row = plt.subplots(1, 3, figsize=(6.4, 3.9), sharey=True)
    for axes, (title, lowered) in zip(row, sinks.items(), strict=True):
        axes.fill_between(across, -lowered, surface - lowered, color=COLORS["sky"], alpha=0.6, lw=0)
        axes.fill_between(across, -lowered - 0.08, -lowered, color=COLORS["grey"], lw=0)
        axes.axhline(0, color=COLORS["orange"], lw=2)
        sharp = np.abs(surface - lowered) < 0.035
        axes.plot(np.where(sharp, across, np.nan), surface - lowered, color="black", lw=4)
        axes.plot([0], [top - lowered], "o", color=COLORS["blue"])
        axes.text(0.08, top + 0.02 - lowered, "S")
        axes.set_title(title)
        axes.set(xlim=(-1.25, 1.25), ylim=(-1.05, 1.3))
        axes.axis("off")
        axes.fill([-0.3, 0.3, 0.18, -0.18], [1.28, 1.28, 1.0, 1.0], color="black", alpha=0.65, lw=0)
        if lowered:
            # From the plane in focus, where the ground was, down to where it is.
            length(axes, (-0.92, 0), (-0.92, -lowered), "d", (0.14, 0))
    length(row[0], (0.62, 0), (0.62, top), "$d_s$", (0.2, 0))
    row[0].text(0.36, 1.06, "objective")
    below = {"color": COLORS["orange"], "va": "top"}
    row[0].text(-1.25, -0.12, "plane in focus", **below)
    for axes in row[1:]:
        axes.annotate("", (1.15, -0.95), (1.15, -0.3), arrowprops={"arrowstyle": "-|>", "lw": 4})
    row[1].text(1.05, -0.85, "the stage sinks", ha="right", va="center")
    return figure


def draw_labels(axes: Axes, labels: NDArray[np.uint8], *, legend: bool = True) -> None:
    """Show a map of surface types, with a legend of those that occur in it."""
    photograph(axes, labels, cmap=_PALETTE, vmin=0, vmax=9, interpolation="nearest")
    if legend:
        patches = label_patches(labels)
        axes.legend(handles=patches, loc="upper left", bbox_to_anchor=(1.01, 1))


def label_patches(labels: NDArray[np.uint8]) -> list[Patch]:
    """Return the entries of a legend of the surface types that occur in `labels`."""
    present = [label for label in HK_NAMES if np.any(labels == label)]
    return [Patch(color=HK_COLORS[k], label=f"{k} {HK_NAMES[k]}") for k in present]


def draw_surface(
    axes: Any,  # Axes3D, which has no types
    height: NDArray,
    pixel_size: float,
    *,
    labels: NDArray[np.uint8] | None = None,
    unit: str = "µm",
    turned: bool = False,
) -> None:
    """Draw a height map as a surface, colored by height or, if given, by surface type.

    Parameters
    ----------
    axes : Axes3D
        Where to draw.
    height : ndarray, shape (rows, cols)
        Heights, in `unit`.
    pixel_size : float
        Distance between pixels, in `unit`.
    labels : ndarray of uint8, optional
        Surface types for the colors; the height otherwise.
    unit : str
        Unit of the axes.
    turned : bool
        The object is round about the middle of the map, and so is the mesh: an upright wall is then
        a smooth ring and not a flight of stairs. Its surface type is not shown, as it has no pixel
        of its own, and the corners of the map are left out.
    """
    if turned:  # 60 circles about the middle
        middle = (np.array(height.shape) - 1) / 2
        radius, angle = np.mgrid[0 : middle.min() : 60j, 0 : 2 * np.pi : 121j]
        rows, cols = middle[0] + radius * np.sin(angle), middle[1] + radius * np.cos(angle)
    else:  # at most 80 points a side
        stride = max(1, -(-max(height.shape) // 80))
        rows, cols = np.indices(height.shape, dtype=float)[:, ::stride, ::stride]
    points = map_coordinates(height, [rows, cols], order=1)
    if labels is None:
        look: dict[str, Any] = {"cmap": "viridis"}
    else:
        types = map_coordinates(labels, [rows, cols], order=0)
        if turned:  # upright are the steps from ring to ring of a tenth of the height
            types[:-1][np.abs(np.diff(points, axis=0)) > 0.1 * np.ptp(points)] = 0
        look = {"facecolors": _PALETTE(types)}
    # Smoothed edges would leave gaps between the faces.
    look |= {"rstride": 1, "cstride": 1, "linewidth": 0, "antialiased": False}
    axes.plot_surface(pixel_size * cols, pixel_size * rows, points, **look)
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
    Return a picture of a height map, and for readers of the book what makes it a surface to turn.

    A click on the picture puts the surface in its place; plotly's library is loaded only then.

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
        The picture, and the surface in a template that is not shown: at most 100 points a side,
        rounded to a thousandth of the range.
    """
    stride = max(1, -(-max(height.shape) // _MOST_POINTS))
    part = height[::stride, ::stride]
    rows, cols = part.shape
    # To a thousandth of the range: plain numbers, which JSON writes short.
    span = max(float(np.nanmax(part) - np.nanmin(part)), 1e-9)
    side = np.round(stride * pixel_size * np.arange(max(rows, cols)), 3).tolist()
    surface: dict[str, Any] = {"x": side[:cols], "y": side[:rows]}
    surface["z"] = np.round(part, max(0, 3 - int(np.floor(np.log10(span))))).tolist()
    if labels is None:
        surface |= {"colorscale": "Viridis", "colorbar": {"title": f"height ({unit})", "len": 0.7}}
    else:
        surface |= {"surfacecolor": labels[::stride, ::stride].tolist(), "cmin": 0.5, "cmax": 9.5}
        names = {"tickvals": list(HK_NAMES), "ticktext": list(HK_NAMES.values())}
        surface["colorbar"] = names | {"len": 0.9}
        surface["colorscale"] = [
            [(k + end) / 9, HK_COLORS[k + 1]] for k in range(9) for end in (0, 1)
        ]
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
    how = {"config": {"responsive": True, "displaylogo": False}, "div_id": name}
    turned = plotly.io.to_html(figure, include_plotlyjs=False, full_html=False, **how)
    picture, axes = plt.subplots(figsize=(6, 4), subplot_kw={"projection": "3d"})
    draw_surface(axes, np.nan_to_num(height, nan=np.nanmin(height)), pixel_size, labels=labels)
    file = io.BytesIO()
    picture.savefig(file, format="webp", dpi=110)
    plt.close(picture)
    source = f"data:image/webp;base64,{base64.b64encode(file.getvalue()).decode()}"
    return HTML(
        f'<div class="surface"><img src="{source}" alt="{escape(title)}">'
        f'<button type="button">Turn this surface (loads 4.6 MB)</button>'
        f"<template>{turned}</template></div>"
    )
