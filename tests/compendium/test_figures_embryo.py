"""Pictures of embryos: pixels in their own coordinates, a bar of its length, an outline's parts."""

from __future__ import annotations

from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium.figures.embryo import add_scale_bar, show_image, show_outline


@pytest.fixture
def axes():
    _, made = plt.subplots()
    yield made
    plt.close("all")


def test_a_part_of_an_image_keeps_its_coordinates(axes) -> None:
    image = np.arange(80 * 100).reshape(80, 100)
    show_image(axes, image, box=(30, 20, 40, 25))
    (shown,) = axes.images
    np.testing.assert_array_equal(shown.get_array(), image[20:45, 30:70])
    assert shown.get_extent() == [29.5, 69.5, 44.5, 19.5]
    assert shown.get_clim() == (0, 255)
    assert not axes.axison
    show_image(axes, image)
    assert axes.images[1].get_extent() == [-0.5, 99.5, 79.5, -0.5]


def test_a_bar_is_as_long_as_it_says_and_stands_in_the_lower_left(axes) -> None:
    show_image(axes, np.zeros((80, 200)))
    add_scale_bar(axes, 150.0, 3.0)
    x, y = axes.lines[0].get_data()
    assert x[1] - x[0] == pytest.approx(50.0)
    assert x[0] == pytest.approx(-0.5 + 0.05 * 200)
    np.testing.assert_allclose(y, 79.5 - 0.06 * 80)
    (label,) = axes.texts
    assert label.get_text() == "150 µm"
    assert label.get_position() == pytest.approx((x.mean(), y[0] - 0.02 * 80))
    assert axes.get_xlim() == (-0.5, 199.5)
    assert axes.get_ylim() == (79.5, -0.5)


def test_an_outline_is_dotted_where_the_probe_hides_it(axes) -> None:
    x = np.arange(20.0, 60.0)
    under = np.abs(x - 41) < 3
    boundary = SimpleNamespace(
        points=np.column_stack([x, x**2]), under_probe=under, probe=SimpleNamespace(tip=(41.0, 9.0))
    )
    show_outline(axes, boundary, color="red")
    left, right, hidden = axes.lines
    np.testing.assert_array_equal(left.get_xdata(), x[(x < 41) & ~under])
    np.testing.assert_array_equal(right.get_xdata(), x[(x > 41) & ~under])
    np.testing.assert_array_equal(hidden.get_xydata(), boundary.points[under])
    assert [line.get_linestyle() for line in axes.lines] == ["-", "-", ":"]
    assert {line.get_color() for line in axes.lines} == {"red"}
