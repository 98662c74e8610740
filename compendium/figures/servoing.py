"""Drawings of chapters 2 and 5 about tracking and servoing."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from compendium import thesis
from compendium.figures.panels import SYMBOL, arrows, boxes, legend_below, letter, photograph
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


def draw_path_runs(runs: dict[str, Any]) -> Figure:
    """Draw figures 5.6 to 5.8: each path at 1X with its reference, and its error against time.

    The reported mean of the error is a line in a band of the reported standard deviation.

    Parameters
    ----------
    runs : dict of str to Simulation
        By path.
    """
    pixel = thesis.effective_pixel("1X")
    figure, grid = plt.subplots(len(runs), 2, figsize=(6.4, 2.2 * len(runs)), squeeze=False)
    for (name, run), (left, right) in zip(runs.items(), grid, strict=True):
        start = run.reference[0]
        # The measurement hardly leaves the reference, which therefore lies on top of it.
        left.plot(*(run.measured - start).T, "o", color=COLORS["sky"], ms=6, label="measured")
        left.plot(*(run.reference - start).T, color=COLORS["ink"], lw=1.4, label="reference")
        left.set(xlabel="x (px)", ylabel="y (px)", title=name)
        left.set_aspect("equal", adjustable="datalim")  # all paths get panels of one size
        error = pixel * np.linalg.norm(run.measured[:-1] - run.reference[1:], axis=1)
        right.plot(run.time[:-1], error, color=COLORS["blue"], lw=1.2, label="simulated")
        mean, std = (claim(f"table-5.4/1X/{name}/{w}").value for w in ("accuracy", "precision"))
        right.axhline(mean, color=COLORS["orange"], ls="--", label="reported mean")
        right.axhspan(mean - std, mean + std, color=COLORS["orange"], alpha=0.2, lw=0)
        right.set(xlabel="time (s)", ylabel="error (µm)", ylim=(0, None))
    letter(grid.flat)
    legend_below(figure, [h for ax in grid[0] for h in ax.get_legend_handles_labels()[0]], ncols=4)
    return figure


def draw_stability(moduli: pd.DataFrame, loops: pd.DataFrame, gain: float) -> Figure:
    """Draw where a delayed loop is stable.

    Parameters
    ----------
    moduli : DataFrame
        Modulus of the slowest pole, by loop gain (rows) and delay in frames (columns).
    loops : DataFrame
        ``delay`` and ``gain`` of simulated loops, and whether each ``decays``.
    gain : float
        Of the thesis' loop.

    Returns
    -------
    Figure
        A map with its stability limit, and the simulated loops on it.
    """
    delays, gains = moduli.columns, moduli.index
    figure, axes = plt.subplots(figsize=(6.4, 4.6))
    # White at 1, where the loop neither decays nor grows; blue is stable and orange is not.
    shades = axes.contourf(delays, gains, moduli, levels=np.arange(0, 2.01, 0.2), cmap="PuOr_r")
    axes.contour(delays, gains, moduli, levels=[1.0], colors="black", linewidths=2.5)
    for decays, marker in ((True, "o"), (False, "X")):
        chosen = loops.loc[loops["decays"] == decays, ["delay", "gain"]].to_numpy()
        label = "simulated: decays" if decays else "simulated: grows"
        axes.plot(*chosen.T, marker, color="white", mec="black", mew=1.2, ms=8, label=label)
    axes.axhline(gain, color="black", ls="--", lw=1.4)
    figure.colorbar(shades, label="modulus of the slowest pole", ticks=np.arange(0, 2.01, 0.4))
    axes.set(xlabel="delay (frames)", ylabel="loop gain g", ylim=(gains[0], gains[-1]))
    axes.grid(False)
    for x, y, name in ((0.12, 0.57, "stable"), (0.52, 0.76, "unstable")):
        axes.text(
            x,
            y,
            name,
            transform=axes.transAxes,
            fontsize=14,
            weight="bold",
            va="center",
            color="black",
        )
    # The line of the legend is on the page's ground, which may be dark.
    look: dict[str, Any] = {"color": COLORS["ink"], "ls": "--", "lw": 1.4}
    reported = Line2D([], [], label="gain of the thesis at 1X", **look)
    legend_below(figure, [*axes.get_legend_handles_labels()[0], reported], ncols=2)
    return figure


def draw_esm_step(errors: pd.DataFrame) -> Figure:
    """Draw one step of ESM along a row of pixels, and the errors of an image's corners after each.

    Parameters
    ----------
    errors : DataFrame
        As `errors_by_gradient` returns it, px.
    """
    figure, (left, right) = plt.subplots(1, 2, figsize=(6.4, 4.1))
    x, shift = np.linspace(-2, 8.5, 200), 4.0  # px; the image is the template, moved by the shift
    grey = 100 + 60 * np.sin(x / 3.5)
    value, goal = 100.0, 100 + 60 * np.sin(shift / 3.5)
    # Of the template and of the image at 0.
    slopes = 60 / 3.5 * np.array([np.cos(shift / 3.5), 1.0])
    left.plot(x, grey, color=COLORS["ink"], lw=1.4, label="image")
    left.axhline(goal, color=COLORS["grey"], lw=1.2, ls=":")
    left.text(-1.9, goal + 5, "template at 0")
    looks = (("orange", "--"), ("sky", "-."), ("blue", "-"))
    for slope, (color, line) in zip((*slopes, slopes.mean()), looks, strict=True):
        end = (goal - value) / slope
        left.plot([0, end], [value, goal], line, color=COLORS[color])
        left.plot([end], [goal], "o", color=COLORS[color], ms=7)
    left.plot([shift], [goal], "o", mfc="none", mec=COLORS["ink"], ms=14, mew=1.6)
    left.set(xlabel="shift (px)", ylabel="grey value", title="one step", ylim=(65, 168))
    for name, (color, line) in zip(errors, looks, strict=True):
        label = f"gradient: {name}"
        right.plot(errors.index, errors[name], line, color=COLORS[color], marker="o", label=label)
    right.set(yscale="log", xlabel="step", ylabel="error of the corners (px)", title="all steps")
    letter((left, right))
    legend_below(figure, right.get_legend_handles_labels()[0], ncols=2)
    return figure


def draw_kalman_step(track: pd.DataFrame, noise: float) -> Figure:
    """Draw a track with its predictions, and how the last one meets the measurement."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(6.4, 3.9))
    last, track = track.iloc[-1], track.iloc[1:]  # of the first frame anything is expected
    look: dict[str, Any] = {"color": COLORS["orange"], "capsize": 4, "lw": 1.5}
    where, spread = (track["frame"], track["predicted"]), track["predicted_std"]
    left.errorbar(*where, yerr=spread, fmt="s", label="predicted, ± σ", **look)
    left.plot(track["frame"], track["measured"], "o", color=COLORS["blue"], label="measured")
    left.plot(track["frame"], track["true"], color=COLORS["ink"], lw=1.2, label="true")
    left.set(xlabel="frame", ylabel="x (px)", title="a track", ylim=(None, 26))
    left.legend(loc="upper left")
    bells = {
        "predicted": (last["predicted"], last["predicted_std"], "orange", "--"),
        "measured": (last["measured"], noise, "blue", "-."),
        "estimated": (last["estimated"], last["estimated_std"], "ink", "-"),
    }
    reach, middle = 3 * max(last["predicted_std"], noise), last["estimated"]
    x = np.linspace(middle - 1.2 * reach, middle + 1.2 * reach, 300)
    for name, (mean, std, color, line) in bells.items():
        density = np.exp(-(((x - mean) / std) ** 2) / 2) / (std * np.sqrt(2 * np.pi))
        right.plot(x, density, line, color=COLORS[color], label=name)
    right.set(xlabel="x (px)", ylabel="probability density (1/px)", title="its last frame")
    right.set(ylim=(0, 1.45 * np.max(density)))
    letter((left, right))
    right.legend(loc="upper left")
    return figure
