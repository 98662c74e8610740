"""What the tables can tell: intervals over the print, widths, and counts of ranks."""

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium.figures import inference


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def test_intervals_are_drawn_over_the_print():
    ends = {"base": [[1.0, 2.0, 3.0], [5.0, 6.0, 8.0]], "other": [[2.5, 3.0, 4.0], [1.0, 2.0, 5.0]]}
    axes = inference.draw_left_out(["one", "two"], [2.0, 4.0], ends).axes[0]
    lines = [line for line in axes.lines if len(line.get_xdata()) == 2]
    found = [(*line.get_xdata(), line.get_linestyle()) for line in lines]
    assert found[:4] == [
        (0.5, 1.5, "-"),
        (1.25, 2.0, ":"),
        (1.25, 2.0, ":"),
        (0.25, 1.25, "-"),
    ]
    rows = np.array([line.get_ydata()[0] for line in lines[:4]])
    np.testing.assert_allclose(rows.round(), [0, 1, 0, 1])
    assert (rows[2:] > rows[:2]).all()
    assert [label.get_text() for label in axes.get_yticklabels()] == ["one", "two"]
    assert axes.get_xscale() == "log"
    assert axes.yaxis_inverted()
    assert axes.lines[-1].get_xdata() == [1.0, 1.0]


def test_widths_stand_in_the_row_of_their_number():
    widths = {
        "base": pd.Series([0.5, 0.9], ["latency", "noise"]),
        "other": pd.Series([0.4, 0.8, 0.2], ["latency", "noise", "rate"]),
    }
    axes = inference.draw_identified(widths).axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["latency", "noise", "rate"]
    drawn = {line.get_label(): line.get_xydata() for line in axes.lines}
    np.testing.assert_allclose(drawn["base"], [[0.5, 0], [0.9, 1]])
    np.testing.assert_allclose(drawn["other"], [[0.4, 0], [0.8, 1], [0.2, 2]])


def test_ranks_are_counted_beside_what_chance_allows():
    ranks = np.column_stack([(np.arange(100) + 0.5) / 100, np.full(100, 0.95)])
    axes = inference.draw_ranks({"base": ranks}).axes[0]
    np.testing.assert_allclose(axes.lines[0].get_ydata(), 10)
    np.testing.assert_allclose(axes.lines[1].get_ydata(), [0] * 9 + [100])
    band = axes.patches[0]
    # 99 % of a binomial of 100 at a tenth: 3 to 18.
    assert (band.get_y(), band.get_y() + band.get_height()) == (3, 18)


def test_each_pair_that_trades_is_drawn_once():
    correlation = [[1.0, -0.7, 0.2], [-0.7, 1.0, 0.1], [0.2, 0.1, 1.0]]
    axes = inference.draw_trades(["a", "b", "c"], correlation).axes[0]
    shown = np.ma.filled(axes.images[0].get_array(), np.nan)
    np.testing.assert_array_equal(shown, [[np.nan] * 3, [-0.7, np.nan, np.nan], [0.2, 0.1, np.nan]])
    assert axes.images[0].get_clim() == (-1, 1)
    assert [label.get_text() for label in axes.get_xticklabels()] == ["a", "b", "c"]
