"""Rendering and detection of calibration targets, against exact integrals and projections."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.special import ndtr

from microlib.calibration import detect_circles, detect_squares
from microlib.microscope import Microscope
from microlib.synthetic import ImagingConditions, render_circles, render_squares
from tests.scenes.calibration import outline

SMALL = Microscope(2e5, 1e5, 5e4, tx=-700, ty=-560, pixel_pitch=9.9, image_size=(300, 240))
SENSOR = {"pixel_pitch": 9.9, "image_size": (656, 491)}
#: The four microscopes of Table 5.1: lengths, distortion, angles and shifts.
CIRCLE_1X, CIRCLE_4X, SQUARE_1X, SQUARE_4X = (
    Microscope(*parameters, **SENSOR)
    for parameters in (
        (200490, 126150, 78750, -8.4e-10, 1.5833, -0.0487, 3.0703, -781.4, -55.002),
        (200610, 31415, 4955.5, 1.5e-11, 1.5530, 0.0460, 0.0159, 76.755, -156.58),
        (199690, 122990, 75441, 2.1e-10, 1.5235, -0.0284, 3.1008, -1792.7, -1210.3),
        (200880, 31174, 4833.5, 1.5e-10, 1.6653, -0.0339, 3.1118, -1653.1, -1194.5),
    )
)


def box_edge(x, edge, blur):
    """Share of pixel `x` to the right of a straight edge with Gaussian blur: its mean over the
    pixel."""

    def integral(t):
        return t * ndtr(t) + np.exp(-t * t / 2) / np.sqrt(2 * np.pi)

    upper, lower = (x + 0.5 - edge) / blur, (x - 0.5 - edge) / blur
    return blur * (integral(upper) - integral(lower))


def errors(scope, found, pitch):
    """Image points minus true ones, px. The detected grid may have another origin, and its axes
    may be exchanged or reversed."""
    grid = np.round(scope.back_project(found.points) / pitch)
    indices = np.column_stack([found.grid, np.ones(len(grid))])
    change, residual, *_ = np.linalg.lstsq(indices, grid)
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
    # The renderer samples the Gaussian every third of a pixel and cuts it off at 4.2 standard
    # deviations, which changes grey levels by 2e-4 of the contrast of 150.
    np.testing.assert_allclose(image[row], 200 - 150 * covered, atol=0.03)


@given(turn=st.floats(0, 2 * np.pi), x=st.floats(-3, 3), y=st.floats(-3, 3))
@settings(deadline=None, max_examples=15)
def test_rendered_area_of_a_circle_is_exact(turn, x, y):
    """Without blur, the dark area is that of the circle on the sensor."""
    scope = Microscope(2e5, 1e5, 5e4, alpha=turn, tx=x, ty=y, pixel_pitch=9.9, image_size=(80, 80))
    sharp = ImagingConditions(blur=0.0)
    image = render_circles(scope, radius=80, counts=(1, 1), imaging=sharp)
    # Edges are straight within cells of a third of a pixel, a relative error of (1/3)²/(24 r²) with
    # r = 16 px; the rest is rounding to float32.
    area = ((200 - image) / 150).sum() * (9.9 / 2) ** 2
    assert area == pytest.approx(np.pi * 80**2, rel=4e-5)


# Detection


def whole_marks(scope, kind, size, pitch, margin):
    """True points, px, of the marks that lie at least `margin` px inside the image."""
    places = pitch * (np.argwhere(np.ones((81, 81))) - 40.0)[:, None]
    rim = outline(kind, size) + (size / 2 if kind == "square" else 0)
    seen = scope.project((places + rim).reshape(-1, 2)).reshape(-1, len(rim), 2)
    within = (seen > margin) & (seen < np.array(scope.image_size) - 1 - margin)
    points = places + (rim[::16] if kind == "square" else np.zeros((1, 2)))
    return scope.project(points[within.all(axis=(1, 2))].reshape(-1, 2))


@pytest.mark.parametrize(
    ("kind", "scope", "size", "pitch"),
    [
        ("circle", CIRCLE_1X, 70.0, 280.0),
        ("circle", CIRCLE_4X, 70.0, 280.0),
        ("square", SQUARE_1X, 200.0, 400.0),
        ("square", SQUARE_4X, 50.0, 100.0),
    ],
)
def test_all_complete_marks_of_thesis_views_are_detected(kind, scope, size, pitch):
    rng = np.random.default_rng(0)
    scope = replace(scope, tx=scope.tx + rng.uniform(-20, 20), ty=scope.ty + rng.uniform(-20, 20))
    noisy = {"imaging": ImagingConditions(noise=2.0), "rng": rng}
    if kind == "circle":
        found, corners = detect_circles(render_circles(scope, **noisy)), 1
    else:
        found, corners = detect_squares(render_squares(scope, side=size, **noisy)), 4
    assert np.abs(errors(scope, found, pitch if kind == "circle" else size)).max() < 0.05
    assert (np.unique(found.group, return_counts=True)[1] == corners).all()
    # A mark that ends within 0.3 px of the border may be detected or not.
    inner, outer = (whole_marks(scope, kind, size, pitch, margin) for margin in (0.3, -0.3))
    assert cKDTree(found.points).query(inner)[0].max() < 0.1
    assert cKDTree(outer).query(found.points)[0].max() < 0.1


def test_bias_of_circles_under_perspective_is_removed():
    """The centers of the ellipses are up to 0.1 px from the images of the circles' centers."""
    scope = Microscope(
        4000, 2000, 1000, 0.0, 0.1, 0.35, 0.0, -700, -500, pixel_pitch=9.9, image_size=(656, 491)
    )
    found = detect_circles(render_circles(scope, radius=60, pitch=200, counts=(8, 6)))
    # Model error only (no noise): 3 % of the bias.
    assert np.abs(errors(scope, found, 200.0)).max() < 0.003


@pytest.mark.parametrize(
    ("scope", "side", "most"),
    [
        # The model of an edge is a Gaussian without the integration over pixels; sides are bent.
        (SQUARE_1X, 200.0, 0.002),
        # At ten times the thesis' distortion, lines through the bent sides cross up to 0.08 px from
        # the corners. The correction assumes equal weights along a side and leaves a fifth of it.
        (
            Microscope(
                2e5, 1e5, 5e4, 8e-9, 0.1, tx=-1000, ty=-800, pixel_pitch=9.9, image_size=(420, 340)
            ),
            300.0,
            0.02,
        ),
    ],
    ids=["thesis", "strong distortion"],
)
def test_bias_of_corners_under_distortion_is_removed(scope, side, most):
    found = detect_squares(render_squares(scope, side=side))
    assert len(found.points) >= 16
    assert np.abs(errors(scope, found, side)).max() < most


def test_dirt_is_not_detected_as_a_circle():
    noisy = {"imaging": ImagingConditions(noise=2.0), "rng": 7}
    image = render_circles(CIRCLE_1X, **noisy)
    clean = detect_circles(image)
    first = clean.points[len(clean.points) // 2]
    cv2.circle(image, (300, 245), 9, 60.0, -1)  # between the circles
    cv2.rectangle(image, np.int_(first + 2), np.int_(first + 15), 50.0, -1)  # on a circle
    found = detect_circles(image)
    assert np.abs(errors(CIRCLE_1X, found, 280.0)).max() < 0.05
    assert len(found.points) >= len(clean.points) - 3
    assert np.hypot(*(found.points - first).T).min() > 10


def test_columns_of_a_detection_table_equal_its_arrays():
    found = detect_circles(render_circles(SMALL, counts=(6, 4)))
    table = found.to_frame()
    for pair in ("grid", "positions", "points"):
        columns = [f"{pair}_{name}" for name in ("ij" if pair == "grid" else "xy")]
        np.testing.assert_array_equal(table[columns], getattr(found, pair))
