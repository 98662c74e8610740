"""Drawings of chapter 6: an injection, and depth while acquiring."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from compendium.figures.style import COLORS

__all__ = ["draw_frames_saved", "draw_injection"]


def draw_injection(log: pd.DataFrame, truth: pd.DataFrame, frames: list[NDArray]) -> Figure:
    """Draw pictures of an injection, and force and depth over time beside the truth.

    Parameters
    ----------
    log : DataFrame
        Of `microlib.automation.inject`.
    truth : DataFrame
        ``force`` (µN) and ``depth`` (µm) of each row.
    frames : list of ndarray
        Pictures at the start, at contact and at the target.

    Returns
    -------
    Figure
    """
    figure = plt.figure(figsize=(7.2, 6.0))
    grid = figure.add_gridspec(3, 6, height_ratios=(1.1, 1, 1))
    for k, (frame, name) in enumerate(zip(frames, ("start", "contact", "target"), strict=True)):
        axes = figure.add_subplot(grid[0, 2 * k : 2 * k + 2])
        axes.imshow(frame, vmin=0, vmax=255)
        axes.set_title(name)
        axes.axis("off")
    pressed = log["phase"].isin(["approach", "press", "withdraw"])
    time = log["time_s"]
    contact = time[log["event"] == "contact"]
    for row, (name, column, unit) in enumerate(
        (("force", "force_uN", "µN"), ("depth", "depth_um", "µm"))
    ):
        axes = figure.add_subplot(grid[row + 1, :])
        axes.plot(time[pressed], truth.loc[pressed, name], color=COLORS["grey"], label="truth")
        seen = pressed & log[column].notna()
        axes.plot(
            time[seen], log.loc[seen, column], "o", ms=4, color=COLORS["blue"], label="outline"
        )
        for moment in contact:
            axes.axvline(moment, color=COLORS["orange"], ls="--", label="contact seen")
        axes.set_ylabel(f"{name} ({unit})")
        if row == 0:
            axes.legend(loc="upper left", fontsize=10)
    axes.set_xlabel("time (s)")
    return figure


def draw_frames_saved(table: pd.DataFrame) -> Figure:
    """Draw the share of frames saved by scene and by how the end was known.

    Parameters
    ----------
    table : DataFrame
        ``scene``, ``way`` and ``saved``, % of the whole stack.

    Returns
    -------
    Figure
    """
    figure, axes = plt.subplots(figsize=(7.2, 3.0))
    wide = table.pivot(index="scene", columns="way", values="saved").loc[table["scene"].unique()]
    place = np.arange(len(wide))
    for k, (way, color) in enumerate((("farthest", "blue"), ("coarse", "orange"))):
        label = "greatest height given" if way == "farthest" else "coarse look first"
        axes.bar(place + 0.4 * (k - 0.5), wide[way], 0.38, color=COLORS[color], label=label)
    axes.set_xticks(place, wide.index)
    axes.set_ylabel("frames saved (%)")
    axes.legend(fontsize=10)
    return figure
