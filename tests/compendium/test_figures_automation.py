"""Drawings of an injection and of frames saved: what they show is what they were given."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

from compendium.figures.automation import draw_frames_saved, draw_injection


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def test_an_injection_is_drawn_beside_its_truth():
    log = pd.DataFrame(
        {
            "time_s": [0.0, 1.0, 2.0, 3.0, 4.0],
            "phase": ["start", "approach", "press", "press", "end"],
            "event": ["", "contact", "", "reached", "done"],
            "force_uN": [np.nan, np.nan, 5.0, 9.0, np.nan],
            "depth_um": [np.nan, 0.5, 4.0, 8.0, np.nan],
        }
    )
    truth = pd.DataFrame({"force": [0.0, 0.1, 5.5, 9.5, 9.5], "depth": [0.0, 0.0, 4.5, 8.5, 8.5]})
    figure = draw_injection(log, truth, [np.zeros((4, 5))] * 3)
    *pictures, force, depth = figure.axes
    assert [axes.get_title() for axes in pictures] == ["start", "contact", "target"]
    np.testing.assert_array_equal(force.lines[0].get_xydata(), [[1, 0.1], [2, 5.5], [3, 9.5]])
    np.testing.assert_array_equal(force.lines[1].get_xydata(), [[2, 5.0], [3, 9.0]])
    np.testing.assert_array_equal(depth.lines[1].get_ydata(), [0.5, 4.0, 8.0])
    assert force.lines[2].get_xdata()[0] == 1.0
    assert (force.get_ylabel(), depth.get_ylabel()) == ("force (µN)", "depth (µm)")
    # One legend for both.
    names = [text.get_text() for text in force.get_legend().get_texts()]
    assert names == ["truth", "outline", "contact seen"]
    assert depth.get_legend() is None
    assert [axes.get_xlabel() for axes in (force, depth)] == ["", "time (s)"]


def test_bars_are_the_frames_saved_in_the_order_of_the_scenes():
    rows = [("step", "farthest", 50.0), ("step", "coarse", 30.0)]
    rows += [("cone", "farthest", 52.0), ("cone", "coarse", 31.0)]
    figure = draw_frames_saved(pd.DataFrame(rows, columns=["scene", "way", "saved"]))
    (axes,) = figure.axes
    assert [bar.get_height() for bar in axes.patches] == [50.0, 52.0, 30.0, 31.0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["step", "cone"]


def test_bars_stand_beside_each_other_under_their_names():
    table = pd.DataFrame(
        {"scene": ["cone"] * 2, "way": ["coarse", "farthest"], "saved": [31.0, 52.0]}
    )
    (axes,) = draw_frames_saved(table).axes
    left, right = axes.patches
    assert [bar.get_x() + bar.get_width() / 2 for bar in axes.patches] == pytest.approx([-0.2, 0.2])
    assert left.get_width() < 0.4  # with a gap
    assert [bar.get_height() for bar in (left, right)] == [52.0, 31.0]
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == ["greatest height given", "coarse look first"]
    assert axes.get_ylabel() == "frames saved (%)"
