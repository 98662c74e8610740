"""Drawings of sections 5.1 to 5.4: the workstation, its calibration, tracking and servoing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import binomtest

from compendium import thesis
from compendium.experiments.section_5_3 import fastest_followed
from compendium.figures.calibration import draw_detection
from compendium.figures.panels import boxes, legend_below
from compendium.figures.servoing import draw_track
from compendium.figures.style import COLORS
from compendium.ledger import claim
from microlib.tracking import Track


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


def draw_patterns(taken: Mapping[str, Any]) -> Figure:
    """Draw figure 5.2: each pattern with its detected points, by column of Table 5.1.

    Parameters
    ----------
    taken : mapping of str to Photograph
        ``image`` and ``found`` are drawn.
    """
    figure, grid = plt.subplots(2, 2, figsize=(6.4, 5.8))
    for axes, (column, photo) in zip(grid.flat, taken.items(), strict=True):
        every = 4 if column == "circle-1X" else 6 if "square" in column else 1
        draw_detection(axes, photo.image, photo.found, label_every=every)
        count = len(photo.found.points)
        axes.set_title(f"{thesis.COLUMNS[column]}: {count} points")
    return figure


def draw_blur_study(errors: pd.DataFrame) -> Figure:
    """Draw RMS errors (px, a column each detector) against the blur (px, the index)."""
    figure, axes = plt.subplots(figsize=(6.4, 4.0))
    for name, color, marker in zip(errors, ("blue", "orange", "grey"), "osv", strict=True):
        axes.plot(errors.index, errors[name], color=COLORS[color], marker=marker, label=name)
    axes.set(yscale="log", xlabel="PSF σ (px)", ylabel="RMS error (px)", xlim=(0, 3.1))
    axes.legend()
    return figure


def draw_tracks(shown: list[tuple[str, NDArray[np.uint8], Track]]) -> Figure:
    """Draw figure 5.3: frames with their tracked windows."""
    figure, grid = plt.subplots(len(shown) // 2, 2, figsize=(6.4, 3.6 * (len(shown) // 2)))
    for axes, (label, frame, track) in zip(grid.flat, shown, strict=True):
        draw_track(axes, frame, track, label, margin=60)
        axes.label_outer()
    return figure


def draw_speed_study(shares: pd.DataFrame, runs: int) -> Figure:
    """Draw shares of completed `runs` (a column each way) at each speed (px/s, the index)."""
    figure, axes = plt.subplots(figsize=(6.4, 3.8))
    speeds = shares.index.to_numpy()
    for label, look, aside in zip(shares, ("o", "s"), (-20, 20), strict=True):
        share = shares[label].to_numpy()
        ranges = [binomtest(round(s * runs), runs).proportion_ci() for s in share]
        bars = 100 * np.abs(share - np.array([[r.low, r.high] for r in ranges]).T)
        last = fastest_followed(shares[label])
        following = f"all at {last:g}, next tested {speeds[speeds > last].min():g} px/s"
        how: dict[str, Any] = {"fmt": look, "capsize": 4, "lw": 1.5}
        axes.errorbar(speeds + aside, 100 * share, bars, label=f"{label}: {following}", **how)
    thesis_speed = claim("section-5.3/speed").value
    axes.axvline(thesis_speed, color=COLORS["ink"], ls=":", label=f"thesis: {thesis_speed:g} px/s")
    axes.set(xlabel="speed (px/s)", ylabel="runs completed (%)", ylim=(-5, 105), xticks=speeds)
    legend_below(figure, axes.get_legend_handles_labels()[0], ncols=1)
    return figure
