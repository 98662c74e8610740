"""Drawings of the whole: the system, the sizes that it deals with, and what was found."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from compendium.figures.panels import arrows, boxes, letter
from compendium.figures.style import COLORS

#: What each task gets, does and gives, with a color.
TASKS = (
    ("photograph of a known pattern", "calibration", "µm per pixel, tilt", "sky"),
    ("frames of a moving gripper", "tracking, servoing", "command to the stage", "yellow"),
    ("frames at many focus positions", "shape from focus, HK", "heights, surface types", "green"),
    ("outline of a dented embryo", "point-load model", "modulus of the shell", "pink"),
)


def draw_system() -> Figure:
    """Draw the microscope over its sample, and beside it the four tasks of its camera's frames."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(6.4, 4.6), width_ratios=(1, 1.35))
    _draw_microscope(left)
    for row, (given, task, result, color) in enumerate(TASKS):
        y = -2.2 * row
        boxes(right, {task: (0.0, y, 4.2, 0.62, color)})
        right.text(2.1, y + 0.92, given, ha="center", va="center")
        right.text(2.1, y - 0.3, f"→ {result}", ha="center", va="center")
    right.set(xlim=(-0.2, 4.4), ylim=(-7.2, 1.3))
    letter((left, right))
    for axes in (left, right):
        axes.axis("off")
    return figure


def _draw_microscope(axes: Axes) -> None:
    boxes(
        axes,
        {
            "camera": (1.3, 6.6, 1.8, 0.8, "sky"),
            "zoom": (1.5, 5.3, 1.4, 0.9, "grey"),
            "objective": (1.4, 4.1, 1.6, 0.7, "grey"),
            "sample stage": (0.3, 0.3, 3.8, 0.7, "blue"),
        },
    )
    axes.fill([1.6, 2.8, 2.25, 2.15], [4.0, 4.0, 1.7, 1.7], color=COLORS["yellow"], alpha=0.25)
    turn = np.linspace(0, 2 * np.pi, 80)
    axes.plot(2.2 + 0.34 * np.cos(turn), 1.38 + 0.34 * np.sin(turn), color=COLORS["ink"], lw=2)
    axes.text(3.05, 1.3, "embryo", va="center")
    for side, name in ((-1, "gripper"), (1, "probe")):
        axes.plot([2.2 + 2.1 * side, 2.2 + 0.4 * side], [2.6, 1.6], color=COLORS["orange"], lw=4)
        axes.text(2.2 + 1.75 * side, 2.85, name, ha="center")
    arrows(axes, [((3.2, 7.0), (4.6, 7.0))])
    axes.text(3.9, 7.25, "frames", ha="center")
    axes.set(xlim=(-0.1, 4.7), ylim=(0.1, 7.7))
