"""Focal stacks, depths and thresholds of section 5.5: the frames and lengths that are named."""

from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium.figures import shape_from_focus as drawing
from compendium.figures.surfaces import draw_surface


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def stack(count):
    frames = np.arange(count)[:, None, None] + 100 * np.arange(2)[:, None] + np.zeros((1, 1, 3))
    return SimpleNamespace(
        texture=np.full((2, 3), 7.0),
        height=np.full((2, 3), 8.0),
        positions=25.0 * np.arange(count) - 50,
        frames=frames,
    )


def shown(figure):
    return [np.asarray(axes.images[0].get_array())[0, 0] for axes in figure.axes]


def test_the_frames_are_those_of_their_titles():
    ridge = drawing.draw_ridge_frames(stack(20), np.full((2, 3), 9.0))
    assert shown(ridge) == [7, 0, 10, 18, 9, 8]
    titles = [axes.get_title() for axes in ridge.axes]
    assert titles[1:4] == ["(b) d = -50 µm", "(c) d = 200 µm", "(d) d = 400 µm"]
    assert (titles[0], titles[4], titles[5]) == ("(a) texture", "(e) fused", "true height")
    ball = drawing.draw_ball_frames(stack(20), np.full((2, 3), 9.0))
    assert shown(ball) == [1, 11, 15, 9]
    titles = [axes.get_title() for axes in ball.axes]
    assert titles == ["(a) -25 µm", "(b) 225 µm", "(c) 325 µm", "(d) fused"]


def test_a_height_map_keeps_rows_and_columns_apart():
    depth = np.arange(20.0 * 30).reshape(20, 30)
    _, above, *_ = drawing.draw_depth(depth, 4.0).axes
    np.testing.assert_array_equal(above.images[0].get_array(), depth)
    assert above.images[0].get_extent() == [0, 120, 80, 0]
    assert (above.get_xlabel(), above.get_ylabel()) == ("x (µm)", "y (µm)")
    _, above, *_ = drawing.draw_depth(depth).axes
    assert above.images[0].get_extent() == [-0.5, 29.5, 19.5, -0.5]
    assert above.get_xlabel() == "x (px)"


@pytest.mark.parametrize(("shape", "stride"), [((20, 30), 1), ((100, 170), 3)])
def test_a_surface_has_its_heights_over_x_and_y(monkeypatch, shape, stride):
    rows, cols = np.indices(shape)
    axes = plt.figure().add_subplot(projection="3d")
    seen = []
    monkeypatch.setattr(axes, "plot_surface", lambda *points, **look: seen.append(points))
    draw_surface(axes, 1000.0 * rows + cols, 2.0)
    ((x, y, z),) = seen
    # µm; each point has the height of its place.
    np.testing.assert_allclose(z, 1000 * y / 2 + x / 2)
    assert set(np.unique(x)) == set(2.0 * np.arange(0, shape[1], stride))
    assert set(np.unique(y)) == set(2.0 * np.arange(0, shape[0], stride))
    assert axes.get_zlabel() == "height (µm)"


def test_the_thresholds_are_the_thesis_own_and_a_ball_lies_on_its_parabola():
    axes = drawing.draw_thresholds().axes[0]
    lines = {line.get_label(): line.get_xydata() for line in axes.lines}
    h, k = lines["a ball: K = H²"].T
    np.testing.assert_allclose(k, h * h)
    assert (h[0], h[-1]) == (0, 0.2)
    # §5.5: 0.03 for H and 0.015 for K.
    assert lines["threshold of H"][:, 0].tolist() == [0.03, 0.03]
    assert lines["threshold of K"][:, 1].tolist() == [0.015, 0.015]
    empty, between = (c.get_paths()[0].vertices for c in axes.collections)
    # Nothing lies above the parabola, as (k1 − k2)² is never negative.
    assert (empty[:, 1] >= empty[:, 0] ** 2 - 1e-12).all()
    # Between them a ball has H beyond its threshold and K below.
    assert between[:, 0].min() == pytest.approx(0.03)
    assert between[:, 0].max() == pytest.approx(0.015**0.5)
    assert (between[:, 1] <= between[:, 0] ** 2 + 1e-12).all()


def test_types_are_drawn_with_the_ball_and_its_half():
    labels = {"found": np.full((180, 180), 1, np.uint8), "clean": np.full((180, 180), 5, np.uint8)}
    figure = drawing.draw_types(labels, ball=True)
    first, second = figure.axes
    assert (first.get_title(), second.get_title()) == ("found", "clean")
    assert (first.get_ylabel(), second.get_ylabel()) == ("y (px)", "")
    edge, half = first.patches
    # 375 µm of radius at 6.19 µm a pixel, in the middle of 180 by 180 px.
    assert edge.center == half.center == (89.5, 89.5)
    assert edge.radius == pytest.approx(375 / 6.19, rel=0.01)
    assert half.radius == pytest.approx(edge.radius / 2)
    assert legend(figure) == ["1 convex elliptic", "5 planar"]
    plain, _ = drawing.draw_types(labels).axes
    assert not plain.patches


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_part_is_enlarged_below_its_frame():
    labels = {"one": np.full((60, 80), 1, np.uint8), "two": np.full((60, 80), 5, np.uint8)}
    first, second, below, beside = drawing.draw_types(labels, enlarged=(10, 20, 30, 15)).axes
    for whole, part in ((first, below), (second, beside)):
        assert whole.patches[0].get_bbox().bounds == (10, 20, 30, 15)
        assert (part.get_xlim(), part.get_ylim()) == ((10, 40), (35, 20))
        np.testing.assert_array_equal(part.images[0].get_array(), whole.images[0].get_array())
    assert (below.get_ylabel(), beside.get_ylabel()) == ("y (px)", "")


def test_bars_mark_the_columns_that_only_one_frame_shows_sharp():
    ridge = stack(20)
    # Frame 10 stands at 200 µm and 25 µm from its neighbours.
    ridge.height = np.tile([0.0, 189.0, 211.0, 213.0, 200.0], (2, 1))
    figure = drawing.draw_ridge_frames(ridge, np.full((2, 5), 9.0))
    bars = [line.get_xdata().tolist() for line in figure.axes[2].lines]
    # Above and below the image: two columns side by side, and one alone.
    assert bars == [[0.5, 2.5], [0.5, 2.5], [3.5, 4.5], [3.5, 4.5]]
    assert not figure.axes[0].lines
    assert not figure.axes[4].lines


def test_types_are_drawn_by_their_window():
    labels = {3: np.full((4, 4), 1, np.uint8), 9: np.full((4, 4), 5, np.uint8)}
    figure = drawing.draw_types_by_window(labels)
    first, second = figure.axes
    assert (first.get_title(), second.get_title()) == ("windows of 3 px", "windows of 9 px")
    assert first.images[0].get_array()[0, 0] == 1
    assert legend(figure) == ["1 convex elliptic", "5 planar"]
