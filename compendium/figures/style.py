"""One look for every figure of the book: legible, colour-blind safe, with room for labels."""

from __future__ import annotations

import matplotlib as mpl
import pandas as pd
from cycler import cycler

#: Okabe and Ito's colours, distinguishable with every common colour deficiency.
COLORS = {
    "blue": "#0072B2",
    "orange": "#D55E00",
    "green": "#009E73",
    "pink": "#CC79A7",
    "yellow": "#E69F00",
    "sky": "#56B4E9",
    "grey": "#6E6E6E",
    "black": "#000000",
}


def use_style() -> None:
    """Set figures and tables up for the book: the body's font size, tight boxes, whole texts."""
    pd.set_option("display.max_colwidth", None, "display.max_rows", 80)
    mpl.rcParams.update(
        {
            "figure.figsize": (6.4, 4.2),  # on a phone 12 points are then 9 px
            "figure.dpi": 110,
            "figure.constrained_layout.use": True,
            "savefig.bbox": "tight",
            "savefig.pad_inches": 0.05,
            "axes.formatter.min_exponent": 5,  # 0.01, not 10 with a small exponent
            "font.size": 12,
            "axes.titlesize": 12,
            "axes.grid": True,
            "axes.axisbelow": True,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "grid.alpha": 0.3,
            "image.cmap": "gray",
            "legend.frameon": False,
            "lines.linewidth": 2.0,
            "axes.prop_cycle": cycler(color=[v for k, v in COLORS.items() if k != "black"]),
            "svg.hashsalt": "microlib",
        }
    )
