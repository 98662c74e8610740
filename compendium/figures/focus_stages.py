"""The figure of the stages of the default depth from focus, for chapter 3."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from compendium.figures.panels import letter
from compendium.figures.style import COLORS

#: Row and column of the pixel whose profile is drawn, and the row that is drawn across the step.
PIXEL, ROW = (40, 30), 60
_HEIGHTS = {"cmap": "viridis", "vmin": 0, "vmax": 200}
_ERRORS = {"cmap": "RdBu", "vmin": -6, "vmax": 6}


def draw_focus_stages(stages: Any) -> Figure:
    """Draw ten panels of a `compendium.experiments.chapter_3.FocusStages`."""
    slope = (slice(None), slice(4, 88))
    halves = np.where(np.arange(192) < 96, stages.frame, stages.averaged)
    maps: dict[str, tuple[NDArray, str, Mapping[str, Any]] | None] = {
        "1 average": (halves[40:88, 72:120], "grey level", {"cmap": "gray"}),
        "2 measure": (
            stages.measure / stages.measure.max(),
            "measure / maximum",
            {"cmap": "magma"},
        ),
        "3 fit, one pixel": None,
        "3 fit, every pixel": (stages.fitted, "height (µm)", _HEIGHTS),
        "4 reject noise": (stages.chosen, "height (µm)", _HEIGHTS),
        "5 choose a side": None,
        "6 apply rules": (stages.kept, "height (µm)", _HEIGHTS),
        "7 smooth": ((stages.smooth - stages.truth)[slope], "error (µm)", _ERRORS),
        "8 restore relief": ((stages.final - stages.truth)[slope], "error (µm)", _ERRORS),
        "9 uncertainty": (stages.uncertainty, "uncertainty (µm)", {"cmap": "magma", "vmax": 10}),
    }
    figure, grid = plt.subplots(5, 2, figsize=(6.4, 10.4))
    for axes, (title, drawn) in zip(grid.flat, maps.items(), strict=True):
        axes.set_title(title)
        if drawn is not None:
            image, label, look = drawn
            axes.grid(False)
            axes.set(xticks=[], yticks=[], facecolor="#D9D9D9")
            shown = axes.imshow(image, **look)
            figure.colorbar(shown, ax=axes, label=label, location="right")
    for axes in (grid[1, 0], grid[2, 1]):
        axes.set_box_aspect(0.75)  # as the maps
    _draw_fit(grid[1, 0], stages)
    _draw_step(grid[2, 1], stages)
    letter(grid.flat)
    return figure


def _draw_fit(axes: Axes, stages: Any) -> None:
    """Draw a profile on a logarithmic axis, with the parabola through seven values."""
    profile = stages.products[:, PIXEL[0], PIXEL[1]]
    best = int(profile.argmax())
    near = slice(max(best - 3, 0), best + 4)
    parabola = np.polynomial.Polynomial.fit(stages.centers[near], np.log(profile[near]), 2)
    fine = np.linspace(stages.centers[near].min(), stages.centers[near].max(), 100)
    axes.semilogy(stages.centers, profile, "o", color=COLORS["blue"])
    axes.semilogy(fine, np.exp(parabola(fine)), color=COLORS["orange"])
    axes.axvline(stages.truth[PIXEL], color=COLORS["ink"], lw=1.2)
    axes.set(xlabel="position (µm)", ylabel="measure (grey levels²)")
    axes.set_yticks([1e4, 1e5], ["10⁴", "10⁵"])
    axes.set_yticks([], minor=True)


def _draw_step(axes: Axes, stages: Any) -> None:
    """Draw the heights across the step: the true ones, those of the fit, and the chosen ones."""
    x = np.arange(86, 106)
    axes.plot(x, stages.truth[ROW, x], color=COLORS["ink"], lw=1.2, label="true")
    axes.plot(x, stages.fitted[ROW, x], ".", color=COLORS["blue"], label="fit")
    axes.plot(
        x[::2],
        stages.chosen[ROW // 2, x[::2] // 2],
        "o",
        mfc="none",
        color=COLORS["orange"],
        label="chosen",
    )
    axes.set(xlabel="x (px)", ylabel="height (µm)", ylim=(0, 200))
    narrow = {"columnspacing": 0.5, "handlelength": 0.8, "handletextpad": 0.3}
    axes.legend(loc="upper center", bbox_to_anchor=(0.4, -0.4), ncols=3, **narrow)
