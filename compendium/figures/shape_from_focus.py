"""Drawings of section 5.5: focal stacks, depths, surface types and their thresholds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from compendium.experiments.section_5_5 import BALL_PIXEL, BALL_RADIUS, BALL_SHAPE, Scene
from compendium.figures.panels import legend_below, letter, photograph
from compendium.figures.style import COLORS
from compendium.figures.surfaces import draw_labels, label_patches


def draw_focus(
    scene: Scene,
    fused: NDArray,
    depth: NDArray,
    shown: Mapping[str, int],
    *,
    pixel_size: float | None = None,
) -> Figure:
    """Draw figure 5.9 or 5.11: parts of frames with what is sharp in them, and the heights.

    Parameters
    ----------
    scene : Scene
        The stack.
    fused : ndarray, shape (rows, cols)
        What is sharp everywhere.
    depth : ndarray, shape (rows, cols)
        Height, µm.
    shown : mapping of str to int
        Two frames by title.
    pixel_size : float, optional
        µm; the axes are in px without.
    """
    unit, size = ("px", 1.0) if pixel_size is None else ("µm", pixel_size)
    rows, cols = depth.shape
    x, y, side = cols // 2 - 85, rows // 2 - 15, 75  # a part, in which a blur can be seen
    part = slice(y, y + side), slice(x, x + side)
    figure = plt.figure(figsize=(6.4, 5.4))
    halves: Any = figure.subfigures(2, 1, height_ratios=(1, 1.1))
    upper, lower = halves
    row = upper.subplots(1, len(shown) + 1)
    for axes, (title, k) in zip(row, shown.items(), strict=False):
        photograph(axes, scene.frames[k][part], title)
        # Between the heights that are nearer to this frame than to another.
        away = np.abs(scene.height[part] - scene.positions[k])
        near = np.diff(scene.positions).mean() / 2
        axes.contourf(away, [-1, near], colors=COLORS["orange"], alpha=0.25)
        axes.contour(away, [near], colors=COLORS["orange"])
    photograph(row[-1], fused[part], "all in focus")
    for axes in row:
        axes.set(xlabel="", ylabel="", xticks=[], yticks=[])
    above, profile = lower.subplots(1, 2, width_ratios=(1, 1.1))
    extent = (0, cols * size, rows * size, 0)
    look: dict[str, Any] = {"cmap": "viridis", "vmin": None, "vmax": None, "extent": extent}
    seen = photograph(above, depth, "height from focus", **look)
    above.set(xlabel=f"x ({unit})", ylabel=f"y ({unit})")
    lower.colorbar(seen, ax=above, shrink=0.8).ax.set_title("µm", loc="left")
    across, middle = size * np.arange(cols), rows // 2
    profile.plot(across, scene.height[middle], color=COLORS["ink"], lw=1.2, label="true height")
    profile.plot(across, depth[middle], color=COLORS["blue"], label="from focus")
    profile.set(xlabel=f"x ({unit})", ylabel="height (µm)", title="section in the middle")
    profile.set_ylim(None, 1.6 * depth.max())
    profile.legend(loc="upper left")
    letter([*row, above, profile])
    return figure


def draw_types(
    labels: Mapping[str, NDArray[np.uint8]],
    *,
    columns: int = 2,
    box: tuple[int, int, int, int] | None = None,
    ball: bool = False,
    ridges: Sequence[float] = (),
) -> Figure:
    """Draw figures 5.13 and 5.14: maps of surface types by title, with one legend.

    Parameters
    ----------
    labels : dict of str to ndarray
        Surface types by title.
    columns : int
        Maps side by side. The legend takes a cell that is left over.
    box : tuple of int, optional
        Part (x, y, width, height) that is shown, px.
    ball : bool
        Show the ball's edge and half its radius.
    ridges : sequence of float
        Widths of the ridges, whose feet are marked by dotted lines, px.
    """
    x, y, width, height = box or (0, 0, *next(iter(labels.values())).shape[::-1])
    rows, free = -(-len(labels) // columns), -len(labels) % columns
    # Inches: square pixels, a title and a label for each row, and a legend below.
    size = (6.4, (not free) * 0.8 + 0.4 + rows * (0.4 + 5.6 / columns * height / width))
    figure, _ = plt.subplots(rows, columns, figsize=size)
    for k, (axes, (title, types)) in enumerate(zip(figure.axes, labels.items(), strict=False)):
        draw_labels(axes, types)
        axes.set(title=title, xlim=(x, x + width - 1), ylim=(y + height - 1, y))
        if k % columns:
            axes.set(ylabel="", yticks=[])
        if k + columns < len(labels):
            axes.set(xlabel="", xticks=[])
        for share, line in ((1.0, "-"), (0.5, "--")) if ball else ():
            middle = ((BALL_SHAPE[1] - 1) / 2, (BALL_SHAPE[0] - 1) / 2)
            radius = share * BALL_RADIUS / BALL_PIXEL
            axes.add_patch(Circle(middle, radius, fill=False, color="black", ls=line))
        for side in (-0.5, 0.5) if ridges else ():
            axes.axvline((types.shape[1] - 1) / 2 + side * ridges[k], color="black", ls=":")
    letter(figure.axes[: len(labels)])
    key = label_patches(np.stack([part[y : y + height, x : x + width] for part in labels.values()]))
    if free:
        figure.axes[-1].legend(handles=key, loc="center")
        figure.axes[-1].axis("off")
    else:
        legend_below(figure, key)
    return figure
