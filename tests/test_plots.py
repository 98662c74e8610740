"""The pictures of results: what is drawn is where the result has it."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot

from microlib import synthetic
from microlib.calibration import calibrate, detect_circles
from microlib.embryo import modulus_from_image
from microlib.focus import depth_from_focus
from microlib.microscope import Microscope
from microlib.tracking import plot_track, track_all

mpl.use("Agg")


@pytest.fixture(autouse=True)
def _closed():
    yield
    pyplot.close("all")


def test_the_maps_show_the_heights_with_their_unit_and_scale() -> None:
    texture = synthetic.mixed_texture((48, 70), np.random.default_rng(0))
    dome = synthetic.paraboloid((48, 70), height=80.0)
    stack = synthetic.focal_stack(texture, dome, np.arange(5.0, 95.0, 10.0), blur_rate=0.1)
    found = depth_from_focus(stack, np.arange(5.0, 95.0, 10.0))
    found.depth[:12] = np.nan
    figure = found.plot()
    unknown = 100 * np.isnan(found.depth).mean()
    assert figure.axes[1].get_title() == f"height, grey: {unknown:.2g} % unknown"
    titles = [ax.get_title().split(",")[0] for ax in figure.axes if ax.get_title()]
    assert titles == ["all in focus", "height", "uncertainty", "shaded"]
    height = figure.axes[1].images[0]
    np.testing.assert_array_equal(height.get_array().filled(np.nan), found.depth)
    assert {ax.get_ylabel() for ax in figure.axes[4:]} == {"height (µm)", "uncertainty (µm)"}
    # In axes of one's own the height alone.
    own, ax = pyplot.subplots()
    assert found.plot(ax) is own
    assert len(own.axes) == 2  # with its color bar
    units = {ax.get_ylabel() for ax in found.plot(unit="frames").axes[4:]}
    assert units == {"height (frames)", "uncertainty (frames)"}


def test_a_scale_bar_is_as_long_as_it_says() -> None:
    from microlib._plots._focus import _scale_bar

    _, ax = pyplot.subplots()
    ax.imshow(np.zeros((40, 90)))
    _scale_bar(ax, 3.9, 90)
    (bar,) = ax.artists
    assert bar.txt_label.get_text() == "50 µm"
    (length,) = [p.get_width() for p in bar.size_bar.get_children()]
    assert length * 3.9 == pytest.approx(50)


def test_marks_and_residuals_are_drawn_on_the_photograph() -> None:
    scope = Microscope(2e5, 126000, 79380, alpha=0.1, beta=0.03, tx=-900, ty=-700)
    photograph = synthetic.render_circles(scope, pitch=280.0)
    found = detect_circles(photograph)
    result = calibrate(found, pitch=280, pixel_size=9.9, focal_length=126000)
    for figure in (result.plot(found=found, images=photograph), found.plot(image=photograph)):
        (ax,) = figure.axes
        np.testing.assert_array_equal(np.column_stack(ax.lines[0].get_data()), found.points)
        for text in ax.texts:  # a place in the grid, at its point
            place = np.array(text.get_text().split(","), dtype=int)
            at = found.points[(found.grid == place).all(axis=1)]
            np.testing.assert_array_equal(at, [text.xy])
        assert 4 < len(ax.texts) < 40
    arrows = result.plot(found=found).axes[0].collections[0]
    assert arrows.axes.yaxis_inverted()  # rows go down without the photograph, too
    seen = np.column_stack([arrows.U, arrows.V])
    factor = np.linalg.norm(seen) / np.linalg.norm(result.residuals)
    np.testing.assert_allclose(seen, factor * result.residuals)
    assert f"{result.reprojection.rms:.2g} px rms (red, × {factor:g})" in arrows.axes.get_title()


def test_the_outline_is_drawn_with_its_modulus() -> None:
    embryo = synthetic.Embryo(modulus=1.2, force=1.2, dimple_radius=240.0)
    scene = synthetic.embryo_image(embryo, rng=np.random.default_rng(1))
    found = modulus_from_image(
        scene.image,
        1.2,
        pixel_size=scene.pixel_size,
        thickness=3.0,
        probe_half_width=25.0,
        poisson_ratio=0.5,
    )
    (ax,) = found.plot().axes
    assert f"modulus {found.modulus:.4g} MPa" in ax.get_title()
    points, curve = (np.column_stack(line.get_data()) for line in ax.lines[:2])
    np.testing.assert_array_equal(points[:, 0], found.boundary.x)
    near = np.interp(points[:, 0], *curve.T)
    close = np.abs(points[:, 0] - found.dimple.center[0]) < 50
    assert np.median(np.abs(near - points[:, 1])[close]) < 1  # px


def test_the_way_is_drawn_over_the_first_frame_and_against_time() -> None:
    path = [(60.0 + 2.5 * k, 60.0 - k) for k in range(5)]
    frames = synthetic.texture_sequence(path, np.random.default_rng(0))
    table = track_all(frames, (60, 60, 49, 49), "translation", rate=20.0)
    figure = plot_track(table, frames[0])
    seen = np.column_stack(figure.axes[0].lines[0].get_data()).astype(float)
    np.testing.assert_allclose(seen - seen[0], np.array(path) - path[0], atol=0.1)
    box = np.column_stack(figure.axes[0].lines[1].get_data())  # of the frame that is shown
    np.testing.assert_allclose(box[:4].mean(axis=0), np.array(path[0]) + 24, atol=0.6)
    x, y = (np.column_stack(line.get_data()) for line in figure.axes[1].lines[:2])
    np.testing.assert_allclose(x, [(k / 20, 2.5 * k) for k in range(5)], atol=0.1)
    np.testing.assert_allclose(y, [(k / 20, -k) for k in range(5)], atol=0.1)
    assert figure.axes[1].get_ylabel() == "way from the start (px)"
    table = track_all(frames, (60, 60, 49, 49), "translation", pixel_size=3.9)
    (x, y), ax = table[["x_um", "y_um"]].to_numpy(float).T, plot_track(table, frames[0]).axes[1]
    np.testing.assert_allclose([line.get_ydata() for line in ax.lines[:2]], [x, y])
    assert ax.get_ylabel() == "way from the start (µm)"
