"""The bars of chapter 6 count the scorecard."""

from __future__ import annotations

from itertools import product

import pandas as pd
from matplotlib.colors import to_rgba

from compendium.figures import verdicts
from compendium.figures.verdicts import draw_verdicts


def test_each_bar_is_as_long_as_its_claims_are_many():
    parts = ["2", "5.2", "5.4"]
    kinds = ["reproduced", "consistent", "differs", "lost"]
    spent = ["", "identified", "assumed"]
    # Another number of claims for each of the 36 cells, one of them empty.
    cells = {cell: 2 * k % 37 for k, cell in enumerate(product(parts, kinds, spent))}
    rows = [cell for cell, count in cells.items() for _ in range(count)]
    figure = draw_verdicts(pd.DataFrame(rows, columns=["part", "verdict", "spent"]))
    (axes,) = figure.axes
    shown = {part: k for k, part in enumerate(axes.yaxis.get_ticklabels())}
    assert [label.get_text() for label in shown] == parts
    drawn = {}
    for container in axes.containers:
        for row, bar in enumerate(container.patches):
            kind = next(
                kind
                for kind in kinds
                if to_rgba(verdicts._PALETTE[kind]) == to_rgba(bar.get_facecolor())
            )
            how = next(
                name for name, hatch in verdicts._HATCHES.items() if hatch == bar.get_hatch()
            )
            drawn[parts[row], kind, how] = (bar.get_x(), bar.get_width())
    assert {cell: width for cell, (_, width) in drawn.items()} == cells
    # In a row each bar begins where the one before ends, and the last end is written beside it.
    for row, part in enumerate(parts):
        ends = sorted((x, x + w) for cell, (x, w) in drawn.items() if cell[0] == part)
        assert [x for x, _ in ends[1:]] == [end for _, end in ends[:-1]]
        total = sum(count for cell, count in cells.items() if cell[0] == part)
        # Beside the bar's end and not on it.
        said = [t.get_position() for t in axes.texts if t.get_text() == str(total)]
        assert (total + 0.4, row) in said
    titles = [legend.get_title().get_text() for legend in axes.findobj(type(axes.get_legend()))]
    assert sorted(titles) == ["spent on it", "verdict"]
