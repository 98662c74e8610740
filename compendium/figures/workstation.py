"""Drawings of sections 5.1 to 5.4: the workstation, its calibration, tracking and servoing."""

from __future__ import annotations

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from compendium.figures.panels import boxes
from compendium.figures.style import COLORS


def draw_workstation() -> Figure:
    """Draw figure 5.1 as a sketch."""
    parts = {
        "camera\nBasler A602fc": (3.6, 5.6, 2.0, 0.8, "sky"),
        "zoom\n0.75–11.25": (3.9, 4.5, 1.4, 0.9, "grey"),
        "objective\n1.6X": (4.0, 3.5, 1.2, 0.8, "grey"),
        "sample stage, x and y": (2.6, 0.9, 4.0, 0.6, "blue"),
        "manipulator\nx, y, z": (0.2, 1.5, 1.8, 1.2, "orange"),
        "manipulator\nx, y, z ": (7.2, 1.5, 1.8, 1.2, "orange"),
        "side camera\nSony XCD-X710CR": (7.0, 3.6, 2.3, 0.8, "sky"),
        "vibration isolation table": (0.0, 0.1, 9.4, 0.6, "green"),
    }
    figure, axes = plt.subplots(figsize=(6.4, 4.6))
    boxes(axes, parts)
    axes.plot([4.6, 4.6], [1.65, 3.5], color=COLORS["ink"], lw=1, ls=":")
    axes.plot([7.0, 4.9], [3.8, 1.9], color=COLORS["ink"], lw=1, ls=":")
    axes.plot([2.0, 4.1], [2.0, 1.75], color=COLORS["orange"], lw=3)
    axes.plot([7.2, 5.1], [2.0, 1.75], color=COLORS["orange"], lw=3)
    axes.text(2.2, 2.25, "probe")
    axes.text(6.2, 2.25, "gripper", ha="left")
    axes.plot(4.6, 1.62, "o", color=COLORS["ink"], ms=7)
    axes.set(xlim=(-0.1, 9.5), ylim=(0, 6.6), aspect="equal")
    axes.axis("off")
    return figure
