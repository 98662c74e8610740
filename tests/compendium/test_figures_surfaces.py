"""The drawing of surfaces: what reaches the browser, and that colours and legends are complete."""

import json
import re

import matplotlib as mpl
import numpy as np

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium.figures.surfaces import (
    HK_COLORS,
    draw_labels,
    turnable_surface,
)
from microlib.curvature import HK_NAMES


def test_a_turnable_surface_is_small_and_brings_no_library():
    height = 500 * np.random.default_rng(0).random((300, 450))
    height[0, 0] = np.nan
    html = turnable_surface(height, 2.0, name="surface-x", title="A surface").data
    assert 'id="surface-x"' in html
    assert "plotly-graph-div" in html
    assert "<script src" not in html
    assert len(html) < 100_000
    data = json.loads(
        re.search(r"Plotly\.newPlot\(\s*\"surface-x\",\s*(\[.*?\]),\s*\{", html, re.S)[1]
    )
    z = np.array(data[0]["z"], dtype=float)
    assert max(z.shape) <= 100
    assert np.isnan(z[0, 0])
    # Rounded to a thousandth of the range at least, and on the points it says.
    np.testing.assert_allclose(z[1:, 1:], height[5::5, 5::5], atol=0.5)
    assert data[0]["x"][1] == 10.0


def test_every_type_has_a_color_and_the_legend_names_those_that_occur():
    assert len(set(HK_COLORS)) == len(HK_COLORS) == 1 + len(HK_NAMES)
    figure, axes = plt.subplots()
    draw_labels(axes, np.array([[0, 1], [5, 9]], np.uint8))
    shown = [text.get_text() for text in axes.get_legend().get_texts()]
    assert shown == ["1 convex elliptic", "5 planar", "9 saddle valley"]
    colors = axes.images[0].to_rgba(axes.images[0].get_array())
    np.testing.assert_allclose(colors[1, 1], mpl.colors.to_rgba(HK_COLORS[9]), atol=0.01)
    plt.close(figure)
