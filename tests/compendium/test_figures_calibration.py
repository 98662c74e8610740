"""Detected points, the microscope from the side and the studies of f stand where they belong."""

from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium.figures import calibration
from microlib.microscope import Microscope

FOUND = SimpleNamespace(
    points=np.array([[10.0, 20.0], [50.0, 22.0], [98.0, 40.0], [30.0, 55.0]]),
    grid=np.array([[0, 0], [1, 0], [2, 2], [0, 2]]),
)


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def test_detected_points_lie_on_their_image():
    _, axes = plt.subplots()
    image = np.zeros((60, 100))
    calibration.draw_detection(axes, image, FOUND, label_every=2)
    np.testing.assert_array_equal(axes.lines[0].get_xydata(), FOUND.points)
    # Every other circle has its coordinates, those at the right edge of 93 % have no room.
    labels = {text.get_text(): text.xy for text in axes.texts}
    assert labels == {"0,0": (10.0, 20.0), "0,2": (30.0, 55.0)}
    # Pixel centers at integers, y down.
    assert axes.get_xlim() == (-0.5, 99.5)
    assert axes.get_ylim() == (59.5, -0.5)
    assert axes.images[0].get_clim() == (0, 255)


def test_the_microscope_is_drawn_to_its_lengths():
    """The oblique view of §2: along Z in mm, the others 20 times larger, X going up and back."""
    tube, focal, distance = 200_000.0, 100_000.0, 50_000.0
    scope = Microscope(
        tube_length=tube,
        focal_length=focal,
        distance=distance,
        distortion=0.0,
        alpha=0.0,
        beta=0.0,
        gamma=0.0,
        tx=0.0,
        ty=0.0,
        pixel_size=10.0,
        image_size=(201, 101),
    )
    _, axes = plt.subplots()
    x, y = 300.0, 500.0  # µm
    calibration.draw_microscope(axes, scope, np.array([[x, y], [0.0, -100.0]]))
    dots = [line for line in axes.lines if line.get_marker() == "o"]
    pattern, image = (line.get_xydata() for line in dots)

    def screen(x, y, z):  # µm
        return [(z + 10 * x) / 1000, -20 * (y + 0.35 * x) / 1000]

    np.testing.assert_allclose(pattern[0], screen(x, y, focal + distance), rtol=1e-12)
    np.testing.assert_allclose(pattern[1], screen(0, -100, focal + distance), rtol=1e-12)
    # The virtual image is (T + f)/(f + d) = 2 times as large.
    np.testing.assert_allclose(image[0], screen(2 * x, 2 * y, tube + focal), rtol=1e-12)
    # A ray from the center of the lens through each point, and the axis beyond the image.
    np.testing.assert_allclose(axes.lines[0].get_xydata(), [[0, 0], image[0]], atol=1e-12)
    np.testing.assert_allclose(axes.lines[2].get_xydata()[-1], [1.08 * 300, 0], atol=1e-12)
    # The sensor, 200 by 100 cells of 10 µm between centers of its corner pixels.
    seen, sensor = (line.get_xydata() for line in axes.lines[-2:])
    np.testing.assert_allclose(sensor[0], screen(-1000, -500, tube + focal), rtol=1e-9)
    np.testing.assert_allclose(sensor[1], screen(1000, -500, tube + focal), rtol=1e-9)
    np.testing.assert_allclose(seen[2], screen(500, 250, focal + distance), rtol=1e-9)
    names = {text.get_text(): text.get_position()[0] for text in axes.texts}
    arrows = [(text.xy, text.xyann) for text in axes.texts if not text.get_text()]
    spans = sorted((a[0], b[0]) for a, b in arrows if a[1] == b[1] and a[1] < -10)
    assert spans == [(0, 100), (0, 300), (100, 150)]  # f, T + f and d, mm
    # In two rows, so that none lies on another.
    rows = {b[0]: a[1] for a, b in arrows if a[1] == b[1] and a[1] < -10}
    assert rows[300] < rows[100] == rows[150]
    # Below everything else, and in view.
    floor = min(a[1] for a, b in arrows)
    assert floor < min(line.get_ydata().min() for line in axes.lines)
    assert axes.get_ylim()[0] < floor
    place = {text.get_text(): text.get_position() for text in axes.texts}
    for name, (u, v) in {"$C_o$": (0, 0), "$C_i$": (300, 0), "$C_w$": (150, 0)}.items():
        assert abs(place[name][0] - u) < 8, name
        assert 0 < place[name][1] - v < 12, name
    assert names["f"] == pytest.approx(50)
    assert names["d"] == pytest.approx(125)
    assert names["$T_{op} + f$"] == pytest.approx(150)
