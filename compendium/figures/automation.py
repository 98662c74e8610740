"""The injection of a simulated egg, drawn."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from compendium.figures.style import COLORS


def draw_injection(pressed: dict[str, Any]) -> Figure:
    """Draw pictures of an injection, and force and depth over time beside the truth.

    Parameters
    ----------
    pressed : dict
        Of `compendium.experiments.injection.press`.

    Returns
    -------
    Figure
    """
    figure = plt.figure(figsize=(6.4, 6.0))
    grid = figure.add_gridspec(3, 6, height_ratios=(1.1, 1, 1))
    for k, name in enumerate(("start", "contact", "target")):
        axes = figure.add_subplot(grid[0, 2 * k : 2 * k + 2])
        axes.imshow(pressed["pictures"][k], vmin=0, vmax=255)
        axes.set_title(name)
        axes.axis("off")
    log = pressed["log"]
    curves = (("force", "force_uN", "µN"), ("depth", "depth_um", "µm"))
    for row, (name, column, unit) in enumerate(curves):
        axes = figure.add_subplot(grid[row + 1, :])
        axes.plot(log["time_s"], log[f"true_{name}"], color=COLORS["grey"], label="truth")
        axes.plot(log["time_s"], log[column], "o", ms=4, color=COLORS["blue"], label="outline")
        axes.axvline(pressed["contact"], color=COLORS["orange"], ls="--", label="contact seen")
        axes.set_ylabel(f"{name} ({unit})")
        if row == 0:
            axes.legend(loc="upper left")
    axes.set_xlabel("time (s)")
    return figure
