"""The pictures of results, read back from their axes."""

import copy
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot
from matplotlib.colors import LogNorm, to_rgb

from microlib.calibration import Detection, calibrate
from microlib.embryo import modulus_from_image
from microlib.focus import FocusResult
from microlib.tracking import Track, plot_track
from tests.scenes.embryo import small_egg
from tests.tracking.test_public import FOUND

mpl.use("Agg")
pytestmark = pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
ROUND = [step * 10.0**power for power in range(-4, 7) for step in (1, 2, 5)]


def hold_photograph(ax, image):
    """Black is its darkest and white its brightest level, the first row above, without axes."""
    (shown,) = ax.images
    levels = 255 * (np.asarray(image, float) - np.min(image)) / np.ptp(image)
    np.testing.assert_allclose(shown.get_array().astype(float), levels, atol=1)
    assert (shown.get_clim(), shown.get_cmap().name) == ((0, 255), "gray")
    rows, columns = np.shape(image)[:2]
    assert [*shown.get_extent()] == [-0.5, columns - 0.5, rows - 0.5, -0.5]
    assert not ax.axison


def largest_round(value):
    """Return the largest of 1, 2, 5, 10, … that is not beyond what is wanted."""
    return max(step for step in ROUND if step <= value)


def mapped(pixel_size):
    """Return a dome beside the center, unknown in a corner."""
    rng, (y, x) = np.random.default_rng(0), np.mgrid[:31, :52].astype(float)
    depth = 40 - 0.02 * ((x - 20) ** 2 + 2 * (y - 13) ** 2) + rng.normal(0, 0.05, x.shape)
    depth[:9, 30:] = np.nan
    error = np.where(np.isnan(depth), np.nan, rng.lognormal(0, 1, x.shape))
    sharp = rng.integers(20, 700, x.shape).astype(np.uint16)
    return FocusResult(depth, error, error, np.int32(y), sharp, y < 0, pixel_size=pixel_size)


@pytest.mark.parametrize(("pixel_size", "unit"), [(3.9, "µm"), (None, "frames"), (350.0, "µm")])
def test_maps_show_values_with_unit_and_scale(pixel_size, unit):
    found = replace(mapped(pixel_size), unit=unit)
    sharp, height, error, *bars = found.plot().axes
    hold_photograph(sharp, found.all_in_focus)
    given = {"height": found.depth, "uncertainty": found.uncertainty}
    for ax, bar, (name, values) in zip((height, error), bars[::-1], given.items(), strict=True):
        (shown,) = ax.images
        np.testing.assert_array_equal(shown.get_array().filled(np.nan), values)
        assert shown.get_clim() == pytest.approx(np.nanquantile(values, [0.005, 0.995]))
        assert shown.origin == "upper"
        assert to_rgb(shown.get_cmap().get_bad()) == to_rgb("0.8")
        assert isinstance(shown.norm, LogNorm) == (name == "uncertainty")
        assert (bar.get_ylabel(), shown.colorbar.extend) == (f"{name} ({unit})", "both")
        assert ax.get_title() == f"{name}, grey: {100 * 9 * 22 / (31 * 52):.3g} % unknown"
    # A bar of a round length, at most a quarter of the width.
    assert len(height.artists) == (pixel_size is not None)
    for bar in height.artists:
        value, of = bar.txt_label.get_text().split()
        (length,) = (part.get_width() * pixel_size for part in bar.size_bar.get_children())
        assert length == pytest.approx(float(value) * {"µm": 1, "mm": 1000}[of])
        assert length == pytest.approx(largest_round(pixel_size * 52 / 4))
    own, ax = pyplot.subplots()
    assert found.plot(ax) is own
    assert [len(each.images) for each in own.axes] == [1, 0]  # the height with its color bar


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_result_and_style_are_unchanged_by_a_plot(dtype, channels):
    sharp = np.random.default_rng(0).integers(20, 250, (31, 52, *channels)).astype(dtype)
    found = replace(mapped(2.0), all_in_focus=sharp)
    before, style = copy.deepcopy(found), dict(mpl.rcParams)
    found.plot()
    for name, value in vars(before).items():
        np.testing.assert_array_equal(getattr(found, name), value)
    assert dict(mpl.rcParams) == style
    found.plot().axes[0].images[0].get_array()[:] = 0  # the picture has grey levels of its own
    np.testing.assert_array_equal(found.all_in_focus, before.all_in_focus)


def test_maps_without_a_height_or_an_error_are_drawn():
    found, nothing = mapped(2.0), np.full((31, 52), np.nan)
    assert "100 % unknown" in replace(found, depth=nothing).plot().axes[1].get_title()
    exact = replace(found, uncertainty=np.zeros((31, 52))).plot().axes[2]
    assert exact.get_title() == "uncertainty"


@pytest.fixture(scope="module")
def views():
    """Return detections of three sizes, their calibration with made residuals, and photographs."""
    rng, found = np.random.default_rng(1), []
    for rows, columns in ((3, 4), (5, 4), (7, 6)):
        grid = np.argwhere(np.ones((columns, rows))) - 2
        points = 30.0 + 11 * grid @ [[1.0, 0.1], [-0.2, 0.7]]
        one, size = np.ones(len(grid)), (150, 90)
        found.append(Detection(points, grid, one, np.arange(len(grid)), grid, np.nan, 1.0, size))
    result = calibrate(found, pitch=280.0, pixel_pitch=9.9, focal_length=126000.0)
    residuals = rng.normal(0, 0.1, (74, 2)) * np.repeat([1, 3, 9], [12, 20, 42])[:, None]
    images = [rng.integers(9, 90 + 40 * k, (90, 150)) for k in range(3)]
    return found, replace(result, residuals=residuals), images


@pytest.mark.parametrize("photographs", [True, False])
def test_each_view_shows_its_marks_and_residuals(views, photographs):
    found, result, images = views
    axes = result.plot(found=found, images=images if photographs else None).axes
    assert not axes[3].axison
    assert axes[0].figure.get_size_inches()[0] == 8
    apart = np.sqrt(np.prod(np.ptp(found[0].points, axis=0)) / 12)
    factor = largest_round(apart / np.quantile(np.hypot(*result.residuals.T), 0.95))
    parts = np.split(result.residuals, [12, 32])
    for ax, each, image, own in zip(axes, found, images, parts, strict=False):
        np.testing.assert_array_equal(ax.lines[0].get_xydata(), each.points)
        arrows = ax.collections[0]
        assert (arrows.angles, arrows.scale_units, arrows.scale) == ("xy", "xy", 1)
        np.testing.assert_array_equal(arrows.XY, each.points)
        np.testing.assert_allclose(np.column_stack([arrows.U, arrows.V]), factor * own)
        rms = np.sqrt(np.mean(np.hypot(*own.T) ** 2))
        title = f"{len(each.points)} points\n{rms:.2g} px rms (red, × {factor:g})"
        assert ax.get_title() == title
        places = [[int(n) for n in text.get_text().split(",")] for text in ax.texts]
        points = dict(zip(map(tuple, each.grid), each.points, strict=True))
        np.testing.assert_array_equal([text.xy for text in ax.texts], [points[*p] for p in places])
        assert 1 <= len(places) <= 9
        if photographs:
            hold_photograph(ax, image)
        else:
            assert (ax.get_xlim(), ax.get_ylim(), ax.get_aspect()) == ((0, 150), (90, 0), 1)


def test_plot_with_given_axes_or_one_image_shows_one_view(views):
    found, result, images = views
    own, ax = pyplot.subplots()
    assert result.plot(ax, found=found) is own
    assert [len(line.get_xdata()) for line in ax.lines] == [12]
    one = replace(result, views=result.views[:1], residuals=result.residuals[:12])
    for figure in (one.plot(found=found[0], images=images[0]), found[0].plot(image=images[0])):
        hold_photograph(figure.axes[0], images[0])
    wrong = (lambda: result.plot(found=None), lambda: found[0].plot(images[0]))
    for plot, name in zip(wrong, ("found", "ax"), strict=True):
        with pytest.raises(ValueError, match=f"^{name} must be of type"):
            plot()
    with pytest.raises(ValueError, match="image must be one image"):
        result.plot(found=found, images=images[0])


def test_outline_is_drawn_with_curve_and_modulus():
    sizes = {"pixel_size": 7.75, "thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}
    found = modulus_from_image(small_egg().image, 150.0, **sizes)
    (ax,) = found.plot().axes
    ends = "{:.2g} to {:.2g} MPa".format(*found.model_interval)
    title = f"E = {ends} over {len(found.model_moduli)} models,\nby (5.2) {found.modulus}"
    assert (ax.get_title(), ax.get_xlabel(), ax.get_ylabel()) == (title, "x (px)", "y, up (px)")
    outline, curve = (line.get_xydata() for line in ax.lines)
    np.testing.assert_array_equal(outline, np.transpose([found.boundary.x, found.boundary.y]))
    np.testing.assert_array_equal(curve, found.dimple.curve.T)
    assert not ax.yaxis_inverted()
    flat = replace(found, boundary=replace(found.boundary, y=found.boundary.y / 9))
    (ax,) = flat.plot().axes
    width, height = np.ptp(outline, axis=0) / [1, 9]
    # Four times as wide as high, to half a whole factor.
    assert width / height / ax.get_aspect() == pytest.approx(4, rel=0.25)
    assert ax.get_ylabel() == f"y, up (px), drawn {ax.get_aspect():g} times as high"


@pytest.mark.parametrize(("timed", "micrometers"), [(True, False), (False, True)])
def test_path_is_drawn_over_the_frame_and_against_time(timed, micrometers):
    """The part is lost in the first and in the fourth frame."""
    image = np.random.default_rng(0).uniform(3.0, 90.0, (120, 170))
    box = np.array([[0.0, 0.0], [19, 0], [19, 9], [0, 9]])
    starts, k = np.array([(70.0 + 3 * k, 60.0 - 2 * k * k) for k in range(7)]), np.arange(7)
    lost = np.isin(k, (0, 3))
    tracks = [
        Track(**FOUND | {"corners": box + start, "lost": each})
        for start, each in zip(starts, lost, strict=True)
    ]
    table = pd.DataFrame([track.to_dict() for track in tracks])
    if timed:
        table["time_s"] = k / 8
    if micrometers:
        table[["x_um", "y_um"]] = np.where(lost[:, None], np.nan, 1.7 * (starts - (70, 60)))
    way, against = plot_track(table, image).axes
    hold_photograph(way, image)
    middle = starts + np.array([9.5, 4.5])
    gaps = np.where(lost[:, None], np.nan, middle)
    wanted = (gaps, *(box[[0, 1, 2, 3, 0]] + start for start in (starts[-1], starts[1])))
    for line, points in zip(way.lines, wanted, strict=True):
        np.testing.assert_array_equal(line.get_xydata().astype(float), points)
    assert [line.get_label() for line in way.lines[1:]] == ["last position", "first position"]
    # Twice the box's sides are seen about the way, inside the frame.
    assert way.get_xlim() == (middle[1, 0] - 38, middle[-1, 0] + 38)
    assert way.get_ylim() == (middle[1, 1] + 18, -0.5)
    assert way.get_title() == "path on the first frame, lost in 28.6 % of the frames"
    time = k / 8 if timed else k
    moves = 1.7 * (gaps - middle[0]) if micrometers else gaps - middle[1]
    for line, values in zip(against.lines, moves.T, strict=False):
        np.testing.assert_allclose(line.get_data(), [time, values], atol=1e-12)
    np.testing.assert_array_equal(against.lines[2].get_data(), [time[[0, 3]], [0, 0]])
    assert [text.get_text() for text in against.get_legend().texts] == ["x", "y (down)", "lost"]
    assert against.get_xlabel() == ("time (s)" if timed else "frame")
    assert against.get_ylabel() == f"displacement from the start ({'µm' if micrometers else 'px'})"
    own, ax = pyplot.subplots()
    assert plot_track(table[1:3], image, ax) is own
    for wrong in (table[["center_x", "center_y", "lost"]], table.iloc[1], None):
        with pytest.raises(ValueError, match="table must be that of a track, with its"):
            plot_track(wrong, image)
    with pytest.raises(ValueError, match="ax must be of type Axes, got <Figure"):
        plot_track(table, image, own)
    for wrong in (image[None].repeat(4, axis=0), image[0], "image"):
        with pytest.raises(ValueError, match=r"image must (be one image|hold real)"):
            plot_track(table, wrong)
