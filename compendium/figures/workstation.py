"""Drawings of sections 5.1 to 5.4: the workstation, its calibration, tracking and servoing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from compendium import thesis
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
    axes.plot([4.6, 4.6], [1.65, 3.5], color="black", lw=1, ls=":")
    axes.plot([7.0, 4.9], [3.8, 1.9], color="black", lw=1, ls=":")
    axes.plot([2.0, 4.1], [2.0, 1.75], color=COLORS["orange"], lw=3)
    axes.plot([7.2, 5.1], [2.0, 1.75], color=COLORS["orange"], lw=3)
    axes.text(2.2, 2.25, "probe")
    axes.text(6.2, 2.25, "gripper", ha="left")
    axes.plot(4.6, 1.62, "o", color="black", ms=7)
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


def draw_speed_study(shares: pd.DataFrame) -> Figure:
    """Draw shares of completed runs (a column each way) against the speed (px/s, the index)."""
    figure, axes = plt.subplots(figsize=(6.4, 3.2))
    for label, style in zip(shares, ("o-", "s--"), strict=True):
        axes.plot(shares.index, 100 * shares[label], style, label=label)
    axes.axvline(claim("section-5.3/speed").value, color="black", ls=":", label="thesis")
    axes.set(xlabel="speed (px/s)", ylabel="runs completed (%)", ylim=(-5, 105))
    axes.legend(loc="lower left", bbox_to_anchor=(0.1, 0.1))
    return figure


def draw_printed_and_recomputed(
    panels: Mapping[str, pd.DataFrame], *, percent: bool = False
) -> Figure:
    """Draw recomputed beside printed numbers as dots with their 95 % intervals.

    Parameters
    ----------
    panels : mapping of str to pandas.DataFrame
        By title: ``claim`` (id), ``value``, ``low`` and ``high`` in the printed unit, and
        ``input``, whether the simulation was given the printed number; such dots are hollow.
    percent : bool
        Draw the deviation in per cent, of panels with the same rows, instead of the ratio.
    """
    rows, deep = max(map(len, panels.values())), -(-len(panels) // 2)
    how: dict[str, Any] = {"squeeze": False, "sharex": True, "sharey": percent}
    how["figsize"] = (6.4, 0.8 + deep * (0.6 + 0.3 * rows))
    figure, grid = plt.subplots(deep, min(2, len(panels)), **how)
    for axes in grid[-1]:
        axes.set_xlabel("deviation (%)" if percent else "recomputed / printed")
    ends = [0.25, 2.0]
    for axes, (title, table) in zip(grid.flat, panels.items(), strict=True):
        printed = np.array([claim(id).value for id in table["claim"]])
        value, low, high = (table[name].to_numpy() / printed for name in ("value", "low", "high"))
        if percent:
            value, low, high = (100 * (ratio - 1) for ratio in (value, low, high))
        place = -np.arange(len(table))
        axes.axvline(0 if percent else 1, color="black", lw=1)
        for given, face, label in ((True, "white", "input"), (False, COLORS["blue"], "computed")):
            at = (table["input"] == given).to_numpy()
            if not at.any():
                continue
            axes.hlines(place[at], low[at], high[at], color=COLORS["blue"], lw=1.5)
            axes.plot(value[at], place[at], "o", color=COLORS["blue"], mfc=face, label=label)
        names = [id.split("/")[2 if percent else 1 :] for id in table["claim"]]
        axes.set_yticks(place, map(" ".join, names))
        axes.set_title(title)
        axes.set_ylim(0.6 - rows, 0.4)
        if percent:
            axes.set_xscale("symlog", linthresh=0.01)
            axes.set_xticks([-10, -0.1, 0, 0.1, 10], ["−10", "−0.1", "0", "0.1", "10"])
        else:
            axes.set_xscale("log")
            axes.set_xticks(ticks := [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2], list(map(str, ticks)))
            ends.extend([low.min(), high.max()])
            axes.set_xlim(0.9 * min(ends), 1.1 * max(ends))
        axes.minorticks_off()
    legend_below(figure)
    return figure
