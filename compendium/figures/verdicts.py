"""The scorecard as bars: what came of every claim, part by part of the thesis."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from compendium.figures.style import COLORS

__all__ = ["draw_verdicts"]

_PALETTE = {
    "reproduced": COLORS["green"],
    "consistent": COLORS["sky"],
    "bounded": COLORS["blue"],
    "inconclusive": "#C9B68B",
    "differs": COLORS["orange"],
    "erratum": COLORS["pink"],
    "lost": COLORS["grey"],
    "given": "#D9D9D9",
    "pending": COLORS["yellow"],
}
_HATCHES = {"": "", "identified": "////", "assumed": "...."}
_SPENT = {"": "nothing", "identified": "an input identified", "assumed": "an input assumed"}


def draw_verdicts(scorecard: pd.DataFrame) -> Figure:
    """Draw a bar per part, colored by verdict and hatched where something was spent on it."""
    parts = scorecard["part"].unique().tolist()
    figure, axes = plt.subplots(figsize=(7.2, 6.4))
    begin = np.zeros(len(parts), int)
    for kind, color in _PALETTE.items():
        for qualifier, hatch in _HATCHES.items():
            which = (scorecard["verdict"] == kind) & (scorecard["spent"] == qualifier)
            width = np.array([(scorecard["part"][which] == part).sum() for part in parts])
            if not width.any():
                continue
            label = f"{kind} ({qualifier})" if qualifier else kind
            look: dict[str, Any] = {"color": color, "hatch": hatch, "ec": "white", "lw": 0.4}
            axes.barh(parts, width, height=0.72, left=begin, label=label, **look)
            begin += width
    for row, total in enumerate(begin):
        axes.text(total + 0.4, row, str(total), va="center", fontsize=11, color="#444444")
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set(xlabel="number of claims", xlim=(0, 1.06 * begin.max()))
    drawn = [kind for kind in _PALETTE if kind in set(scorecard["verdict"])]
    verdicts = [Patch(color=_PALETTE[kind], label=kind) for kind in drawn]
    spent = [
        Patch(facecolor="#8A8A8A", hatch=hatch, ec="white", lw=0, label=_SPENT[name])
        for name, hatch in _HATCHES.items()
    ]
    plain: dict[str, Any] = {"frameon": False, "alignment": "left", "borderaxespad": 0}
    axes.add_artist(axes.legend(handles=verdicts, title="verdict", loc="upper right", **plain))
    axes.legend(handles=spent, title="spent on it", loc="lower right", **plain)
    return figure
