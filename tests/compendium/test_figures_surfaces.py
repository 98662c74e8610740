"""The drawing of surfaces: what reaches the browser, and that colours and legends are complete."""

import json
import re

import matplotlib as mpl
import numpy as np
import pytest

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium.figures.surfaces import (
    HK_COLORS,
    draw_labels,
    draw_sinking_stage,
    draw_surface,
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


def test_the_same_surface_gives_the_same_text():
    height = np.random.default_rng(1).random((20, 20))
    labels = np.full((20, 20), 5, np.uint8)
    once, again = (
        turnable_surface(height, 1.0, name="s", title="t", labels=labels).data for _ in range(2)
    )
    assert once == again
    assert all(name in once for name in HK_NAMES.values())


def test_every_type_has_a_color_and_the_legend_names_those_that_occur():
    assert HK_COLORS.keys() == HK_NAMES.keys()
    assert len(set(HK_COLORS.values())) == len(HK_COLORS)
    figure, axes = plt.subplots()
    draw_labels(axes, np.array([[0, 1], [5, 9]], np.uint8))
    shown = [text.get_text() for text in axes.get_legend().get_texts()]
    assert shown == ["1 convex elliptic", "5 planar", "9 saddle valley"]
    colors = axes.images[0].to_rgba(axes.images[0].get_array())
    np.testing.assert_allclose(colors[1, 1], mpl.colors.to_rgba(HK_COLORS[9]), atol=0.01)
    plt.close(figure)


def test_a_drawn_surface_keeps_its_scale():
    figure = plt.figure()
    axes = figure.add_subplot(projection="3d")
    draw_surface(axes, np.zeros((200, 100)), 2.0)
    assert axes.get_xlim()[1] > 190
    assert axes.get_ylim()[1] > 390
    plt.close(figure)


def test_the_colors_of_labels_are_nine_even_steps():
    height, labels = np.zeros((30, 20)), np.full((30, 20), 3, np.uint8)
    labels[0, 0] = 9
    html = turnable_surface(height, 1.0, name="s", title="t", labels=labels).data
    data = json.loads(re.search(r"Plotly\.newPlot\(\s*\"s\",\s*(\[.*?\]),\s*\{", html, re.S)[1])
    scale = data[0]["colorscale"]
    # Each color from one ninth to the next, over the labels 0.5 to 9.5.
    places = [place for place, _ in scale]
    np.testing.assert_allclose(places, np.repeat(np.arange(10) / 9, 2)[1:-1])
    assert [color for _, color in scale[::2]] == [HK_COLORS[k] for k in range(1, 10)]
    assert [color for _, color in scale[1::2]] == [HK_COLORS[k] for k in range(1, 10)]
    assert (data[0]["cmin"], data[0]["cmax"]) == (0.5, 9.5)
    assert data[0]["surfacecolor"] == labels.tolist()
    assert data[0]["colorbar"]["tickvals"] == list(range(1, 10))


def test_a_round_object_is_drawn_in_rings(monkeypatch):
    v, u = np.mgrid[-20:21, -20:21]
    height = np.where(np.hypot(u, v) < 10, 30.0, 0.0)
    axes = plt.figure().add_subplot(projection="3d")
    seen = []
    monkeypatch.setattr(axes, "plot_surface", lambda *points, **look: seen.append((points, look)))
    draw_surface(axes, height, 2.0, labels=np.full(height.shape, 5, np.uint8), turned=True)
    ((x, y, z), look) = seen[0]
    radius = np.hypot(x - 40, y - 40)
    np.testing.assert_allclose(radius, radius[:, :1] + 0 * radius, atol=1e-9)
    np.testing.assert_allclose(radius.max(), 40)  # µm, to the edge and not into the corners
    np.testing.assert_allclose(z[radius < 16], 30)
    np.testing.assert_allclose(z[radius > 24], 0, atol=1e-12)
    # The wall has no type; what lies on it and around it has.
    types = look["facecolors"]
    planar = np.allclose(types[radius < 16], mpl.colors.to_rgba(HK_COLORS[5]))
    assert planar
    walls = (types == 1).all(axis=-1)
    assert walls.any(axis=0).all()
    assert (np.abs(radius[walls] - 20) < 3).all()
    plt.close("all")


def test_the_stage_sinks_until_the_top_is_in_focus():
    row = draw_sinking_stage().axes
    tops = [float(axes.lines[-1].get_ydata()[0]) for axes in row]
    assert tops == sorted(tops, reverse=True)
    assert tops[0] > tops[1] > tops[2] == 0
    for axes, top in zip(row, tops, strict=True):
        # The plate of the stage, 0.08 thick, under the ground, which sinks with the top.
        ground = axes.collections[-1].get_paths()[0].vertices[:, 1]
        assert np.ptp(ground) == pytest.approx(0.08), top
    for axes, top in zip(row, tops, strict=True):
        sharp = np.asarray(axes.lines[1].get_ydata())[np.isfinite(axes.lines[1].get_xdata())]
        assert np.abs(sharp).max() < 0.05  # at the plane in focus
        arrows = {t.get_text(): t for t in axes.texts}
        if axes is not row[0]:
            # d is how far the ground has sunk, and the hill with it.
            assert arrows["d"].get_position()[1] == (top - tops[0]) / 2
    assert next(t for t in row[0].texts if t.get_text() == "$d_s$").get_position()[1] == tops[0] / 2
    plt.close("all")


@pytest.mark.parametrize(("span", "digits"), [(500.0, 1), (0.004, 6), (2e6, 0)])
def test_heights_are_written_to_a_thousandth_of_their_range(span, digits):
    height = span * np.random.default_rng(3).random((12, 15))
    height[0, :2] = 0, span
    height += 30 * span  # wherever the heights are counted from
    html = turnable_surface(height, 1.0, name="s", title="t").data
    data = json.loads(re.search(r"Plotly\.newPlot\(\s*\"s\",\s*(\[.*?\]),\s*\{", html, re.S)[1])
    np.testing.assert_array_equal(data[0]["z"], np.round(height, digits))
