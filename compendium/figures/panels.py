"""Pieces that several drawings are made of: labelled boxes, arrows, and rows of images."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from numpy.typing import NDArray

from compendium.figures.style import COLORS

__all__ = ["images"]

Point = tuple[float, float]


def boxes(axes: Axes, places: Mapping[str, tuple[float, float, float, float, str]]) -> None:
    """Draw boxes with text: (left, bottom, width, height, color name) by text."""
    for text, (x, y, width, height, color) in places.items():
        box = FancyBboxPatch((x, y), width, height, boxstyle="round,pad=0.04", lw=1.2)
        box.set(facecolor=COLORS[color] + "40", edgecolor=COLORS[color])
        axes.add_patch(box)
        axes.text(x + width / 2, y + height / 2, text, ha="center", va="center", fontsize=11)


def arrows(axes: Axes, ends: Iterable[tuple[Point, Point]]) -> None:
    """Draw an arrow from each first point to its second."""
    for start, end in ends:
        axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "lw": 1.4})


def images(
    shown: Mapping[str, NDArray],
    *,
    columns: int = 3,
    cmap: str = "gray",
    unit: str = "",
    **look: Any,
) -> tuple[Figure, NDArray]:
    """Show images side by side under their titles, with one color bar if they have a unit."""
    rows = -(-len(shown) // columns)
    height, width = next(iter(shown.values())).shape[:2]
    size = (7.2, rows * (7.2 / columns * height / width + 0.5))
    figure, grid = plt.subplots(rows, columns, figsize=size, squeeze=False)
    for axes, (title, image) in zip(grid.flat, shown.items(), strict=False):
        drawn = axes.imshow(image, cmap=cmap, **look)
        axes.set(title=title, xticks=[], yticks=[])
        axes.grid(False)
    for axes in grid.flat[len(shown) :]:
        axes.axis("off")
    if unit:
        figure.colorbar(drawn, ax=grid, label=unit)
    return figure, grid
