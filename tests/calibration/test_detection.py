"""Rendering and detection of calibration targets: against analytic images, exact projections and
OpenCV."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from compendium import thesis
from microlib.calibration import (
    detect_circles,
    detect_micrometer,
    detect_pattern,
    detect_squares,
)
from microlib.microscope import Microscope
from microlib.synthetic import ImagingConditions, render_circles, render_squares

DEGREE = np.pi / 180
SMALL = Microscope(2e5, 1e5, 5e4, tx=-700, ty=-560, image_size=(300, 240))
PITCH = 30 * 9.9 / 2  # 30 px
CIRCLE_1X, CIRCLE_4X, SQUARE_1X, SQUARE_4X = map(thesis.microscope, thesis.COLUMNS)


def box_edge(x, edge, blur):
    """Part of pixel `x` to the right of a blurred straight edge: the box integral of the normal
    distribution."""

    def integral(t):
        return t * ndtr(t) + np.exp(-t * t / 2) / np.sqrt(2 * np.pi)

    upper, lower = (x + 0.5 - edge) / blur, (x - 0.5 - edge) / blur
    return blur * (integral(upper) - integral(lower))


def errors(scope, found, pitch):
    """Image points minus true ones, px; the grid may differ from the truth by its origin and by
    which axis is the first."""
    grid = np.round(scope.back_project(found.points) / pitch)
    counted = np.column_stack([found.grid, np.ones(len(grid))])
    change, residual, *_ = np.linalg.lstsq(counted, grid)
    assert residual.max() < 1e-9
    np.testing.assert_allclose(np.sort(np.abs(change[:2])), [[0, 1], [0, 1]], atol=1e-9)
    return found.points - scope.project(grid * pitch)


# Rendering


def test_rendered_edge_equals_its_exact_integral():
    image = render_squares(
        SMALL, side=20 * 9.9 / 2, counts=(1, 1), imaging=ImagingConditions(blur=1.3)
    )
    left, right = SMALL.project([[0.0, 0.0], [99.0, 0.0]])[:, 0]
    row = int(SMALL.project([[0.0, 49.5]])[0, 1])
    x = np.arange(300)
    covered = box_edge(x, left, 1.3) - box_edge(x, right, 1.3)
    # The point-spread function is a Gaussian sampled every third of a pixel and cut off at 4.2
    # standard deviations: 2e-4 of the contrast of 150 grey levels.
    np.testing.assert_allclose(image[row], 200 - 150 * covered, atol=0.03)


@given(turn=st.floats(0, 2 * np.pi), x=st.floats(-3, 3), y=st.floats(-3, 3))
@settings(deadline=None, max_examples=15)
def test_rendered_areas_are_exact(turn, x, y):
    """Without blur, the dark area of one shape is its area on the sensor."""
    scope = Microscope(2e5, 1e5, 5e4, alpha=turn, tx=x, ty=y, image_size=(80, 80))
    sharp = ImagingConditions(blur=0.0)
    pixel = 9.9 / 2
    circle = ((200 - render_circles(scope, radius=80, counts=(1, 1), imaging=sharp)) / 150).sum()
    # Straight edges in cells of a third of a pixel: relative error (1/3)²/(24 r²), r = 16 px;
    # float32 sums.
    assert circle * pixel**2 == pytest.approx(np.pi * 80**2, rel=4e-5)
    square = ((200 - render_squares(scope, side=100, counts=(1, 1), imaging=sharp)) / 150).sum()
    # Exact but for the corners of the square, which are cut to 1/24 of a pixel.
    assert square * pixel**2 == pytest.approx(100**2, rel=1e-5)


def test_rendered_noise_follows_its_seed_and_sigma():
    noisy = ImagingConditions(noise=3.0)
    one, again, other = (render_squares(SMALL, imaging=noisy, rng=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    # Standard error of a standard deviation from 72000 pixels: 0.26 %; four of them.
    clean = render_squares(SMALL, imaging=replace(noisy, noise=0.0))
    assert (one - clean).std() == pytest.approx(3.0, rel=0.011)
    assert (one != other).any()
    with pytest.raises(ValueError, match="rng"):
        render_squares(SMALL, imaging=noisy)
    with pytest.raises(ValueError, match="pitch"):  # circles that overlap
        render_circles(SMALL, radius=140)


# Detection


def whole_circles(scope, margin=0.3):
    """Centers of the circles whose outline lies so far inside the image, px."""
    cells = np.stack(np.meshgrid(np.arange(-20, 21), np.arange(-20, 21)), axis=-1).reshape(-1, 2)
    turn = np.linspace(0, 2 * np.pi, 40)
    rim = cells[:, None] * 280.0 + 70 * np.column_stack([np.cos(turn), np.sin(turn)])
    seen = scope.project(rim.reshape(-1, 2)).reshape(rim.shape)
    return cells[((seen > margin) & (seen < np.array([655, 490]) - margin)).all(axis=(1, 2))]


def whole_squares(scope, side):
    """Corners of the squares that lie at least 0.3 px inside the image."""
    cells = np.stack(np.meshgrid(np.arange(-60, 61), np.arange(-60, 61)), axis=-1).reshape(-1, 1, 2)
    corners = 2 * cells + np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    seen = scope.project(corners.reshape(-1, 2) * side).reshape(corners.shape)
    return corners[((seen > 0.3) & (seen < [654.7, 489.7])).all(axis=(1, 2))].reshape(-1, 2)


@pytest.mark.parametrize("scope", [CIRCLE_1X, CIRCLE_4X], ids=["1X", "4X"])
def test_all_complete_circles_of_thesis_views_are_detected(scope):
    rng = np.random.default_rng(0)
    scope = replace(scope, tx=scope.tx + rng.uniform(-20, 20), ty=scope.ty + rng.uniform(-20, 20))
    image = render_circles(scope, imaging=ImagingConditions(noise=2.0), rng=rng)
    found = detect_circles(image)
    assert np.abs(errors(scope, found, 280.0)).max() < 0.05  # wrong points are off by pixels
    grid = np.round(scope.back_project(found.points) / 280.0)
    inner, outer = (set(map(tuple, whole_circles(scope, margin))) for margin in (0.3, -0.3))
    assert inner <= set(map(tuple, grid)) <= outer < set(map(tuple, whole_circles(scope, -30)))


@pytest.mark.parametrize(("scope", "side"), [(SQUARE_1X, 200.0), (SQUARE_4X, 50.0)])
def test_all_complete_squares_of_thesis_views_are_detected(scope, side):
    rng = np.random.default_rng(3)
    image = render_squares(scope, side=side, imaging=ImagingConditions(noise=2.0), rng=rng)
    found = detect_squares(image)
    assert np.abs(errors(scope, found, side)).max() < 0.05
    grid = np.round(scope.back_project(found.points) / side)
    assert set(map(tuple, whole_squares(scope, side))) <= set(map(tuple, grid))
    shapes, counts = np.unique(found.group, return_counts=True)
    assert len(shapes) == len(found.points) / 4
    assert (counts == 4).all()


@pytest.mark.parametrize(
    ("blur", "noise", "circle_limit", "square_limit"),
    [(0.7, 2, 0.010, 0.025), (1.5, 8, 0.034, 0.052), (3.0, 2, 0.016, 0.033)],
)
def test_localization_error_is_below_limits_and_equals_sigma(
    blur, noise, circle_limit, square_limit
):
    """RMS per coordinate at 30 px pitch, contrast 140; limits are those OpenCV's detectors are held
    to."""
    rng = np.random.default_rng(4)
    scope = Microscope(2e5, 1e5, 5e4, alpha=0.15, tx=-700, ty=-620, image_size=(460, 420))
    imaging = ImagingConditions(blur=blur, noise=noise, dark=55.0, bright=195.0)
    image = render_circles(
        scope, radius=PITCH / 4, pitch=PITCH, counts=(11, 9), imaging=imaging, rng=rng
    )
    circles = detect_circles(image)
    image = render_squares(scope, side=PITCH, counts=(6, 5), imaging=imaging, rng=rng)
    squares = detect_squares(image)
    for found, limit, count in ((circles, circle_limit, 99), (squares, square_limit, 120)):
        assert len(found.points) == count
        rms = np.sqrt((errors(scope, found, PITCH) ** 2).mean())
        assert rms <= limit
        # 99 independent centers give the ratio to ±5 %, corners of shared lines less; and the
        # model's Gaussian stands for a box and a Gaussian.
        assert rms / np.sqrt((found.sigma**2).mean()) == pytest.approx(1.0, abs=0.25)


def test_table_of_detection_has_its_columns_in_order():
    found = detect_circles(render_circles(SMALL, counts=(6, 4)))
    table = found.to_frame()
    for pair in ("grid", "positions", "points"):
        columns = [f"{pair}_{name}" for name in ("ij" if pair == "grid" else "xy")]
        np.testing.assert_array_equal(table[columns], getattr(found, pair))


def test_bias_of_circles_under_perspective_is_removed():
    scope = Microscope(4000, 2000, 1000, 0.0, 0.1, 0.35, 0.0, -700, -500, image_size=(656, 491))
    image = render_circles(scope, radius=60, pitch=200, counts=(8, 6))
    found = detect_circles(image)
    turn = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    rim = np.column_stack([np.cos(turn), np.sin(turn)])
    grid = np.round(scope.back_project(found.points) / 200)
    ellipses = [
        cv2.fitEllipse((scope.project(200 * g + 60 * rim)).astype(np.float32)) for g in grid
    ]
    bias = np.array([e[0] for e in ellipses]) - scope.project(200 * grid)
    assert np.abs(bias).max() > 0.05  # what would be left if nobody cared
    # Model error only (no noise): 3 % of the bias.
    assert np.abs(errors(scope, found, 200.0)).max() < 0.003


def test_noise_free_squares_have_no_bias():
    image = render_squares(SQUARE_1X, side=200.0)
    found = detect_squares(image)
    # A Gaussian edge stands for a box and a Gaussian; corners of bent sides.
    assert np.abs(errors(SQUARE_1X, found, 200.0)).max() < 0.002


def test_bias_of_corners_under_distortion_is_removed():
    """Lines through the sides of a strongly distorted square cross beside its corners."""
    scope = Microscope(2e5, 1e5, 5e4, 8e-9, 0.1, tx=-1000, ty=-800, image_size=(420, 340))
    found = detect_squares(render_squares(scope, side=300.0))
    assert len(found.points) >= 16
    # The crossings lie up to 0.08 px off the corners here, at ten times the thesis' distortion. The
    # correction takes the sides as evenly weighted and leaves a fifth of that.
    assert np.abs(errors(scope, found, 300.0)).max() < 0.02


def test_dirt_is_not_detected_as_a_circle():
    rng = np.random.default_rng(7)
    image = render_circles(CIRCLE_1X, imaging=ImagingConditions(noise=2.0), rng=rng)
    clean = detect_circles(image)
    dirty = image.copy()
    cv2.circle(dirty, (300, 245), 9, 60.0, -1)  # between the circles
    first = clean.points[len(clean.points) // 2]
    cv2.rectangle(
        dirty, np.int_(np.add(first, [2, 2])), np.int_(np.add(first, [16, 14])), 50.0, -1
    )  # on one
    found = detect_circles(dirty)
    assert np.abs(errors(CIRCLE_1X, found, 280.0)).max() < 0.05
    assert len(found.points) >= len(clean.points) - 3
    assert np.hypot(*(found.points - first).T).min() > 10


@pytest.mark.parametrize(
    "detect", [detect_circles, detect_squares, detect_micrometer, detect_pattern]
)
@pytest.mark.parametrize(
    "image",
    [
        np.full((100, 120), 255.0),
        np.zeros((100, 120)),
        np.zeros((50, 50, 3)),
        np.random.default_rng(8).normal(128, 10, (200, 200)),
        np.add.outer(np.arange(100.0), np.arange(120.0)),
        np.tile([0, 255], (40, 40)),
        np.eye(60) * 255,
    ],
    ids=["saturated", "black", "color", "noise", "ramp", "columns", "one line"],
)
def test_images_without_a_pattern_are_rejected(detect, image):
    with pytest.raises(ValueError, match="image"):
        detect(image)
