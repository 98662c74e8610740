"""Drawings of the page on membranes: the printed outline against a shape, and the modulus."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from compendium.experiments.section_5_6 import MODULUS, ShapeComparison
from compendium.figures.style import COLORS
from microlib.embryo import GaussianSum, dimple_geometry


def draw_shape(curve: GaussianSum, shape: ShapeComparison) -> Figure:
    """Draw the printed outline, the profile of its own radius and depth, and what lies between."""
    dimple = dimple_geometry(curve, pixel_size=1.0)
    x1, x2 = dimple.rim[0], dimple.bottom[0]
    across = np.linspace(x1 - 20, 2 * x2 - x1, 500)
    figure, axes = plt.subplots(figsize=(6.4, 5.2))
    axes.plot(across, curve(across), color=COLORS["blue"], lw=3, label="outline of Table 5.5")
    label = "(4.2) with its radius and depth"
    axes.plot(shape.x, shape.expected, "--", color=COLORS["orange"], lw=3, label=label)
    axes.fill_between(shape.x, curve(shape.x), shape.expected, color=COLORS["yellow"], alpha=0.3)
    worst = int(np.abs(curve(shape.x) - shape.expected).argmax())
    x, top, low = shape.x[worst], float(curve(shape.x[worst])), shape.expected[worst]
    axes.annotate("", (x, top), (x, low), arrowprops={"arrowstyle": "<->", "lw": 1.5})
    text = f"{shape.departure:.0f} µm,\n{100 * shape.share:.0f} % of the depth"
    axes.text(x - 3, (top + low) / 2 - 6, text, ha="right", va="center")
    axes.set(xlabel="x (px)", ylabel="y, up (px)", ylim=(57, None))
    axes.legend(loc="lower left")
    return figure


def draw_posterior(supported: Mapping[str, pd.DataFrame]) -> Figure:
    """Draw the moduli (MPa) of draws, a hump each membrane with a bar that holds 95 %."""
    ticks = (0.3, 0.5, 1.0, 2.0, 4.0)
    edges = np.geomspace(ticks[0], ticks[-1], 61)
    figure, axes = plt.subplots(figsize=(6.4, 3.6))
    for place, (name, found) in enumerate(supported.items(), 1):
        share, _ = np.histogram(found["E"], edges, weights=np.full(len(found), 100 / len(found)))
        axes.stairs(share, edges, color=f"C{place - 1}", lw=2, label=f"{name} (bar: 95 %)")
        ends = np.quantile(found["E"], [0.025, 0.975])
        axes.plot(ends, [-0.3 * place] * 2, color=f"C{place - 1}", lw=3)
    axes.axvline(MODULUS, color=COLORS["ink"], ls="--", lw=1.5, label="thesis")
    axes.set(xscale="log", xlim=(ticks[0], ticks[-1]), xlabel="modulus E (MPa)")
    axes.set(ylabel="share of the draws (%)")
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.legend()
    return figure
