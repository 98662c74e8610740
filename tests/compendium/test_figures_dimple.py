"""Dimples, outlines and forces: the lengths of Table 5.6 can be read from the drawings."""

from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pandas as pd
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


def scene():
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (768, 1024)).astype(np.uint8)
    truth = SimpleNamespace(dimple_radius=200.0)
    return SimpleNamespace(image=image, center=(512.4, 300.6), pixel_size=4.0, embryo=truth)


def test_the_printed_outline_has_the_radius_and_depth_of_the_table():
    curve = thesis.outline_curve()
    axes = dimple.draw_printed_outline(curve).axes[0]
    lines = {label.split(" ")[0]: xy for label, xy in drawn(axes).items()}
    (x1, y1), (x2, y2) = lines["rim"][0], lines["bottom"][0]
    # The rounding of Table 5.5 leaves a tenth of a pixel of each.
    assert PIXEL * (x2 - x1) == pytest.approx(RADIUS, abs=0.5)
    assert PIXEL * (y1 - y2) == pytest.approx(DEPTH, abs=0.5)
    # Eight Gaussians, summed here.
    x = lines["$f_m(x)$,"][:, 0]
    parts = zip(curve.amplitudes, curve.centers, curve.widths, strict=True)
    expected = sum(a * np.exp(-(((x - b) / c) ** 2)) for a, b, c in parts)
    np.testing.assert_allclose(lines["$f_m(x)$,"][:, 1], expected)
    assert len(x) == 800
    arrows = [(text.xy, text.xyann) for text in axes.texts if not text.get_text()]
    np.testing.assert_allclose(arrows, [[[x1, y1 + 6], [x2, y1 + 6]], [[x2, y1], [x2, y2]]])


def test_extrema_lie_on_the_curve_where_it_is_flat():
    curve = thesis.outline_curve()
    axes = dimple.draw_printed_outline(curve).axes[0]
    for line, sign in zip(axes.lines[1:3], (-1, 1), strict=True):
        x, y = line.get_data()
        np.testing.assert_allclose(curve(x), y)
        for step in (-0.5, 0.5):
            assert (sign * (curve(x + step) - y) > 0).all()


def test_moduli_are_counted():
    axes = dimple.draw_rounding(pd.Series(np.linspace(1.2, 1.5, 300))).axes[0]
    assert [patch.get_height() for patch in axes.patches] == [10] * 30
    assert axes.patches[0].get_x() == pytest.approx(1.2)
    assert axes.lines[0].get_xdata() == [1.3237, 1.3237]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("modulus E (MPa)", "draws")


def test_the_rendered_outline_counts_heights_from_the_lowest_in_view():
    curve = thesis.outline_curve()
    boundary = SimpleNamespace(x=np.arange(50.0, 260.0), y=700 + np.arange(210.0))
    columns, profile = np.linspace(60, 250, 20), np.linspace(710, 900, 20)
    figure = dimple.draw_rendered_outline(scene(), boundary, columns, curve, profile)
    whole, bottom = figure.axes
    lines = drawn(whole)
    # At 60 px the outline is at 710: the lowest among the columns.
    np.testing.assert_allclose(lines["outline"], np.column_stack([boundary.x, boundary.y - 710]))
    np.testing.assert_allclose(lines["profile (4.2)"], np.column_stack([columns, profile - 710]))
    expected = np.column_stack([columns, curve(columns)])
    np.testing.assert_allclose(lines["eight Gaussians"], expected)
    assert whole.get_xlim() == pytest.approx((512.4 - 75, 512.4 + 75))
    # The same curves, four half widths of the probe (25 µm) to either side.
    assert {name: points.tolist() for name, points in drawn(bottom).items()} == {
        name: points.tolist() for name, points in lines.items()
    }
    reach = 4 * 25 / scene().pixel_size
    assert bottom.get_xlim() == pytest.approx((512.4 - reach, 512.4 + reach))
    assert bottom.get_ylim() == pytest.approx((-2, reach / 2))
    assert whole.get_aspect() == bottom.get_aspect() == 1


def test_the_profile_is_drawn_beside_the_outline():
    curve = thesis.outline_curve()
    shape = SimpleNamespace(x=np.array([100.0, 110.0]), expected=np.array([20.0, 30.0]))
    lines = drawn(dimple.draw_profile_comparison(curve, shape).axes[0])
    expected = [[100, 20], [110, 30]]
    np.testing.assert_allclose(lines["(4.2) with its radius and depth"], expected)
    x, y = lines["Table 5.5"].T
    np.testing.assert_allclose(y, curve(x))
    # From beyond the rim to as far beyond the bottom.
    (left, _), (middle, _) = dimple._rim_and_bottom(curve)
    assert (x[0], x[-1]) == pytest.approx((left - 20, middle + (middle - left)))


def errors(axes):
    return [segment.tolist() for segment in axes.collections[0].get_segments()]


def test_the_study_shows_each_modulus_with_its_interval():
    study = pd.DataFrame(
        {"depth": [20.0, 40.0], "thesis": [2.0, 1.5], "fitted": [1.3, 1.4]}
        | {"low": [0.4, 1.35], "high": [3.6, 1.42]}
    )
    axes = dimple.draw_image_study(study).axes[0]
    lines = drawn(axes)
    assert lines["truth"][:, 1].tolist() == [1.3237, 1.3237]
    np.testing.assert_allclose(lines["LOESS and eight Gaussians"], [[20, 2], [40, 1.5]])
    np.testing.assert_allclose(axes.containers[0][0].get_xydata(), [[20, 1.3], [40, 1.4]])
    np.testing.assert_allclose(errors(axes), [[[20, 0.4], [20, 3.6]], [[40, 1.35], [40, 1.42]]])


def test_forces_are_drawn_over_time():
    felt = pd.DataFrame({"time": [1.0, 3.0], "force": [90.0, 150.0]})
    felt = felt.assign(low=[30.0, 149.0], high=[195.0, 155.0])
    axes = dimple.draw_estimated_force(felt).axes[0]
    time, force = drawn(axes)["truth"].T
    assert (time[0], time[-1]) == (0, 4)
    # 40 µN at rest, 206 at the turn, 72 at the end.
    assert (force[0], force[-1]) == pytest.approx((40, 72))
    assert force.max() == pytest.approx(206, abs=2)
    np.testing.assert_allclose(axes.containers[0][0].get_xydata(), [[1, 90], [3, 150]])
    np.testing.assert_allclose(errors(axes), [[[1, 30], [1, 195]], [[3, 149], [3, 155]]])


def test_the_relaxing_force_stands_beside_what_one_outline_says():
    felt = pd.DataFrame(
        {
            "time": [1.0, 8.0],
            "force": [70.0, 97.0],
            "low": [68.0, 95.0],
            "high": [73.0, 99.0],
            "elastic": [75.0, 150.0],
        }
    )
    axes = dimple.draw_relaxing_force(felt).axes[0]
    lines = drawn(axes)
    # 40 % of 150 µN relax with 3 s, most of it in the 6 s that the probe is held.
    assert lines["truth"][-1] == pytest.approx((8, 97.2), abs=2.0)
    np.testing.assert_allclose(lines["one outline alone"], [[1, 75], [8, 150]])
    np.testing.assert_allclose(axes.containers[0][0].get_xydata(), [[1, 70], [8, 97]])
    np.testing.assert_allclose(errors(axes), [[[1, 68], [1, 73]], [[8, 95], [8, 99]]])


def test_the_embryo_and_its_steps_are_cut_out_around_the_dimple():
    one = scene()
    left, right = dimple.draw_embryo(one).axes
    np.testing.assert_array_equal(left.images[0].get_array(), one.image)
    np.testing.assert_array_equal(right.images[0].get_array(), one.image[251:617, 322:702])
    assert right.images[0].get_extent() == [321.5, 701.5, 616.5, 250.5]
    assert np.ptp(left.lines[0].get_xdata()) == pytest.approx(1000 / 4)
    assert np.ptp(right.lines[0].get_xdata()) == pytest.approx(300 / 4)
    points = np.array([[400.0, 300.0], [450.0, 310.0], [500.0, 340.0], [560.0, 320.0]])
    under = np.array([False, False, True, False])
    probe = SimpleNamespace(tip=(510.0, 330.0))
    outline = SimpleNamespace(points=points, under_probe=under, probe=probe)
    filled = one.image // 2
    first, second, third = dimple.draw_outline_steps(one, filled, outline).axes
    part = np.s_[261:371, 362:662]
    np.testing.assert_array_equal(first.images[0].get_array(), one.image[part])
    np.testing.assert_array_equal(second.images[0].get_array(), filled[part])
    assert (third.get_xlim(), third.get_ylim()) == ((362, 662), (371, 261))
    np.testing.assert_allclose(third.lines[0].get_xydata(), points[:2])
    np.testing.assert_allclose(third.lines[1].get_xydata(), points[3:])
    np.testing.assert_allclose(third.lines[2].get_xydata(), points[2:3])
    # The bar of 200 µm stands in the first alone.
    assert [len(axes.texts) for axes in (first, second, third)] == [1, 0, 0]
    assert first.texts[0].get_text() == "200 µm"
    assert np.ptp(first.lines[0].get_xdata()) == pytest.approx(200 / one.pixel_size)


def test_a_scale_bar_is_as_long_as_it_says():
    _, axes = plt.subplots()
    embryo.show_image(axes, np.zeros((100, 200)))
    assert axes.images[0].get_extent() == [-0.5, 199.5, 99.5, -0.5]
    embryo.add_scale_bar(axes, 50, 2.5)
    x, y = axes.lines[0].get_data()
    assert x[1] - x[0] == pytest.approx(20)
    assert x[0] == pytest.approx(-0.5 + 0.05 * 200)
    assert y[0] == y[1] == pytest.approx(99.5 - 0.06 * 100)
    assert axes.texts[0].get_text() == "50 µm"
    assert axes.texts[0].get_position() == pytest.approx((x.mean(), y[0] - 2))


def test_the_section_names_the_lengths_that_it_draws():
    """Each letter stands at its arrow, and beyond the rim the shell bends down by the radius R."""
    axes = dimple.draw_dimple_section(RADIUS, DEPTH, 25.0).axes[0]
    arrows = [(np.array(t.xyann), np.array(t.xy)) for t in axes.texts if not t.get_text()]
    ends = {"F": ((0, 70), (0, -DEPTH)), "a": ((0, 20), (RADIUS, 20))}
    ends |= {"c": ((0, -DEPTH - 18), (25, -DEPTH - 18)), "$w_d$": ((-RADIUS, 0), (-RADIUS, -DEPTH))}
    letters = {t.get_text(): np.array(t.get_position()) for t in axes.texts if t.get_text()}
    assert letters.keys() == {*ends, "R"}
    for letter, pair in ends.items():
        assert any({tuple(a), tuple(b)} == set(pair) for a, b in arrows), letter
        begin, end = np.array(pair)
        along = np.clip(
            (letters[letter] - begin) @ (end - begin) / np.sum((end - begin) ** 2), 0, 1
        )
        assert np.hypot(*(letters[letter] - begin - along * (end - begin))) < 35, letter
    helper = axes.lines[5].get_xydata()
    np.testing.assert_allclose(helper, [[-RADIUS, -DEPTH], [-25, -DEPTH]])  # from w_d to the probe
    for line in (axes.lines[1], axes.lines[3]):
        x, y = np.abs(line.get_xdata()), line.get_ydata()
        np.testing.assert_allclose(np.hypot(x - RADIUS, y + 80), 80)  # a circle below the rim
        assert (x[0], y[0]) == pytest.approx((RADIUS, 0))
        assert (x[-1], y[-1]) == pytest.approx((RADIUS + 80, -80))
    (center, onto) = next(
        (b, a) for a, b in arrows if tuple(b) == (RADIUS, -80.0) or tuple(a) == (RADIUS, -80.0)
    )
    assert np.hypot(*(onto - center)) == pytest.approx(80)


def test_lengths_are_named_beside_their_arrows():
    curve = thesis.outline_curve()
    boundary = SimpleNamespace(x=np.arange(50.0, 260.0), y=np.arange(210.0))
    columns = np.linspace(60, 250, 20)
    for figure in (
        dimple.draw_printed_outline(curve),
        dimple.draw_rendered_outline(scene(), boundary, columns, curve, columns),
    ):
        axes = figure.axes[0]
        (x1, y1), (x2, y2) = dimple._rim_and_bottom(curve)
        letters = {t.get_text(): t.get_position() for t in axes.texts if t.get_text()}
        assert letters["a"][0] == pytest.approx((x1 + x2) / 2)
        assert 0 < letters["a"][1] - y1 < 10
        assert abs(letters["$w_d$"][0] - x2) < 6
        assert y2 < letters["$w_d$"][1] < y1
        assert axes.get_ylim()[1] > letters["a"][1]
