"""The parts of the way from an image to a dimple, each on numbers whose answer is known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import curve_fit

from microlib.embryo import _boundary, _modulus
from microlib.embryo._boundary import (
    Probe,
    _crossings,
    _end_row,
    _find_probe,
    _follow,
    _leaning_bar,
    _off_the_side,
    _refuse_saturated,
    _refuse_without_dimple,
    _remove_probe,
    _resample,
    _robust_line,
    _tip_row,
    _tube_body,
    _tubes,
    _upright_probe,
)
from microlib.embryo._dimple import (
    DimpleFit,
    _near,
    _start,
    _variance_inflation,
    refuse_another_width,
)
from microlib.embryo._modulus import ModulusEstimate, _egg_radius, _interval
from microlib.embryo._view import View, part_of
from microlib.embryo._wall import locate_wall
from tests.embryo.test_wall import wall


def ramp(level: np.ndarray, low: float = 40.0, high: float = 200.0) -> np.ndarray:
    return (low + (high - low) * np.clip(level, 0, 1)).astype(np.float32)


def test_a_probe_tapers_above_its_end_alone():
    probe = Probe((50.0, 100.0), 0.1, 6.0, taper=-0.05)
    np.testing.assert_allclose(probe.axis([80.0, 110.0]), [48.0, 51.0])
    np.testing.assert_allclose(probe.half_width_at([80.0, 110.0]), [7.0, 6.0])


def test_a_bar_ends_where_its_width_jumps_and_a_taper_goes_on():
    steady = np.full(100, 12)
    assert _end_row(steady) == 100
    # A jump of 0.35 · 12 + 1 = 5.2 px is no end, one of more is.
    for width, end in ((17, 100), (18, 60), (7, 100), (6, 60), (0, 60)):
        changed = steady.copy()
        changed[60:63] = width
        assert _end_row(changed) == end, width
    early = steady.copy()
    early[3] = 30
    assert _end_row(early) == 3
    taper = 60 - 0.4 * np.arange(100)
    assert _end_row(taper) == 100
    jumped = taper.copy()
    # What a taper foretells decides, not the median of what was.
    jumped[70:] = taper[70] - 0.35 * taper[70] - 2
    assert _end_row(jumped) == 70


def test_walls_of_a_tube_are_alike_and_thin_for_its_width():
    assert _tubes(np.array([[10, 12], [28, 30]]), 40) == [(10, 30, 2)]
    assert _tubes(np.array([[10, 12], [26, 30]]), 40) == [(10, 30, 4)]
    assert _tubes(np.array([[10, 11], [28, 30]]), 40) == []  # thinner than 2 px
    assert _tubes(np.array([[10, 12], [25, 30]]), 40) == []  # more than twice as wide
    assert _tubes(np.array([[10, 14], [18, 22]]), 40) == [(10, 22, 4)]
    assert _tubes(np.array([[10, 14], [17, 21]]), 40) == []  # more than a third of it
    assert _tubes(np.array([[10, 12], [48, 50]]), 40) == [(10, 50, 2)]
    assert _tubes(np.array([[10, 12], [49, 51]]), 40) == []
    three = np.array([[10, 12], [28, 30], [48, 50]])
    assert _tubes(three, 40) == [(10, 30, 2), (28, 50, 2)]


def test_a_tube_is_followed_as_far_as_both_walls_go_on():
    grey = np.full((40, 60), 200.0, np.float32)
    for row in range(30):
        left = 20 + row // 3
        grey[row, left : left + 3] = 40
        if row < 25:
            grey[row, left + 15 : left + 18] = 40
    body = _tube_body(grey, (20, 38, 3), 120.0)
    for row in range(40):
        expected = np.zeros(60, bool)
        if row < 25:
            expected[20 + row // 3 : 38 + row // 3] = True
        np.testing.assert_array_equal(body[row], expected)


def test_a_row_is_crossed_half_way_to_the_ground_on_either_side():
    x = np.arange(80.0)
    row = ramp((np.abs(x - 40.0) - 6.0) / 4 + 0.5)  # half-way 6 px beside, within 4 px
    left, right = _crossings(row, 40.0, 12.0, 40.0)
    assert (left, right) == pytest.approx((34.0, 46.0), abs=1e-4)
    # Each side has its own ground: on the right 300, half-way at 170.
    row = np.where(x > 40, ramp((x - 44.0) / 4, 40.0, 300.0), row).astype(np.float32)
    left, right = _crossings(row, 40.5, 12.0, 40.0)
    assert (left, right) == pytest.approx((34.0, 46.0), abs=1e-4)
    assert np.isnan(_crossings(np.full(80, 40.0, np.float32), 40.0, 12.0, 40.0)).all()
    # The ground is the mean of the last six samples, 0.25 px apart, of 6 px beside the bar.
    far = np.where(np.abs(x - 40) < 10.6, 120.0, 200.0).astype(np.float32)
    far[np.abs(x - 40) < 6] = 40.0
    assert _crossings(far, 40.0, 12.0, 40.0)[1] == pytest.approx(45 + 80 * 0.8 / 160 * 2, abs=0.6)


def test_a_line_leaves_out_what_is_three_deviations_off():
    x = np.arange(20.0)
    wave = np.where(np.arange(20) % 2, 0.1, -0.1)
    y = 2.0 + 0.5 * x + wave
    y[5] += 30.0
    y[11] = np.nan
    slope, start = _robust_line(x, y)
    good = np.isfinite(y) & (x != 5)
    assert (slope, start) == pytest.approx(tuple(np.polyfit(x[good], y[good], 1)), abs=1e-9)
    y[:] = np.nan
    y[:7] = 1.0
    with pytest.raises(ValueError, match="got 7 of 20 rows"):
        _robust_line(x, y)
    y[7] = 1.0
    assert _robust_line(x, y) == pytest.approx((0.0, 1.0))


def test_the_end_is_half_way_to_the_embryo_below_it():
    y, x = np.mgrid[:120, :80].astype(float)
    grey = ramp((y - 69.0) / 4 + 0.5, 40.0, 120.0)  # over 4 px about 69
    upper = Probe((39.0, 0.0), 0.0, 6.0)
    assert _tip_row(grey, upper, 70, 40.0) == pytest.approx(69.0, abs=1e-3)
    assert _tip_row(grey, upper, 66, 40.0) == pytest.approx(69.0, abs=1e-3)
    # Seen along the axis of a probe that leans: the picture falls off to the right by 0.2.
    leaning = ramp((y - 69.0 - 0.2 * (x - 39.0)) / 4 + 0.5, 40.0, 120.0)
    slanted = Probe((25.0, 0.0), 0.2, 6.0)
    assert _tip_row(leaning, slanted, 69, 40.0) == pytest.approx(69.0, abs=0.05)
    with pytest.raises(ValueError, match="against something brighter"):
        _tip_row(np.full((120, 80), 40.0, np.float32), upper, 70, 40.0)


def test_points_are_a_pixel_apart_along_the_curve():
    curve = np.array([[0.0, 3.0, 3.0], [0.0, 4.0, 16.0]])  # 5 px, then 12
    found = _resample(curve)
    assert found.shape == (2, 18)
    np.testing.assert_allclose(np.hypot(*np.diff(found))[[0, 3, 5, 16]], 1.0)
    np.testing.assert_allclose(found[:, 5], [3.0, 4.0])
    assert _resample(curve[:, :2]).shape == (2, 11)  # as many as are averaged over


def test_ground_at_the_top_of_the_scale_is_refused():
    full = np.full((100, 100), 128, np.uint8)
    for count, top, kind in ((50, 255, np.uint8), (50, 65535, np.uint16), (50, 1.0, float)):
        image = (full * 0 + (0.5 if top == 1.0 else 128)).astype(kind)
        image.flat[:count] = top
        _refuse_saturated(image, image.astype(np.float32))
        image.flat[:51] = top
        with pytest.raises(ValueError, match=f"got 0.5% of its pixels at {top:g} or above"):
            _refuse_saturated(image, image.astype(np.float32))
    wide = np.full((100, 100), 255.0)
    with pytest.raises(ValueError, match=r"100\.0% of its pixels at 255"):
        _refuse_saturated(wide, wide.astype(np.float32))
    # Floats of 12 bits: what is over 8 bits' top is no sign, what many reach is.
    many = np.linspace(300, 4000, 10_000).reshape(100, 100)
    _refuse_saturated(many, many.astype(np.float32))
    cut = many.clip(0, 3900)
    with pytest.raises(ValueError, match=r"got 2\.7% of its pixels at 3900 or above"):
        _refuse_saturated(cut, cut.astype(np.float32))


def sides(depth: float = 20.0, beside: float = 30.0, fall: float = 10.0) -> list[np.ndarray]:
    """Outlines on both sides of a probe at x = 100, 5 px wide, whose end is at y = 100, y down."""
    rim = 100.0 - depth
    x = np.arange(0.0, 93.0)
    highest = 100.0 - 5.0 - 3.0 - beside
    inner = np.interp(x, [0.0, highest, 92.0], [rim + 25, rim, rim + fall])
    return [np.stack([x, inner]), np.stack([200 - x[::-1], inner[::-1]])]


def test_a_dimple_is_three_px_deep_and_wide_and_falls_to_the_probe():
    probe = Probe((100.0, 100.0), 0.0, 5.0)
    _refuse_without_dimple(sides(), probe)
    for good, bad, words in (
        ({"depth": 3.1, "fall": 2.0}, {"depth": 2.9, "fall": 2.0}, "dimple at least 3 px deep"),
        ({"beside": 3.0}, {"beside": 2.0}, "dimple at least 3 px deep"),
        # A row less than 0.3 of the depth, for it is seen in whole rows, but no fewer than two.
        ({"fall": 5.1}, {"fall": 4.9}, "an outline that falls to the probe's end"),
        (
            {"depth": 7.0, "fall": 2.0},
            {"depth": 7.0, "fall": 1.9},
            "got a fall of 1.9 px of 7.0 px beside it",
        ),
        ({"depth": 4.0, "fall": 1.3}, {"depth": 4.0, "fall": 1.1}, "an outline that falls"),
    ):
        _refuse_without_dimple(sides(**good), probe)
        for side, name in enumerate(("left", "right")):
            wrong = sides()
            wrong[side] = sides(**bad)[side]
            with pytest.raises(ValueError, match=f"{words}.* on the {name}"):
                _refuse_without_dimple(wrong, probe)
    for rows, good in ((3, True), (2, False)):
        short = sides()
        rim = int(short[0][1].argmin())
        short[0] = short[0][:, rim - rows :]
        if good:
            _refuse_without_dimple(short, probe)
        else:
            with pytest.raises(ValueError, match="on the left"):
                _refuse_without_dimple(short, probe)


def test_the_probe_is_filled_from_a_line_on_either_side():
    y, x = np.mgrid[:120, :160].astype(float)
    ground = 100.0 + 0.5 * x + 0.2 * y
    probe = Probe((80.0, 69.0), 0.1, 6.0, taper=-0.02)
    axis, half = probe.axis(y), probe.half_width_at(y)
    image = np.where((np.abs(x - axis) <= half) & (y <= 69), 20.0, ground)
    filled = _remove_probe(image, probe)
    # The ground is read at whole columns, half a grey level a px, 2 px beyond what is filled.
    np.testing.assert_allclose(filled[:71], ground[:71], atol=1.3)
    np.testing.assert_array_equal(filled[71:], image[71:].astype(np.float32))
    beyond = np.abs(x - axis) > half + 3.01
    np.testing.assert_array_equal(filled[beyond], image.astype(np.float32)[beyond])


def test_a_leaning_bar_is_followed_to_where_its_width_changes():
    smooth = np.full((80, 200), 200.0, np.float32)
    for row in range(50):
        start = 40 + 2 * row
        smooth[row, start : start + 12] = 40.0
    np.testing.assert_allclose(_follow(smooth, 40, 52, 120.0), 45.5 + 2 * np.arange(50))
    # A width that is 0.35 · 12 + 2 = 6.2 px off is another thing.
    for width, rows in ((6, 50), (5, 30)):
        narrower = smooth.copy()
        narrower[30:] = 200.0
        for row in range(30, 50):
            narrower[row, 40 + 2 * row : 40 + 2 * row + width] = 40.0
        assert len(_follow(narrower, 40, 52, 120.0)) == rows
    sharp = np.full((80, 200), 200.0, np.float32)
    for row in range(60):
        start = 40 + row
        sharp[row, start : start + 12] = 40.0
    slope, (entry, near) = _leaning_bar(sharp, 0.3, 0.7)
    assert slope == pytest.approx(1.0, abs=0.01)
    middle, half = entry[:, 0].mean(), np.ptp(entry[:, 0]) / 2
    assert middle == pytest.approx(45.5, abs=1.1)
    # A tube's other wall may stand so far beside a run that is thin.
    assert half == pytest.approx(6.5 + int(0.1 * 200 / np.cos(np.deg2rad(62.0))), abs=1.6)
    assert (entry[:, 1] == 0).all()
    # And where there is none, the bar alone: 12 px in a row.
    assert near[:, 0].mean() == pytest.approx(middle)
    assert np.ptp(near[:, 0]) / 2 == pytest.approx(6.5, abs=1.6)
    assert _leaning_bar(sharp[:16], 0.3, 0.7) is None  # as short as no probe is
    assert _leaning_bar(np.full((80, 200), 200.0, np.float32), 0.3, 0.7) is None


def corner_bar(slope: float, height: float, length: float, half: float) -> np.ndarray:
    """A bar whose axis, of a slope in x/y, passes the image's left side at `height`."""
    y, x = np.mgrid[:240, :320].astype(float)
    wide = np.hypot(1.0, slope)
    across = (x - slope * (y - height)) / wide
    along = (slope * x + y - height) / wide
    return 190.0 - 150.0 * ((np.abs(across) <= half) & (along < length))


@pytest.mark.parametrize(("height", "half"), [(-8.0, 6.0), (0.0, 6.0), (8.0, 6.0), (2.0, 10.0)])
def test_a_bar_that_enters_through_a_corner_is_turned_upright(height, half):
    image = corner_bar(0.7, height, 150.0, half).astype(np.float32)
    whole = (0, 0, image.shape[1], image.shape[0])
    _, probe, view = _upright_probe(image, View(whole, "top"), 1.0, 0.7)
    assert view.tilt == pytest.approx(np.arctan(0.7), abs=0.02)
    assert abs(probe.slope) < 0.01
    # Its end as drawn, in the image; pixels are 1 px wide along it.
    tip = view.to_image(np.array([probe.tip]))[0]
    end = np.array([0.0, height]) + 150.0 * np.array([0.7, 1.0]) / np.hypot(1.0, 0.7)
    np.testing.assert_allclose(tip, end, atol=1.0)
    assert probe.half_width == pytest.approx(half, abs=0.3)
    # Nothing above that the image's side has cut: all rows are as wide.
    row = view.of(image)[0]
    assert (row < 115).sum() == pytest.approx(2 * half, abs=1.5)
    # Mirrored, it enters through the other corner.
    mirrored = np.ascontiguousarray(image[:, ::-1])
    _, other, _ = _upright_probe(mirrored, View(whole, "top"), 1.0, 0.7)
    assert other.half_width == pytest.approx(probe.half_width, abs=0.02)


def test_a_thin_bar_that_is_short_is_turned_upright():
    """As far below the edge as a tube's other wall would enter, too little of it is left."""
    image = corner_bar(0.7, -160.0, 240.0, 6.0).astype(np.float32)
    view = View((0, 0, image.shape[1], image.shape[0]), "top")
    slope, (entry, near) = _leaning_bar(image, 1.0, 0.7)
    with pytest.raises(ValueError, match="image must show"):
        _find_probe(view.upright(slope, entry).of(image))
    _, probe, upright = _upright_probe(image, view, 1.0, 0.7)
    assert upright == view.upright(slope, near)
    tip = upright.to_image(np.array([probe.tip]))[0]
    end = np.array([0.0, -160.0]) + 240.0 * np.array([0.7, 1.0]) / np.hypot(1.0, 0.7)
    np.testing.assert_allclose(tip, end, atol=1.0)


def test_a_run_is_followed_until_it_stands_off_the_sides():
    smooth = np.full((40, 60), 200.0, np.float32)
    for row in range(20):
        smooth[row, max(0, row - 8) : row + 2] = 40.0
    # Its left end is at 0 down to row 8.
    assert _off_the_side(smooth, 0, 2, 120.0) == (9, 1, 11)
    assert _off_the_side(smooth[:, ::-1], 58, 60, 120.0) == (9, 49, 59)
    assert _off_the_side(smooth, 5, 9, 120.0) == (0, 5, 9)
    # One that ends at the side, or never leaves it, is left where it was last.
    assert _off_the_side(smooth[:4], 0, 2, 120.0) == (3, 0, 5)
    smooth[4:] = 200.0
    assert _off_the_side(smooth, 0, 2, 120.0) == (3, 0, 5)


def test_a_region_lies_inside_and_is_large_enough():
    assert part_of((100, 200), None, 64) == (0, 0, 200, 100)
    assert part_of((100, 200), (136, 36, 64, 64), 64) == (136, 36, 64, 64)
    assert part_of((100, 200), [0, 0, 200, 100], 64) == (0, 0, 200, 100)
    for wrong in ((137, 36, 64, 64), (136, 37, 64, 64), (0, 0, 63, 64), (0, 0, 64, 63)):
        with pytest.raises(ValueError, match="region must"):
            part_of((100, 200), wrong, 64)


@pytest.mark.parametrize("direction", ["top", "right", "bottom", "left"])
def test_points_of_a_turned_part_are_found_in_the_image_again(direction):
    """A blob in the image, and the place where the turned part has it."""
    y, x = np.mgrid[:150, :210].astype(float)
    view = View((30, 20, 140, 100), direction).upright(0.3, np.array([[60.0, 4.0], [75.0, 4.0]]))
    place = np.array([92.0, 71.0])
    image = np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2 * 4.0**2)).astype(np.float32)
    part = view.of(image)
    assert part.shape == view.frame[:1:-1]
    rows, columns = np.indices(part.shape)
    found = np.array([(columns * part).sum(), (rows * part).sum()]) / part.sum()
    np.testing.assert_allclose(view.to_image(found[np.newaxis])[0], place, atol=0.02)
    # The turn is that of the slope: the bar's direction (0.3, 1) is upright in the part.
    ends = view._turned(np.array([[60.0, 10.0], [63.0, 20.0]]))
    assert ends[0, 0] == pytest.approx(ends[1, 0])
    assert ends[1, 1] - ends[0, 1] == pytest.approx(np.hypot(3, 10))
    # It begins below both ends of the entry, and its columns hold all corners of the part.
    entry = view._turned(np.array([[60.0, 4.0], [75.0, 4.0]]))
    assert -2 <= entry[:, 1].max() <= -1
    width, height = view._size
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) - 0.5
    turned = view._turned(corners)
    assert turned[:, 0].min() > -1
    assert turned[:, 0].max() < view.frame[2] + 1
    assert turned[:, 1].max() == pytest.approx(view.frame[3], abs=1.0)
    changed = view.put_back(np.where(part > 0.5, np.float32(5.0), part), image)
    off = changed != image
    assert off.any()
    assert np.hypot(x - place[0], y - place[1])[off].max() < 4.0 * np.sqrt(2 * np.log(2)) + 2
    assert changed[round(place[1]), round(place[0])] == pytest.approx(5.0, abs=1e-3)


def test_a_wall_is_sought_within_its_reach_and_its_range_of_blur():
    d = np.arange(-6.0, 6.01, 0.5)
    for width in (0.7, 1.8):
        exact = np.array([wall(d, s, 190.0, -27.0, -35.0, width) for s in (-2.4, 0.0, 2.4)])
        found = locate_wall(exact, d, weights=np.ones_like(exact))
        np.testing.assert_allclose(found.position, [-2.4, 0.0, 2.4], atol=0.02)
        assert found.width == pytest.approx(width, abs=0.02)
    far = np.array([wall(d, s, 190.0, -27.0, -35.0, 1.1) for s in (-2.6, 0.0, 2.6)])
    found = locate_wall(far, d, weights=np.ones_like(far))
    assert np.isfinite(found.position).tolist() == [False, True, False]
    np.testing.assert_array_equal(np.isnan(found.std), np.isnan(found.position))


def test_a_wall_is_seen_from_one_width_on_either_side():
    d = np.arange(-5.0, 5.01, 0.5)
    exact = np.array([wall(d, 0.25, 190.0, -27.0, -35.0, 1.1)] * 5)
    weights = np.ones_like(exact)
    weights[1, d < -0.6] = 0  # from 0.75 px before
    weights[2, d < -1.1] = 0  # from 1.25 px before
    weights[3, d > 1.1] = 0
    weights[4, d > 1.6] = 0
    found = locate_wall(exact, d, weights=weights)
    assert np.isfinite(found.position).tolist() == [True, False, True, False, True]
    few = np.ones_like(exact)
    few[1, 8:] = 0
    few[1, :3] = 0  # five samples
    assert np.isfinite(locate_wall(exact, d, weights=few).position).tolist()[:2] == [True, False]


def test_samples_of_half_a_pixel_tell_half():
    d = np.arange(-5.0, 5.01, 0.5)
    rng = np.random.default_rng(3)
    one = wall(d, 0.3, 190.0, -27.0, -35.0, 1.1) + rng.normal(0, 2.0, d.size)
    found = locate_wall(one[np.newaxis], d, weights=np.ones((1, d.size)))
    start = [0.0, 190.0, -27.0, -35.0]
    fit, spread = curve_fit(lambda x, *p: wall(x, *p, found.width), d, one, p0=start)
    assert found.position[0] == pytest.approx(fit[0], abs=1e-4)
    assert found.std[0] == pytest.approx(np.sqrt(2 * spread[0, 0]), rel=1e-3)


def test_a_width_may_be_two_px_or_a_half_more_off():
    def seen(half: float):
        return SimpleNamespace(probe=Probe((0.0, 0.0), 0.0, half))

    for half, other in ((10.0, 12.1), (4.0, 5.9), (1.0, 2.9), (6.0, 8.9), (9.0, 6.1)):
        refuse_another_width(seen(half), other, 1.0)
    for half, other in ((4.0, 6.1), (10.0, 15.1), (6.1, 4.0), (15.1, 10.0)):
        with pytest.raises(ValueError, match=f"got {2 * other:g} µm where {2 * half:.3g} µm"):
            refuse_another_width(seen(half), other, 2.0)


def test_the_fit_takes_what_lies_within_a_third_beyond_the_rim():
    outline = np.stack([np.arange(200.0)] * 3)
    found = _near(outline, np.array([100.0, 0, 0, 50.0]))
    assert (found[0, 0], found[0, -1]) == (36.0, 164.0)


def test_the_search_starts_from_the_highest_points_of_a_running_median():
    x = np.arange(401.0)
    y = 60.0 - 0.01 * (np.abs(x - 200) - 100) ** 2 + np.where(x < 200, 0.0, 6.0)
    y[np.abs(x - 200) < 20] = 10.0
    y[30:34] = 500.0  # four strays of a window of nine
    boundary = SimpleNamespace(probe=Probe((200.0, 80.0), 0.0, 5.0), image_height=100)
    start = _start(x, y, boundary)
    # The median of nine is the same from 2 px before to 2 px behind a peak; the first counts.
    height = 63.0 - 0.01 * 2**2
    assert start == pytest.approx([198.0, height, 6.0 / 200, 100.0, height - 19.0, 0.003, 0.003])
    y[30:35] = 500.0
    assert _start(x, y, boundary)[1] > 100


def test_residuals_that_go_together_count_for_fewer():
    """One value everywhere: of 400 points a quarter of the lags, each with its share of pairs."""
    shares = [(400 - lag) / 400 + 7 / 400 for lag in range(1, 100)]
    expected = 400 / 393 * (1 + 2 * sum(shares))
    assert _variance_inflation(np.full(400, 3.0), 7) == pytest.approx(9 * expected)
    # To and fro there is nothing to add: the sum stops at the first lag.
    assert _variance_inflation(np.tile([2.0, -2.0], 200), 7) == pytest.approx(4 * 400 / 393)
    # Each value twice: a correlation of a half at the first lag, and none from the second on.
    rng = np.random.default_rng(0)
    twice = np.repeat(rng.choice([-1.0, 1.0], 2000), 2)
    assert _variance_inflation(twice, 7) == pytest.approx(2.0, rel=0.1)


FIT = DimpleFit(
    dimple_radius=200.0, dimple_depth=80.0, covariance=np.eye(2), center=(300.0, 250.0), tilt=0.1,
    rim_curvatures=(1 / 500, 1 / 300), misfit=0.4, pixel_size=4.0, probe_half_width=25.0,
)  # fmt: skip


def test_an_outline_that_was_fitted_is_drawn_as_far_as_there_is_an_embryo():
    # Ten radii of 50 px.
    assert np.isfinite(FIT([300 - 499.0, 300 + 499.0])).all()
    assert np.isnan(FIT([300 - 501.0, 300 + 501.0])).all()
    upright = replace(FIT, tilt=0.0)
    c, a, u = 25 / 4, 50.0, 20.0
    zeta = (c / a) ** 2
    depth = 20.0 * ((u / a) ** 2 - 1 - np.log((u / a) ** 2)) / (zeta - 1 - np.log(zeta))
    np.testing.assert_allclose(upright([320.0, 280.0, 350.0]), [250 - depth, 250 - depth, 250.0])
    # Beyond the rim each side has its own curvature, here in 1/px.
    beyond = upright([350.0 + 10, 250.0 - 10])
    radii = np.array([300.0, 500.0]) / 4
    np.testing.assert_allclose(beyond, 250 - radii + np.sqrt(radii**2 - 10**2))
    # Turned, the bottom hangs 20 px from the center, and the rims are where a turn takes them.
    turn = np.array([[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]])
    for u, v in ((0.0, -20.0), (50.0, 0.0), (-50.0, 0.0)):
        x, y = turn @ [u, v]
        assert FIT(300 + x) == pytest.approx(250 + y, abs=1e-3)


def arcs(angle: float, radius: float = 100.0) -> SimpleNamespace:
    t = np.linspace(-angle, angle, 400)
    return SimpleNamespace(x=150 + radius * np.sin(t), y=radius * np.cos(t))


def test_the_eggs_radius_is_read_where_its_ends_are_steep():
    # 60.5° over chords of 15 points: the sine of the fall is a bit below that of the end.
    assert _egg_radius(arcs(np.deg2rad(75.0)), 2.0) == pytest.approx(200.0, rel=1e-3)
    assert _egg_radius(arcs(np.deg2rad(63.5)), 2.0) == pytest.approx(200.0, rel=1e-3)
    assert _egg_radius(arcs(np.deg2rad(60.0)), 2.0) is None
    whole = arcs(np.deg2rad(75.0))
    part = SimpleNamespace(x=whole.x[100:], y=whole.y[100:])
    assert _egg_radius(part, 2.0) is None
    part = SimpleNamespace(x=whole.x[:-100], y=whole.y[:-100])
    assert _egg_radius(part, 2.0) is None


def test_intervals_and_what_the_models_make_of_them(monkeypatch):
    low, high = _interval(3.0, 0.1)
    assert (low, high) == pytest.approx((3 * np.exp(-0.1959964), 3 * np.exp(0.1959964)))
    given = {"force": 50.0, "thickness": 3.0, "radius": None}
    estimate = ModulusEstimate(2.0, 0.1, (1.0, 3.0), FIT, arcs(1.4), given)
    asked = []

    def models(**settings):
        asked.append(settings)
        return {"a": 1.0, "b": 1.5}

    monkeypatch.setattr(_modulus, "moduli_by_model", models)
    wider = np.exp(0.1959964)
    assert estimate.model_interval == pytest.approx((1.0 / wider, 2.0 * wider))
    assert asked[0] == {
        "rim_radius": 200.0, "depth": 80.0, "force": 50.0, "thickness": 3.0,
        "radius": pytest.approx(400.0, rel=1e-3),
    }  # fmt: skip
    assert estimate.misfit == pytest.approx(0.4 * 4.0 / 80.0)
    capsule = SimpleNamespace(
        misfit=0.9, radius=610.0, state=SimpleNamespace(depth=90.0, rim_radius=210.0)
    )
    other = ModulusEstimate(2.0, 0.1, (1.0, 3.0), capsule, arcs(1.4), given | {"radius": 600.0})
    assert other.misfit == pytest.approx(0.01)
    assert other.model_moduli == {"a": 1.0, "b": 1.5}
    assert (asked[1]["rim_radius"], asked[1]["depth"], asked[1]["radius"]) == (210.0, 90.0, 610.0)


def test_a_capsules_deviation_has_a_part_that_points_do_not_show(monkeypatch):
    capsule = SimpleNamespace(modulus=2.0, modulus_std=0.048)
    boundary = SimpleNamespace(probe=Probe((0.0, 0.0), 0.0, 25.0 / 4))
    monkeypatch.setattr(_modulus, "extract_boundary", lambda image, **options: boundary)
    monkeypatch.setattr(_modulus, "_seen_from_the_probe", lambda found: np.ones((3, 2)))
    asked = {}

    def fit(force, points, **options):
        asked.update(options, force=force, points=points)
        return capsule

    monkeypatch.setattr(_modulus, "fit_capsule", fit)
    found = _modulus.modulus_from_image(
        None, 70.0, pixel_size=4.0, thickness=3.0, probe_half_width=25.0, poisson_ratio=0.4,
        method="capsule", radius=600.0, law="hooke",
    )  # fmt: skip
    assert found.relative_std == pytest.approx(np.hypot(0.024, 0.005))
    np.testing.assert_array_equal(asked.pop("points"), np.full((3, 2), 4.0))
    assert asked == {
        "force": 70.0, "thickness": 3.0, "probe_half_width": 25.0, "radius": 600.0,
        "poisson_ratio": 0.4, "law": "hooke", "fit_tilt": True,
    }  # fmt: skip
    assert found.given == {
        "force": 70.0, "thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.4,
        "radius": 600.0,
    }  # fmt: skip


def test_the_direction_that_shows_a_dimple_is_taken_and_all_reasons_are_told(monkeypatch):
    seen = []

    def outline(whole, view, wanted):
        seen.append((view.direction, view.region, wanted))
        if view.direction == "left":
            return "found"
        raise ValueError("image must show one" if view.direction == "top" else "no end")

    monkeypatch.setattr(_boundary, "_outline_from_above", outline)
    image = np.full((80, 90), 100, np.uint8)
    region = (5, 6, 70, 71)
    found = _boundary.extract_boundary(image, region=region, dimple=False)
    assert found == "found"
    assert [each[0] for each in seen] == ["top", "bottom", "left"]
    assert {each[1:] for each in seen} == {(region, False)}
    with pytest.raises(ValueError, match=r"^no end \(from the right\)$"):
        _boundary.extract_boundary(image, direction="right")
