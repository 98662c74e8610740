"""Drawings of chapters 2 and 5 about tracking and servoing."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from scipy.stats import binomtest

from compendium import thesis
from compendium.figures.panels import SYMBOL, arrows, boxes, letter, photograph
from compendium.figures.style import COLORS
from compendium.ledger import claim
from microlib.tracking import Track


def draw_loop() -> Figure:
    """Draw figure 2.3: image-based servoing as dynamic look-and-move."""
    figure, axes = plt.subplots(figsize=(6.4, 3.1))
    axes.set(xlim=(-0.75, 11.6), ylim=(-0.15, 3.3), aspect="equal")
    axes.axis("off")
    blocks = {
        "control law\n(2.3) or (2.28)": (1.93, 2.0, 2.34, 1.0, "orange"),
        "stage with its\nposition loop": (5.0, 2.0, 2.2, 1.0, "grey"),
        "microscope\nand camera": (8.6, 2.0, 2.2, 1.0, "grey"),
        "tracker\nESM, Kalman": (6.8, 0.0, 2.2, 1.0, "blue"),
    }
    boxes(axes, blocks)
    axes.plot(0.75, 2.5, "o", ms=20, mfc="none", mec=COLORS["ink"], mew=1.4)
    axes.text(0.75, 2.5, "Σ", ha="center", va="center")
    axes.plot([10.85, 11.4, 11.4], [2.5, 2.5, 0.5], color=COLORS["ink"], lw=1.4)
    axes.plot([6.75, 0.75], [0.5, 0.5], color=COLORS["ink"], lw=1.4)
    forward = [((x, 2.5), (end, 2.5)) for x, end in ((-0.6, 0.45), (1.05, 1.88), (4.32, 4.95))]
    back = [((11.4, 0.5), (9.05, 0.5)), ((0.75, 0.5), (0.75, 2.2))]
    arrows(axes, [*forward, ((7.25, 2.5), (8.55, 2.5)), *back])
    for x, y, label in (
        (-0.35, 2.65, "$f^*$"),
        (1.42, 2.65, "$e$"),
        (4.55, 2.65, "$u$"),
        (7.9, 2.65, "pose"),
        (10.2, 0.65, "image"),
        (3.6, 0.65, "feature $f$"),
        (0.3, 2.1, "−"),
        (1.0, 1.75, "+"),
    ):
        size = SYMBOL if "^" in label else None
        axes.text(x, y, label, ha="center", va="bottom", fontsize=size)
    return figure


def draw_track(
    axes: Axes, frame: NDArray[np.uint8], track: Track, title: str, *, margin: float = 45.0
) -> None:
    """Draw the tracked window and the feature, the mean of its corners, on part of a frame."""
    photograph(axes, frame, title)
    axes.add_patch(Polygon(track.corners, fill=False, edgecolor=COLORS["yellow"], lw=2))
    axes.plot(*track.center, "+", color=COLORS["orange"], ms=11, mew=2)
    x, y = track.center
    axes.set(xlim=(x - margin, x + margin), ylim=(y + margin, y - margin))


def draw_step_runs(runs: dict[str, Any], band: float) -> Figure:
    """Draw figures 5.4 and 5.5: position, velocity and distance to the goal, a column a run.

    The reported settling time and the reported error at that time are marked.

    Parameters
    ----------
    runs : dict of str to Simulation
        By zoom; ``time`` (s), ``reference`` and ``measured`` (px) and ``command`` (µm/s) are drawn.
    band : float
        Share of the step within which it counts as settled, which is shaded.
    """
    figure, grid = plt.subplots(
        3, len(runs), figsize=(6.4, 6.2), squeeze=False, sharex="col", sharey="row"
    )
    for (zoom, run), (top, middle, bottom) in zip(runs.items(), grid.T, strict=True):
        entry = f"table-5.3/{zoom}/{{}}".format
        time, error = claim(entry("settling-time")).value, claim(entry("accuracy")).value
        moved, step = run.measured - run.measured[0], run.reference[-1] - run.measured[0]
        for k, (name, color, line) in enumerate((("x", "blue", "-"), ("y", "orange", "--"))):
            top.plot(run.time, moved[:, k], line, color=COLORS[color], label=name)
            how = {"where": "post", "color": COLORS[color], "label": name}
            middle.step(run.time, run.command[:, k], line, **how)
        top.axhline(step[0], color=COLORS["ink"], lw=1, label="goal")
        distance = thesis.effective_pixel(zoom) * np.linalg.norm(moved - step, axis=1)
        bottom.plot(run.time, distance, color=COLORS["blue"], label="simulated")
        bottom.axhspan(0, band * distance[0], color=COLORS["grey"], alpha=0.2, lw=0)
        bottom.plot(time, error, "D", color=COLORS["orange"], ms=8, label="reported")
        for axes in (top, middle, bottom):
            axes.axvline(time, color=COLORS["orange"], ls=":", lw=1.5)
        top.set(title=f"step at {zoom}")
        bottom.set(yscale="log", xlabel="time (s)")
    for row, name in enumerate(("position (px)", "velocity (µm/s)", "error (µm)")):
        grid[row, 0].set_ylabel(name)
    letter(grid.flat)
    grid[0, -1].legend(loc="lower right")
    grid[2, -1].legend(loc="upper right")
    return figure


def draw_convergence(counts: pd.DataFrame, trials: int, speed: float) -> None:
    """Draw the trials in which ESM alone converges, with 95 % intervals, against the motion.

    Parameters
    ----------
    counts : pandas.DataFrame
        From `compendium.experiments.section_5_3.esm_study`.
    trials : int
        Of each motion and texture.
    speed : float
        Speed that the thesis reports, px/s.
    """
    _, axes = plt.subplots(figsize=(6.4, 3.6))
    for k, (grain, count) in enumerate(counts.items()):
        ends = np.array([binomtest(n, trials).proportion_ci() for n in count])
        color, shares = COLORS[("orange", "blue", "green")[k]], count.to_numpy() / trials
        low, high = 100 * ends.T
        axes.fill_between(counts.index, low, high, color=color, alpha=0.2, lw=0)
        axes.plot(counts.index, 100 * shares, "sov"[k] + "-", color=color, label=f"{grain:g} px")
        axes.text(counts.index[-1] + 0.3, 100 * shares[-1], f"{grain:g} px", va="center")
    at = speed * thesis.FRAME_INTERVAL
    axes.axvline(at, color=COLORS["ink"], ls=":")
    axes.text(at, 103, f"reported: {speed:g} px/s", ha="center", va="bottom")
    axes.text(counts.index[-1] + 0.3, 103, "grain", va="bottom")
    axes.set(xlabel="motion per frame (px)", ylabel="trials that converge (%)", ylim=(-3, 102))
    axes.set_xlim(None, counts.index[-1] + 1.6)
