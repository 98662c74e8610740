"""Pieces that several drawings are made of: boxes, arrows, lengths, letters, images."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from string import ascii_lowercase
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import FancyBboxPatch
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

from compendium.figures.style import COLORS

Point = tuple[float, float]
#: Font size of a symbol in a drawing, points: its index then has 12, as all text, 9 px on a phone.
SYMBOL = 17


def photograph(axes: Axes, image: NDArray, title: str = "", **look: Any) -> AxesImage:
    """Show grey levels from 0 to 255, or as `look` says, with its pixels along the sides."""
    drawn = axes.imshow(image, **({"vmin": 0, "vmax": 255} | look))
    axes.set(title=title, xlabel="x (px)", ylabel="y (px)")
    axes.grid(False)
    return drawn


def boxes(axes: Axes, places: Mapping[str, tuple[float, float, float, float, str]]) -> None:
    """Draw boxes with text: (left, bottom, width, height, color name) by text."""
    for text, (x, y, width, height, color) in places.items():
        box = FancyBboxPatch((x, y), width, height, boxstyle="round,pad=0.04", lw=1.2)
        box.set(facecolor=COLORS[color] + "40", edgecolor=COLORS[color])
        axes.add_patch(box)
        axes.text(x + width / 2, y + height / 2, text, ha="center", va="center")


def arrows(axes: Axes, ends: Iterable[tuple[Point, Point]]) -> None:
    """Draw an arrow from each first point to its second."""
    for start, end in ends:
        axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "lw": 1.4})


def length(axes: Axes, start: Point, end: Point, text: str = "", away: Point = (0, 0)) -> None:
    """Draw a double arrow between two points, with its name `away` from its middle."""
    arrow = {"arrowstyle": "<->", "lw": 1.3, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=arrow)
    x, y = np.add(start, end) / 2 + away
    axes.text(x, y, text, ha="center", va="center", fontsize=SYMBOL)


def letter(panels: Iterable[Axes]) -> None:
    """Letter panels (a), (b), … at their upper left corners, before the title that each has."""
    for name, axes in zip(ascii_lowercase, panels, strict=False):
        title = axes.get_title()
        axes.set_title("")
        axes.set_title(f"({name}) {title}".strip(), loc="left")


def legend_below(figure: Figure, handles: Iterable[Any] = (), ncols: int = 3) -> None:
    """Put one legend under all panels, of the first panel's entries unless others are given."""
    entries = list(handles) or figure.axes[0].get_legend_handles_labels()[0]
    spaces = {"columnspacing": 1.0, "handlelength": 1.5}
    figure.legend(handles=entries, loc="outside lower center", ncols=ncols, **spaces)


def images(
    shown: Mapping[str, NDArray], *, cmap: str = "gray", unit: str = "", **look: Any
) -> tuple[Figure, NDArray]:
    """Show images side by side under letters and titles, with one color bar if they have a unit."""
    height, width = next(iter(shown.values())).shape[:2]
    size = (6.4, (5.2 if unit else 6.4) / len(shown) * height / width + 0.5)
    figure, grid = plt.subplots(1, len(shown), figsize=size, squeeze=False)
    for axes, (title, image) in zip(grid.flat, shown.items(), strict=True):
        drawn = axes.imshow(image, cmap=cmap, **look)
        axes.set(title=title, xticks=[], yticks=[])
    letter(grid.flat)
    if unit:
        figure.colorbar(drawn, ax=grid, label=unit)
    return figure, grid


def prices(found: Mapping[str, tuple[Sequence[float], Sequence[float]]], label: str) -> Figure:
    """Show what each choice costs: a panel for each, with its axis, on a common vertical one."""
    figure, row = plt.subplots(1, len(found), figsize=(6.4, 3.2), sharey=True)
    for axes, (axis, (choices, errors)) in zip(row, found.items(), strict=True):
        axes.loglog(choices, errors, "o-", color=COLORS["blue"])
        axes.set_xlabel(axis.replace(" (", "\n("))
        axes.set_xticks(choices, [f"{one:g}" for one in choices])
        axes.minorticks_off()
    row[0].set_ylabel(label)
    row[0].yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    row[0].yaxis.set_major_formatter("{x:g}")
    letter(row)
    return figure
