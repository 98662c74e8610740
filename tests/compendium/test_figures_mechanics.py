"""The drawing of the modulus' posterior: shares that add up, and every input from the middle on."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium.experiments.section_5_6 import MODULUS
from compendium.figures.mechanics import draw_modulus_posterior
from compendium.figures.style import COLORS

CAPSULE = pd.DataFrame({"E": np.geomspace(0.5, 0.9, 200)})
DISC = pd.DataFrame({"E": np.geomspace(1.5, 2.5, 50)})
READINGS = pd.DataFrame(
    {
        "input": ["middle", "crest of the rim", "thickness"],
        "one": [1.0, 0.8, np.nan],
        "other": [1.0, 1.3, 1.5],
    }
)


@pytest.fixture
def axes():
    figure = draw_modulus_posterior(CAPSULE, DISC, READINGS)
    yield figure.axes
    plt.close(figure)


def test_shares_add_up_and_lie_where_the_draws_do(axes):
    for steps, draws in zip(axes[0].patches, (CAPSULE, DISC), strict=True):
        values, edges, _ = steps.get_data()
        assert values.sum() == pytest.approx(100)
        expected, _ = np.histogram(draws["E"], edges)
        np.testing.assert_allclose(values, 100 * expected / len(draws))
        np.testing.assert_allclose([edges[0], edges[-1], len(edges)], [0.3, 4.0, 61])
        assert np.ptp(np.diff(np.log(edges))) < 1e-12


def test_bars_are_the_middle_95_per_cent_in_the_color_of_their_draws(axes):
    bars = [line for line in axes[0].lines if line.get_transform() == axes[0].transData]
    assert [line.get_color() for line in bars] == [COLORS["blue"], COLORS["orange"]]
    for line, draws, height in zip(bars, (CAPSULE, DISC), (-0.3, -0.6), strict=True):
        np.testing.assert_allclose(line.get_xdata(), np.quantile(draws["E"], [0.025, 0.975]))
        np.testing.assert_allclose(line.get_ydata(), height)
    words = [text.get_text() for text in axes[0].get_legend().get_texts()]
    assert words == ["capsule (bar: 95 %)", "disc (bar: 95 %)", "printed"]


def test_each_input_goes_from_the_middle_to_its_ends(axes):
    bars = [(b.get_x(), b.get_width(), b.get_y() + b.get_height() / 2) for b in axes[1].patches]
    # The thinnest wall has no capsule: it is said instead of drawn.
    np.testing.assert_allclose(bars, [[1, -0.2, 0], [1, 0.3, 0], [1, 0.5, -1]], atol=1e-12)
    (said,) = axes[1].texts
    assert said.get_text() == "no capsule"
    np.testing.assert_allclose(said.get_position(), (1.03, -1))
    assert [label.get_text() for label in axes[1].get_yticklabels()] == [
        "crest of the rim",
        "thickness",
    ]
    np.testing.assert_array_equal(axes[1].get_yticks(), [0, -1])
    assert axes[1].get_xscale() == "log"
    assert axes[1].get_xlim() == (0.3, 4.0)
    for panel in axes:
        assert MODULUS in [line.get_xdata()[0] for line in panel.lines if len(line.get_xdata())]
