"""A stage micrometer: its lines are rendered through their distances, in finer pixels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from microlib.calibration import detect_micrometer

WIDTH, HEIGHT, FINE = 320, 240, 4


def scale(
    seed: int = 0,
    *,
    spacing: float = 12.3,
    angle: float = 0.2,
    lines: int = 17,
    width: float = 0.25,
    length: float = 30.0,
    blur: float = 1.2,
    noise: float = 2.0,
    ink: float = 60.0,
    paper: float = 190.0,
    numerals: bool = True,
) -> np.ndarray:
    """A ruler whose every tenth line is longer and has a numeral."""
    rng = np.random.default_rng(seed)
    middle = np.array([WIDTH, HEIGHT]) / 2 + rng.uniform(-3, 3, 2)
    y, x = (np.mgrid[: HEIGHT * FINE, : WIDTH * FINE] + 0.5) / FINE - 0.5
    cos, sin = np.cos(angle), np.sin(angle)
    across = (x - middle[0]) * cos + (y - middle[1]) * sin
    along = -(x - middle[0]) * sin + (y - middle[1]) * cos
    number = np.round(across / spacing + (lines - 1) / 2)
    end = np.where(number % 10 == 0, 2 * length, length)
    beside = np.abs(across - (number - (lines - 1) / 2) * spacing)
    inside = np.minimum(width * spacing / 2 - beside, np.minimum(along, end - along))
    covered = np.clip(inside * FINE + 0.5, 0, 1) * ((number >= 0) & (number < lines))
    image = (paper + (ink - paper) * covered).astype(np.float32)
    for ten in range(0, lines, 10) if numerals else ():
        at = (ten - (lines - 1) / 2) * spacing, 2 * length + 18
        place = np.array([at[0] * cos - at[1] * sin, at[0] * sin + at[1] * cos]) + middle
        written = np.zeros(image.shape, np.uint8)
        where = (place * FINE).astype(int).tolist()
        cv2.putText(written, str(ten // 10), where, cv2.FONT_HERSHEY_SIMPLEX, 1.6, 255, 6)
        image[written > 0] = ink
    image = cv2.GaussianBlur(image, (0, 0), blur * FINE)
    image = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return np.clip(np.round(image + rng.normal(0, noise, image.shape)), 0, 255).astype(np.uint8)


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
    found = detect_micrometer(scale(**change))
    true = change.get("spacing", 12.3)
    # Noise leaves 0.0002 to 0.0015 px; a wrong line would be 1/16 of a spacing.
    assert found.spacing == pytest.approx(true, rel=3e-4)
    assert abs(found.spacing - true) < 4 * found.spacing_sigma
    turn = found.angle - change.get("angle", 0.2)
    # Across the lines, to either side: a lean of 0.02 makes 2e-4 of the spacing.
    assert abs(np.sin(turn)) < 0.02
    assert np.diff(found.divisions).min() >= 1
    angle = change.get("angle", 0.2)
    across, along = (
        np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        @ (found.points - np.array([WIDTH, HEIGHT]) / 2).T
    )
    # The scale's middle is drawn within 4.3 px of the image's; every point is on its line.
    assert abs(across.mean()) < 5
    np.testing.assert_allclose(np.abs(np.diff(across)), true * np.diff(found.divisions), atol=0.2)
    assert -5 < along.min() <= along.max() < change.get("length", 30.0) + 5


def test_missing_line_is_skipped_and_uneven_lines_are_rejected():
    """A line that is gone is skipped in the count; one in the wrong place is no scale's."""
    image = scale(angle=0.0, numerals=False)
    whole = detect_micrometer(image)
    x = int(whole.points[8, 0])
    image[:, x - 6 : x + 6] = 190
    found = detect_micrometer(image)
    np.testing.assert_array_equal(found.divisions, np.delete(np.arange(17), 8))
    assert found.spacing == pytest.approx(12.3, rel=3e-4)
    rng = np.random.default_rng(5)
    uneven = np.full((60, 300), 190.0)
    for place in np.cumsum(rng.uniform(8, 24, 16)).astype(int):
        uneven[:, place - 1 : place + 2] = 60
    with pytest.raises(ValueError, match="scale of equidistant lines"):
        detect_micrometer(cv2.GaussianBlur(uneven, (0, 0), 1.0) + rng.normal(0, 1, uneven.shape))


@pytest.mark.parametrize("spacing", [7.7, 13.7])
@pytest.mark.parametrize("angle", [0.0, 0.2])
def test_uneven_light_adds_no_bias_to_a_scale(spacing, angle):
    """Light that falls to a quarter moved the centers of the lines by a twentieth of a division."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] / np.array([HEIGHT, WIDTH])[:, None, None]
    light = (1 - 0.5 * x) * (1 - 0.8 * ((x - 0.5) ** 2 + (y - 0.5) ** 2))
    image = scale(3, spacing=spacing, angle=angle, lines=int(190 / spacing), blur=1.5)
    found = detect_micrometer(image * light)
    assert found.spacing == pytest.approx(spacing, rel=1e-3)
