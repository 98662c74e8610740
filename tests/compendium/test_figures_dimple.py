"""Dimples, outlines and forces: the lengths of Table 5.6 can be read from the drawings."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium import thesis
from compendium.figures import dimple, embryo

PIXEL = 3.875  # µm, §5.6
# Table 5.6, in µm.
RADIUS, DEPTH = 246.95, 121.22


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def drawn(axes):
    return {line.get_label(): line.get_xydata() for line in axes.lines}


def test_the_printed_outline_has_the_radius_and_depth_of_the_table() -> None:
    curve = thesis.outline_curve()
    lines = {
        k.split(" ")[0]: xy for k, xy in drawn(dimple.draw_printed_outline(curve).axes[0]).items()
    }
    (x1, y1), (x2, y2) = lines["rim"][0], lines["bottom"][0]
    # The rounding of Table 5.5 leaves a tenth of a pixel of each.
    assert PIXEL * (x2 - x1) == pytest.approx(RADIUS, abs=0.5)
    assert PIXEL * (y1 - y2) == pytest.approx(DEPTH, abs=0.5)
    # Eight Gaussians, summed here.
    x, y = lines["$f_m(x)$,"].T
    parts = zip(curve.amplitudes, curve.centers, curve.widths, strict=True)
    np.testing.assert_allclose(y, sum(a * np.exp(-(((x - b) / c) ** 2)) for a, b, c in parts))


def test_a_part_of_an_image_keeps_its_coordinates_and_a_bar_its_length() -> None:
    _, axes = plt.subplots()
    image = np.arange(80 * 100).reshape(80, 100)
    embryo.show_image(axes, image, box=(30, 20, 40, 25))
    np.testing.assert_array_equal(axes.images[0].get_array(), image[20:45, 30:70])
    assert axes.images[0].get_extent() == [29.5, 69.5, 44.5, 19.5]
    embryo.add_scale_bar(axes, 150.0, 7.5)
    assert np.ptp(axes.lines[0].get_xdata()) == pytest.approx(20.0)
    assert axes.texts[0].get_text() == "150 µm"
