"""Drawings of what Tables 5.3 and 5.4 can tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullLocator
from numpy.typing import ArrayLike
from scipy.stats import binom

from compendium.figures.style import COLORS

__all__ = ["draw_identified", "draw_left_out", "draw_ranks", "draw_trades"]

_MODEL_COLORS = ("black", "sky", "blue", "green", "orange")


def draw_left_out(
    names: Sequence[str],
    printed: ArrayLike,
    intervals: Mapping[str, Sequence[Sequence[float]]],
) -> Figure:
    """Draw each number's predictive intervals over the print, which is at one.

    Parameters
    ----------
    names : sequence of str
        Of the numbers.
    printed : array_like, shape (N,)
        The numbers.
    intervals : mapping of str to sequence, shape (N, 3)
        Low end, median and high end of each, by model.

    Returns
    -------
    Figure
        A row each number, a line each model: whole where it holds the print, dotted where not.
    """
    numbers = np.asarray(printed, dtype=float)
    figure, axes = plt.subplots(figsize=(7.2, 0.38 * len(names) + 1.3))
    for k, (model, ends) in enumerate(intervals.items()):
        ratios = np.asarray(ends, dtype=float) / numbers[:, None]
        rows = np.arange(len(names)) + 0.16 * (k - (len(intervals) - 1) / 2)
        color = COLORS[_MODEL_COLORS[k]]
        for row, (low, middle, high) in zip(rows, ratios, strict=True):
            style = "-" if low <= 1 <= high else ":"
            axes.plot([low, high], [row, row], style, color=color, lw=1.8)
            axes.plot(middle, row, "o", ms=3, color=color)
        axes.plot([], [], color=color, label=model)
    axes.axvline(1.0, color="black", lw=1)
    axes.set(xscale="log", xlabel="predicted without it, over printed")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set(yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.4, -0.6))
    axes.tick_params(axis="y", labelsize=10)
    figure.legend(loc="outside upper center", ncols=len(intervals), fontsize=10)
    return figure


def draw_identified(widths: Mapping[str, pd.Series]) -> Figure:
    """Draw how wide each unknown number is after the tables over before, a mark each model."""
    names = list(dict.fromkeys(name for each in widths.values() for name in each.index))
    figure, axes = plt.subplots(figsize=(7.2, 0.3 * len(names) + 1.3))
    for k, (model, each) in enumerate(widths.items()):
        rows = [names.index(name) for name in each.index]
        axes.plot(each.to_numpy(), rows, "osD^v"[k], color=COLORS[_MODEL_COLORS[k]], label=model)
    axes.axvline(1.0, color="black", lw=1)
    axes.set(xlabel="width after the tables over before", xlim=(0, 1.25))
    axes.set(yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.4, -0.6))
    axes.tick_params(axis="y", labelsize=10)
    figure.legend(loc="outside upper center", ncols=len(widths), fontsize=10)
    return figure


def draw_trades(names: Sequence[str], correlation: ArrayLike) -> Figure:
    """Draw which unknown numbers trade: their correlation after the tables, each pair once."""
    matrix = np.asarray(correlation, dtype=float)
    shown = np.where(np.tri(len(names), k=-1, dtype=bool), matrix, np.nan)
    figure, axes = plt.subplots(figsize=(7.2, 5.4))
    image = axes.imshow(shown, cmap="RdBu", vmin=-1, vmax=1)
    axes.set(xticks=range(len(names)), yticks=range(len(names)), yticklabels=names)
    axes.set_xticklabels(names, rotation=90)
    axes.tick_params(labelsize=10)
    axes.grid(False)
    figure.colorbar(image, label="correlation")
    return figure


def draw_ranks(ranks: Mapping[str, ArrayLike], bins: int = 10) -> Figure:
    """Draw how often the truth has each rank among the particles, a line each unknown number.

    Parameters
    ----------
    ranks : mapping of str to array_like, shape (sets, numbers)
        From 0 to 1, by model.
    bins : int
        Of the ranks.

    Returns
    -------
    Figure
        A panel each model; shaded is where 99 % of the counts lie if the ranks are uniform.
    """
    figure, panels = plt.subplots(1, len(ranks), figsize=(7.2, 3.2), sharey=True, squeeze=False)
    for axes, (model, each) in zip(panels[0], ranks.items(), strict=True):
        columns = np.asarray(each, dtype=float).T
        low, high = binom.interval(0.99, columns.shape[1], 1 / bins)
        axes.axhspan(low, high, color=COLORS["grey"], alpha=0.25, lw=0)
        middles = (np.arange(bins) + 0.5) / bins
        for column in columns:
            counts, _ = np.histogram(column, bins, (0, 1))
            axes.plot(middles, counts, color=COLORS["blue"], lw=0.8, alpha=0.7)
        axes.set(title=model, xlabel="rank of the truth", ylim=(0, None))
    panels[0, 0].set_ylabel("data sets")
    return figure
