"""Drawing of section 5.6: what modulus the printed outline supports."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from compendium.experiments.section_5_6 import MODULUS
from compendium.figures.style import COLORS

__all__ = ["draw_modulus_posterior"]

_TICKS = (0.3, 0.5, 1.0, 2.0, 4.0)


def draw_modulus_posterior(
    capsule: pd.DataFrame, disc: pd.DataFrame, readings: pd.DataFrame
) -> Figure:
    """Draw posteriors of E, and below, how far one input at a time moves it.

    Parameters
    ----------
    capsule, disc : pandas.DataFrame
        From `compendium.experiments.section_5_6_mechanics.modulus_posterior`.
    readings : pandas.DataFrame
        From `single_readings` there.

    Returns
    -------
    Figure
        Both over one logarithmic axis of E, with the printed modulus.
    """
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(7.2, 6.0), sharex=True)
    edges = np.geomspace(_TICKS[0], _TICKS[-1], 61)
    for name, found, color in (("capsule", capsule, "blue"), ("disc", disc, "orange")):
        share, _ = np.histogram(found["E"], edges, weights=np.full(len(found), 1 / len(found)))
        upper.stairs(100 * share, edges, color=COLORS[color], lw=2, label=f"{name} (bar: 95 %)")
        ends = np.quantile(found["E"], [0.025, 0.975])
        height = {"capsule": -0.3, "disc": -0.6}[name]
        upper.plot(ends, [height, height], color=COLORS[color], lw=3)
    upper.set(ylabel="share of the draws (%)", ylim=(-0.9, None))
    middle = readings["one"].iloc[0]
    for place, (_, row) in enumerate(readings.iloc[1:].iterrows()):
        for end in (row["one"], row["other"]):
            if np.isfinite(end):
                lower.barh(-place, end - middle, left=middle, height=0.6, color=COLORS["sky"])
            else:
                lower.text(1.03 * middle, -place, "no capsule", va="center", fontsize=11)
    lower.set_yticks(range(0, 1 - len(readings), -1), readings["input"].iloc[1:])
    lower.axvline(middle, color=COLORS["blue"], lw=1.2)
    for axes in (upper, lower):
        axes.axvline(MODULUS, color="black", ls="--", lw=1.5, label="printed")
    upper.legend(loc="upper right")
    lower.set(xscale="log", xlabel="modulus E (MPa)", xlim=(_TICKS[0], _TICKS[-1]))
    lower.set_xticks(_TICKS, [f"{tick:g}" for tick in _TICKS])
    lower.minorticks_off()
    return figure
