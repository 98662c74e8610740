"""Draw book/_static/readme.png from the thesis' printed coefficients: ``make picture``."""

from __future__ import annotations

import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from compendium import ledger, thesis
from compendium.figures import COLORS, use_style
from microlib.embryo import dimple_geometry
from microlib.membrane import SmallSlopeWarning

warnings.simplefilter("ignore", SmallSlopeWarning)
use_style()
curve, pixel = thesis.outline_curve(), thesis.EMBRYO_PIXEL
dimple = dimple_geometry(curve, pixel_size=pixel)
modulus = thesis.modulus(dimple.dimple_radius, dimple.dimple_depth)
x = np.linspace(*curve.domain, 600)
(x1, y1), (x2, y2) = dimple.rim, dimple.bottom
fig, ax = plt.subplots(figsize=(8.4, 3.4))
ax.fill_between(x * pixel, 0, curve(x) * pixel, color=COLORS["sky"], alpha=0.25, lw=0)
ax.plot(x * pixel, curve(x) * pixel, color=COLORS["blue"], lw=3)
ax.plot([x1 * pixel, x2 * pixel], [y1 * pixel, y2 * pixel], "o", color=COLORS["orange"], ms=9)
arrow = {"arrowstyle": "<->", "lw": 1.4, "shrinkA": 0, "shrinkB": 0}
ax.annotate("", (x1 * pixel, y1 * pixel + 25), (x2 * pixel, y1 * pixel + 25), arrowprops=arrow)
ax.text((x1 + x2) / 2 * pixel, y1 * pixel + 34, f"a = {dimple.dimple_radius:.0f} µm", ha="center")
ax.annotate("", (x2 * pixel, y1 * pixel), (x2 * pixel, y2 * pixel), arrowprops=arrow)
ax.text(x2 * pixel + 12, y1 * pixel + 20, f"$w_d$ = {dimple.dimple_depth:.0f} µm")
ax.text(
    x2 * pixel,
    70,
    f"E = {modulus:.3f} MPa from Table 5.5; printed: {ledger.claim('table-5.6/E').printed}",
    ha="center",
)
ax.set(xlabel="x (µm)", ylabel="height (µm)", aspect="equal", ylim=(0, 440))
ax.grid(False)
fig.savefig(
    Path(__file__).resolve().parents[1] / "book" / "_static" / "readme.png",
    dpi=110,
    metadata={"Software": None},
)
