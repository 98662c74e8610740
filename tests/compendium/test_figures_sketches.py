"""Sketches drawn from numbers: they show the lengths that they name."""

import matplotlib as mpl
import numpy as np
import pytest

mpl.use("agg")
import matplotlib.pyplot as plt
import pandas as pd

from compendium import thesis
from compendium.figures import COLORS, calibration, overview, use_style
from compendium.figures.dimple import draw_dimple_section
from compendium.figures.servoing import draw_stability
from compendium.figures.surfaces import draw_lens


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def lines(figure):
    return {line.get_label(): line for line in figure.axes[0].lines}


def test_the_section_of_the_dimple_is_to_scale():
    figure = draw_dimple_section(246.95, 121.22, 25.0)
    right = figure.axes[0].lines[2]
    x, y = right.get_data()
    assert (x[0], x[-1]) == (25.0, 246.95)
    assert y[0] == pytest.approx(-121.22)
    assert y[-1] == pytest.approx(0.0, abs=1e-9)
    assert figure.axes[0].get_aspect() == 1
    # As the caption says: a quarter as deep as wide, and steeper than 45° at the probe.
    assert pytest.approx(0.25, abs=0.01) == 121.22 / (2 * 246.95)
    assert (y[1] - y[0]) / (x[1] - x[0]) > 1


def test_rays_meet_where_the_lens_equation_says():
    drawn = lines(draw_lens())
    x, y = drawn["in focus"].get_data()
    # 1/f = 1/d_o + 1/d_i with f = 40 and the sensor at 100 mm.
    assert 1 / -x[0] + 1 / x[-1] == pytest.approx(1 / 40)
    assert y[-1] == pytest.approx(0, abs=1e-9)
    assert (x[1], y[1]) == (0, 14)  # at the edge of the lens, of 14 mm
    x, y = drawn["too near"].get_data()
    assert (x[1], y[1]) == (0, 14)
    assert x[-1] == 100
    assert y[-1] == pytest.approx(14 * 100 * (1 / -x[0] + 1 / 100 - 1 / 40))  # (3.4)


def test_a_lost_focal_length_is_marked_and_the_others_in_percent():
    study = pd.DataFrame(
        {
            "tilt": [0.0, 5.0],
            "lost": [1.0, 0.0],
            "bound": [np.inf, 0.02],
            "stated": [np.inf, 0.021],
            "scatter": [np.nan, 0.019],
            "M": [2e-5, 2e-5],
        }
    )
    drawn = lines(calibration.draw_focal_length_study(study))
    assert drawn["f: named unobservable"].get_xdata().tolist() == [0.0]
    assert drawn["f: stated σ"].get_ydata()[1] == pytest.approx(2.1)
    assert drawn["M: scatter"].get_ydata()[0] == pytest.approx(0.002)


def test_loops_that_decay_and_grow_are_told_apart():
    delays, gains = np.linspace(0, 1, 5), np.linspace(0.1, 2, 7)
    moduli = pd.DataFrame(np.add.outer(gains, delays) / 2, gains, delays)
    loops = pd.DataFrame({"delay": [0.2, 0.9], "gain": [0.3, 1.9], "decays": [True, False]})
    drawn = lines(draw_stability(moduli, loops, 0.99))
    assert drawn["simulated: decays"].get_xydata().tolist() == [[0.2, 0.3]]
    assert drawn["simulated: grows"].get_xydata().tolist() == [[0.9, 1.9]]


def test_rays_come_in_pairs_and_all_are_in_view():
    axes = draw_lens().axes[0]
    (low, high), (left, right) = axes.get_ylim(), axes.get_xlim()
    rays = [line.get_xydata() for line in axes.lines if len(line.get_xdata()) == 3]
    assert len(rays) == 4
    for down, up in (rays[:2], rays[2:]):
        np.testing.assert_allclose(down * [1, -1], up, atol=1e-12)
    for ray in rays:
        assert (left < ray[:, 0]).all()
        assert (ray[:, 0] < right).all()
        assert (low < ray[:, 1]).all()
        assert (ray[:, 1] < high).all()
    # The arrow of the blur spans it, beyond the sensor.
    (arrow,) = (text for text in axes.texts if not text.get_text())
    assert sorted([arrow.xy[1], arrow.xyann[1]]) == pytest.approx([rays[2][-1, 1], rays[3][-1, 1]])
    assert arrow.xy[0] == arrow.xyann[0] > 100


def test_figures_lie_open_to_the_right_and_above():
    before = dict(mpl.rcParams)
    try:
        use_style()
        width, height = mpl.rcParams["figure.figsize"]
        assert width > height
        assert width == 7.2  # inches, the width of the book's text
        for side, drawn in {"left": True, "bottom": True, "top": False, "right": False}.items():
            assert mpl.rcParams[f"axes.spines.{side}"] is drawn
        colors = [entry["color"] for entry in mpl.rcParams["axes.prop_cycle"]]
        assert len(set(colors)) == 7
        assert COLORS["black"] not in colors
        assert mpl.rcParams["image.cmap"] == "gray"
        assert mpl.rcParams["axes.grid"] is True
        assert mpl.rcParams["axes.axisbelow"] is True
        assert mpl.rcParams["figure.constrained_layout.use"] is True
        assert mpl.rcParams["legend.frameon"] is False
    finally:
        mpl.rcParams.update(before)


def test_sizes_stand_in_order_and_agree_with_the_thesis():
    sizes = [*overview.THINGS]
    assert sizes == sorted(sizes, reverse=True)
    named = {name: size for size, name in overview.THINGS.items()}
    assert named["step of the stage"] == pytest.approx(1e-6 * thesis.STAGE_STEP)
    assert named["pixel at 1X"] == pytest.approx(1e-6 * thesis.effective_pixel("1X"), rel=0.01)
    axes = overview.draw_scale().axes[0]
    ends = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in axes.patches]
    np.testing.assert_allclose(ends, [(1e-9, 1e-6), (1e-6, 1e-3), (1e-3, 1)], rtol=1e-9)


def test_every_task_is_named_with_its_input_and_its_result():
    texts = [text.get_text() for text in overview.draw_system().axes[1].texts]
    for given, task, result, _ in overview.TASKS:
        assert {given, task, f"→ {result}"} <= set(texts)
