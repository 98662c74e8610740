"""Stage micrometers against scales that the library's renderer did not draw."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.stats import t as student

from microlib.calibration import detect_micrometer
from tests.checks import hold_sigma
from tests.scenes.calibration import SHAPE, ruled, scale

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


LINES = np.arange(-10, 11)


@pytest.mark.parametrize(
    ("places", "lengths", "true"),
    [
        (13 * LINES, 25.0 + 15 * (LINES % 5 == 0) + 15 * (LINES % 10 == 0), 13.0),
        (13 * LINES, np.where(LINES % 2 == 0, 80.0, 20.0), 13.0),
        (np.append(np.arange(-120, 0, 40), np.arange(0, 120, 8)), 30.0, 8.0),
        (np.append(np.arange(-140, 70, 30), np.arange(70, 140, 6)), 30.0, 6.0),
        (6.5 * LINES[np.abs(LINES) != 3], 30.0, 6.5),
        (90.0 * LINES[9:12], 200.0, 90.0),
    ],
    ids=["three lengths", "every second short", "coarse and fine", "mostly coarse", "two missing",
         "three wide lines"],
)  # fmt: skip
def test_lines_of_several_lengths_and_distances_are_numbered(places, lengths, true):
    found = detect_micrometer(ruled(places, lengths, 0.25 * true, numerals=len(places) > 3))
    expected = np.round((places - places[0]) / true).astype(int)
    mirrored = (expected[-1] - expected)[::-1]  # the direction has two senses
    assert [*found.divisions] in ([*expected], [*mirrored])
    assert found.spacing.value == pytest.approx(true, rel=3e-4)


@pytest.mark.parametrize("change", [{"k1": 0.01}, {"k1": -0.03}, {"tilt": 0.02}])
def test_interval_contains_the_change_of_the_spacing_over_the_image(change):
    """Two halves of an image differed by 20 times what the interval of each stated."""
    image = ruled(np.arange(-200, 201, 10), 60.0, 2.5, angle=0.0, shape=(160, 440), **change)
    whole, left, right, middle = (
        detect_micrometer(image[:, columns]).spacing
        for columns in (slice(None), slice(0, 220), slice(220, 440), slice(110, 330))
    )
    for part in (left, right, middle):
        assert whole.low < part.value < whole.high
        # A half of the image shows the whole range of a distance that grows with x².
        assert whole.uncertainty > 0.95 * part.uncertainty
    # The distance at the ends of the scale, by the derivative of the renderer's map.
    x = np.array([-200.0, 200]) / 220
    k1, tilt = change.get("k1", 0.0), change.get("tilt", 0.0)
    local = 10 * (1 + 3 * k1 * x**2) / (1 + tilt * x) ** 2
    widest = max(abs(local - whole.value))
    assert 0.3 * widest < whole.uncertainty < widest


@pytest.mark.parametrize(("kind", "fewest"), [("single", 16), ("adding up", 14), ("periodic", 20)])
def test_interval_contains_errors_of_the_ruling(kind, fewest):
    """Errors of single lines, of each distance, or a drift that jumps back after ten divisions.

    Of errors that add up, a few of 28 lines do not always show it: 85 % of the intervals hold.
    """
    inside, rng = 0, np.random.default_rng(8)
    for seed in range(20):
        errors = rng.normal(0, 0.02, 28)
        errors = np.cumsum(errors) if kind == "adding up" else errors
        if kind == "periodic":  # as those of a photographed micrometer
            errors = 0.04 * ((np.arange(28) + seed) % 10 / 10 - 0.45)
        places = 10 * (np.arange(28) - 13.5 + errors)
        found = detect_micrometer(ruled(places, 60.0, 2.5, seed=seed, angle=0.2))
        inside += found.spacing.low <= 10 <= found.spacing.high
        sense = 1 if np.cos(found.angle - 0.2) > 0 else -1
        seen = sense * places[::sense]
        line = np.polyfit(found.divisions, seen, 1)
        np.testing.assert_allclose(
            found.residuals, seen - np.polyval(line, found.divisions), atol=0.05
        )
    assert inside >= fewest


def test_line_grid_is_read():
    across = ruled(np.arange(-168, 169, 12), 500.0, 3.0, angle=0.03)
    along = ruled(np.arange(-168, 169, 12), 500.0, 3.0, angle=0.03 + np.pi / 2)
    found = detect_micrometer(np.minimum(across, along))
    assert found.spacing.value == pytest.approx(12.0, rel=1e-3)


def counting_chamber():
    """The triple lines of Neubauer's chamber, which are no division of its squares."""
    group = np.array([-6, 0, 6, 25, 50, 75])
    lines = np.concatenate([group + 100 * k for k in (-2, -1, 0, 1)])
    return np.minimum(*(ruled(lines, 900.0, 2.0, angle=0.03 + turn) for turn in (0, np.pi / 2)))


def uneven_lines():
    rng, image = np.random.default_rng(5), np.full((60, 300), 190.0)
    for place in np.cumsum(rng.uniform(8, 24, 16)).astype(int):
        image[:, place - 1 : place + 2] = 60
    return cv2.GaussianBlur(image, (0, 0), 1.0) + rng.normal(0, 1, image.shape)


def diagonal_lines():
    """Most of every row of the turned strip lies outside the image, of which NumPy warned."""
    y, x = np.mgrid[:60, :600]
    return 128 + 60 * np.sin((x + y) * 2 * np.pi / 20)


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (counting_chamber, "equidistant lines, got"),
        (uneven_lines, "scale of equidistant lines"),
        (diagonal_lines, "got no row of pixels that crosses the lines"),
    ],
)
def test_lines_that_are_no_scale_are_refused(draw, message):
    with pytest.raises(ValueError, match=message):
        detect_micrometer(draw())


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
