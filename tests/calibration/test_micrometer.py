"""Stage micrometers against scales that the library's renderer did not draw."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.stats import t as student

from microlib.calibration import detect_micrometer
from tests.calibration.scenes import SHAPE, scale
from tests.laws import hold_sigma

HEIGHT, WIDTH = SHAPE


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"angle": 1.5},
        {"angle": -0.8, "spacing": 25.0, "lines": 9, "length": 50.0},
        {"ink": 200.0, "paper": 60.0},
        {"noise": 8.0},
        {"blur": 2.0},
        {"lines": 6, "spacing": 45.0, "width": 0.1, "length": 40.0},
    ],
)
def test_spacing_of_scale_lines_is_accurate(change):
    drawn = {"spacing": 12.3, "angle": 0.2, "length": 30.0} | change
    found = detect_micrometer(scale(**drawn))
    true, angle = drawn["spacing"], drawn["angle"]
    # Noise leaves 0.0002 to 0.0015 px; a wrong line would be 1/16 of a spacing.
    assert found.spacing.value == pytest.approx(true, rel=3e-4)
    assert abs(found.spacing.value - true) < 4 * found.spacing.uncertainty
    # Across the lines, to either side: a lean of 0.02 makes 2e-4 of the spacing.
    assert abs(np.sin(found.angle - angle)) < 0.02
    assert np.diff(found.divisions).min() >= 1
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    across, along = turn @ (found.points - np.array([WIDTH, HEIGHT]) / 2).T
    # The scale's middle is drawn within 4.3 px of the image's; every point is on its line.
    assert abs(across.mean()) < 5
    np.testing.assert_allclose(np.abs(np.diff(across)), true * np.diff(found.divisions), atol=0.2)
    assert -5 < along.min() <= along.max() < drawn["length"] + 5


def test_missing_line_is_skipped_and_uneven_lines_are_rejected():
    """A line that is gone is skipped in the count; one in the wrong place is no scale's."""
    image = scale(angle=0.0, numerals=False)
    x = int(detect_micrometer(image).points[8, 0])
    image[:, x - 6 : x + 6] = 190
    found = detect_micrometer(image)
    np.testing.assert_array_equal(found.divisions, np.delete(np.arange(17), 8))
    assert found.spacing.value == pytest.approx(12.3, rel=3e-4)
    rng = np.random.default_rng(5)
    uneven = np.full((60, 300), 190.0)
    for place in np.cumsum(rng.uniform(8, 24, 16)).astype(int):
        uneven[:, place - 1 : place + 2] = 60
    with pytest.raises(ValueError, match="scale of equidistant lines"):
        detect_micrometer(cv2.GaussianBlur(uneven, (0, 0), 1.0) + rng.normal(0, 1, uneven.shape))


@pytest.mark.parametrize("cut", [0.2, 0.5, 0.8])
def test_line_that_the_edge_of_the_image_cuts_is_left_out(cut):
    """It was a peak elsewhere than the line, and wide lines were refused as uneven."""
    width, spacing = 16.0, 40.0
    first = width * (1 / 2 - cut)  # the edge hides this share of the first line
    x = np.arange(300.0)[None]
    away = np.abs((x - first + spacing / 2) % spacing - spacing / 2)
    profile = cv2.GaussianBlur(np.where(away < width / 2, 60.0, 200.0), (0, 0), 2.0)
    image = np.tile(profile, (60, 1)) + np.random.default_rng(2).normal(0, 2, (60, 300))
    turn = cv2.getRotationMatrix2D((150, 30), 0.3, 1.0)
    found = detect_micrometer(cv2.warpAffine(image, turn, (300, 60), borderMode=cv2.BORDER_REFLECT))
    assert found.points[:, 0].min() > spacing / 3
    # Noise moves it by up to 0.02 px; a line that is cut by a fifth would by 0.17 px.
    assert found.spacing.value == pytest.approx(spacing, abs=0.06)


def test_diagonal_lines_in_a_long_strip_are_refused_without_a_warning():
    """Most of every row of the turned strip lies outside the image, of which NumPy warned."""
    y, x = np.mgrid[:60, :600]
    with pytest.raises(ValueError, match="got no row of pixels that crosses the lines"):
        detect_micrometer(128 + 60 * np.sin((x + y) * 2 * np.pi / 20))


@pytest.mark.parametrize("spacing", [7.7, 13.7])
@pytest.mark.parametrize("angle", [0.0, 0.2])
def test_uneven_light_adds_no_bias_to_a_scale(spacing, angle):
    """Light that falls to a quarter moved the centers of the lines by a twentieth of a division."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] / np.array([HEIGHT, WIDTH])[:, None, None]
    light = (1 - 0.5 * x) * (1 - 0.8 * ((x - 0.5) ** 2 + (y - 0.5) ** 2))
    image = scale(3, spacing=spacing, angle=angle, lines=int(190 / spacing), blur=1.5)
    found = detect_micrometer(image * light)
    assert found.spacing.value == pytest.approx(spacing, rel=1e-3)


@pytest.mark.parametrize(("count", "draws"), [(5, 150), (20, 60)])
def test_sigma_of_the_spacing_uses_degrees_of_freedom_of_lines(count, draws):
    """The spacing's σ in drawn images of few and many lines: ν is their number less two."""
    rng = np.random.default_rng(count)
    errors, sigmas = [], []
    x = np.arange(12 * count + 30.0)
    # Of five lines a σ by ν = 5 in place of 3 is 29 % less, what `hold_sigma` sees of 150.
    for _ in range(draws):
        places = 21.3 + 12.0 * np.arange(count) + rng.normal(0, 0.05, count)
        dark = np.exp(-((x - places[:, None]) ** 2) / 4).sum(axis=0)
        found = detect_micrometer(np.tile(200 - 120 * dark, (20, 1)).astype(np.float32))
        errors.append(found.spacing.value - 12.0)
        sigmas.append(found.spacing.uncertainty)
    hold_sigma(errors, sigmas, freedom=count - 2)
    size, spacing = found.um_per_pixel(10.0), found.spacing
    ends = spacing.value + student(count - 2).ppf([0.025, 0.975]) * spacing.uncertainty
    np.testing.assert_allclose(spacing.interval, ends)
    np.testing.assert_allclose(
        [size.value, size.high, size.low], 10.0 / np.array([spacing.value, *ends])
    )
    assert size.uncertainty / size.value == pytest.approx(spacing.uncertainty / spacing.value)
    assert (spacing.unit, size.unit) == ("px", "µm/px")
