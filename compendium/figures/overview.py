"""Drawings of what the book is about: its four parts, and the sizes that it deals with."""

from __future__ import annotations

import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from compendium.figures.style import COLORS

__all__ = ["draw_parts", "draw_scale"]

#: What goes in, what is done, what comes out, and a color, of each part.
PARTS = (
    (
        "photograph of\na known pattern",
        "calibration\nchapters 2, 5.2",
        "camera model:\nµm per pixel, tilt",
        "sky",
    ),
    (
        "frames of a\nmoving gripper",
        "tracking, servoing\nchapters 2, 5.3–5.4",
        "where it is,\nhow to move it",
        "yellow",
    ),
    (
        "frames at many\nfocus positions",
        "shape from focus, HK\nchapters 3, 5.5",
        "heights and\nclasses of surface",
        "green",
    ),
    (
        "outline of a\ndented embryo",
        "point-load model\nchapters 4, 5.6",
        "elastic modulus\nof its shell",
        "pink",
    ),
)
#: From, to (m) and color of the three worlds.
BANDS = {
    "macro": (1e-3, 1, "blue"),
    "micro": (1e-6, 1e-3, "orange"),
    "nano": (1e-9, 1e-6, "green"),
}
#: Sizes of what the book meets, m.
THINGS = {
    "hand": 0.1,
    "zebrafish embryo": 1.2e-3,
    "calibration circle": 140e-6,
    "gripper opening": 100e-6,
    "pixel at 1X": 6.2e-6,
    "wavelength of light": 0.55e-6,
    "step of the stage": 50e-9,
    "film of the contact": 0.4e-9,
}


def draw_parts() -> Figure:
    """Draw the four tasks of the thesis as rows of boxes: input, method, result."""
    figure, axes = plt.subplots(figsize=(7.2, 4.6))
    for row, (*texts, color) in enumerate(PARTS):
        for column, text in enumerate(texts):
            x, y = 3.4 * column, -1.25 * row
            axes.add_patch(
                FancyBboxPatch(
                    (x, y),
                    2.6,
                    0.85,
                    boxstyle="round,pad=0.06",
                    fc=COLORS[color],
                    alpha=0.55 if column == 1 else 0.15,
                    lw=0,
                )
            )
            axes.text(x + 1.3, y + 0.42, text, ha="center", va="center", fontsize=11)
            if column:
                arrow = {"arrowstyle": "->", "lw": 1.6}
                axes.annotate("", (x - 0.1, y + 0.42), (x - 0.7, y + 0.42), arrowprops=arrow)
    axes.set(xlim=(-0.2, 9.6), ylim=(-3.95, 1.05))
    axes.axis("off")
    return figure


def draw_scale() -> Figure:
    """Draw figure 2.1: the scale of micromanipulation."""
    figure, axes = plt.subplots(figsize=(7.2, 3.6))
    top = len(THINGS)
    for name, (low, high, color) in BANDS.items():
        axes.barh(top, high - low, left=low, color=COLORS[color], height=0.8)
        axes.text((low * high) ** 0.5, top, name, ha="center", va="center", color="white")
    for row, (name, size) in enumerate(reversed(THINGS.items())):
        axes.plot(size, row, "o", color="black", ms=6)
        right = size < 1e-5
        axes.annotate(
            name,
            (size, row),
            xytext=(8 if right else -8, 0),
            textcoords="offset points",
            ha="left" if right else "right",
            va="center",
        )
    axes.set(xscale="log", xlim=(1e-10, 1), yticks=[], xlabel="size (m)")
    axes.spines["left"].set_visible(False)
    return figure
