"""Parts, their surface types and the graph of their regions, drawn for chapter 6."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from compendium.experiments.recognition import Recognized
from compendium.figures.style import COLORS
from compendium.figures.surfaces import draw_labels, label_patches
from microlib.curvature._recognition import PartRecognition

__all__ = ["draw_recognized"]

#: Area of a node that stands for the whole map, points².
_WHOLE = 900.0


def draw_recognized(parts: Sequence[Recognized]) -> Figure:
    """Draw a column a part: heights, surface types with the graph over them, and the verdict."""
    figure, axes = plt.subplots(2, len(parts), figsize=(1.55 * len(parts), 4.3))
    for (above, below), part in zip(axes.T, parts, strict=True):
        above.imshow(part.depth, cmap="viridis")
        above.set_title(part.name, fontsize=12)
        draw_labels(below, part.found.labels, legend=False)
        _draw_graph(below, part.found)
        named = part.found.kind and f"→ {part.found.kind}\n{part.found.confidence:.0%}"
        below.set_title(named or "→ refused\n", fontsize=12)
        for panel in (above, below):
            panel.set(xticks=[], yticks=[], xlabel="", ylabel="")
            panel.grid(False)
            panel.spines[:].set_visible(False)
    present = label_patches(np.concatenate([part.found.labels.ravel() for part in parts]))
    figure.legend(handles=present, loc="outside lower center", ncols=4, fontsize=11)
    return figure


def _draw_graph(axes: Axes, found: PartRecognition) -> None:
    places = found.regions[["x", "y"]].to_numpy()
    for one, two in found.borders[["one", "two"]].to_numpy(int):
        axes.plot(*places[[one, two]].T, color="black", lw=0.9)
    axes.scatter(
        places[:, 0],
        places[:, 1],
        s=20 + _WHOLE * found.regions["area"] / 10,
        color=COLORS["pink"],
        edgecolors="black",
        zorder=3,
    )
