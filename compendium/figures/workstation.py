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
from compendium.figures.panels import SYMBOL, boxes, legend_below
from compendium.figures.servoing import draw_track
from compendium.figures.style import COLORS
from compendium.ledger import claim
from microlib.tracking import Track

#: Parameters of Table 5.1 as the text writes them.
SYMBOLS = {"kappa": "κ", "alpha": "α", "beta": "β", "gamma": "γ", "T_op": "$T_{op}$"}
SYMBOLS |= {f"T_{axis}": f"$T_{axis}$" for axis in "xyz"}
#: How far the axes of its drawing reach, in units of the error and in per cent.
REACH = 1.5


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


def draw_table_5_1(entries: pd.DataFrame) -> Figure:
    """Draw how far Table 5.1 is from what images and printed lengths give.

    Parameters
    ----------
    entries : pandas.DataFrame
        Of `compendium.experiments.section_5_2.table_5_1`. What the images give is drawn in units of
        its error, the half of a 95 % interval; what follows from the lengths in per cent.
    """
    place = entries["claim"].str.split("/", expand=True)
    printed = np.array([claim(id).value for id in entries["claim"]])
    off, error = entries["value"] - printed, (entries["high"] - entries["low"]) / 2
    figure, panels = plt.subplots(1, 2, figsize=(6.4, 5.4), width_ratios=(1.2, 1))
    scales = {True: off / error, False: 100 * off / abs(printed)}
    for axes, (given, scaled) in zip(panels, scales.items(), strict=True):
        chosen = entries["input"] == given
        names = list(place.loc[chosen, 2].unique())
        for k, (column, title) in enumerate(thesis.COLUMNS.items()):
            part = chosen & (place[1] == column)
            height = [0.2 * (1.5 - k) - names.index(name) for name in place.loc[part, 2]]
            shown = scaled[part].clip(-REACH, REACH)
            axes.plot(shown, height, "osD^"[k], color=f"C{k}", ms=7, label=title)
            for value, x, y in zip(scaled[part], shown, height, strict=True):
                if value != x:  # further off than the axis reaches
                    axes.annotate(
                        f"← {value:.0f} %".replace("-", "−"),
                        (x, y),
                        (8, 0),
                        textcoords="offset points",
                    )
        ticks = [SYMBOLS.get(name, name) for name in names]
        axes.set_yticks(-np.arange(len(names)), ticks, fontsize=SYMBOL)
        axes.axvline(0, color=COLORS["ink"], lw=1)
        axes.set(xlim=(-REACH, REACH))
    panels[0].axvspan(-1, 1, color=COLORS["green"], alpha=0.15, lw=0)
    panels[0].set(title="found in the images", xlabel="difference (errors of 95 %)")
    panels[1].set(title="follow from the lengths", xlabel="difference (%)")
    legend_below(figure, panels[0].get_legend_handles_labels()[0], ncols=2)
    return figure


def draw_printed_and_recomputed(panels: Mapping[str, pd.DataFrame]) -> Figure:
    """Draw recomputed beside printed numbers as dots with their 95 % intervals.

    Parameters
    ----------
    panels : mapping of str to pandas.DataFrame
        By title: ``claim`` (id), ``value``, ``low`` and ``high`` in the printed unit, and
        ``input``, whether the simulation was given the printed number; such dots are hollow.
    """
    rows = max(map(len, panels.values()))
    size = (6.4, 1.4 + 0.3 * rows)
    figure, grid = plt.subplots(1, len(panels), figsize=size, squeeze=False, sharex=True)
    ticks, ends = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2], [0.25, 2.0]
    for axes, (title, table) in zip(grid.flat, panels.items(), strict=True):
        printed = np.array([claim(id).value for id in table["claim"]])
        value, low, high = (table[name].to_numpy() / printed for name in ("value", "low", "high"))
        place = -np.arange(len(table))
        axes.axvline(1, color=COLORS["ink"], lw=1)
        for given, look in (
            (True, {"mfc": "none", "label": "input"}),
            (False, {"label": "computed"}),
        ):
            at = (table["input"] == given).to_numpy()
            if at.any():
                axes.hlines(place[at], low[at], high[at], color=COLORS["blue"], lw=1.5)
                axes.plot(value[at], place[at], "o", color=COLORS["blue"], **look)
        axes.set_yticks(place, [" ".join(id.split("/")[1:]) for id in table["claim"]])
        ends.extend([low.min(), high.max()])
        axes.set(title=title, xlabel="recomputed / printed", xscale="log", ylim=(0.6 - rows, 0.4))
        axes.set_xticks(ticks, list(map(str, ticks)))
        axes.set_xlim(0.9 * min(ends), 1.1 * max(ends))
        axes.minorticks_off()
    legend_below(figure)
    return figure
