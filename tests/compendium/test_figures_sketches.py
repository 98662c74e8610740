"""Sketches drawn from numbers: they show the lengths that they name."""

import matplotlib as mpl
import numpy as np
import pytest

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium import thesis
from compendium.figures import overview
from compendium.figures.dimple import draw_dimple_section
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


def test_sizes_stand_in_order_and_agree_with_the_thesis():
    sizes = [*overview.THINGS]
    assert sizes == sorted(sizes, reverse=True)
    named = {name: size for size, name in overview.THINGS.items()}
    assert named["step of the stage"] == pytest.approx(1e-6 * thesis.STAGE_STEP)
    assert named["pixel at 1X"] == pytest.approx(1e-6 * thesis.effective_pixel("1X"), rel=0.01)
    axes = overview.draw_scale().axes[0]
    ends = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in axes.patches]
    np.testing.assert_allclose(ends, [(1e-9, 1e-6), (1e-6, 1e-3), (1e-3, 1)], rtol=1e-9)
