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
from compendium.figures.panels import letter, photograph
from compendium.figures.style import COLORS
from compendium.ledger import claim
from microlib.tracking import Track


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
