"""Bias of marks that the library's renderer draws without noise, and the table of a detection."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from microlib.calibration import detect_circles, detect_squares
from microlib.microscope import Microscope
from microlib.synthetic import render_circles, render_squares

SENSOR = {"pixel_pitch": 9.9, "image_size": (656, 491)}
TILTED = Microscope(4000, 2000, 1000, 0.0, 0.1, 0.35, 0.0, -700, -500, **SENSOR)
#: Of Table 5.1.
SQUARE_1X = Microscope(
    199690, 122990, 75441, 2.1e-10, 1.5235, -0.0284, 3.1008, -1792.7, -1210.3, **SENSOR
)
DISTORTED = Microscope(
    2e5, 1e5, 5e4, 8e-9, 0.1, tx=-1000, ty=-800, pixel_pitch=9.9, image_size=(420, 340)
)


@pytest.mark.parametrize(
    ("kind", "scope", "pitch", "most"),
    [
        # The centers of the ellipses are up to 0.1 px from the images of the circles' centers; 3 %
        # of this bias are left.
        ("circle", TILTED, 200.0, 0.003),
        # The model of an edge is a Gaussian without the integration over pixels; sides are bent.
        ("square", SQUARE_1X, 200.0, 0.002),
        # At ten times the thesis' distortion, lines through the bent sides cross up to 0.08 px from
        # the corners. The correction assumes equal weights along a side and leaves a fifth of it.
        ("square", DISTORTED, 300.0, 0.02),
    ],
    ids=["circles in perspective", "corners of the thesis", "corners under strong distortion"],
)
def test_bias_of_marks_by_perspective_and_distortion_is_removed(kind, scope, pitch, most):
    if kind == "circle":
        found = detect_circles(render_circles(scope, radius=60, pitch=pitch, counts=(8, 6)))
    else:
        found = detect_squares(render_squares(scope, side=pitch))
    truth = scope.project(pitch * (np.argwhere(np.ones((81, 81))) - 40.0))
    assert len(found.points) >= 16
    assert cKDTree(truth).query(found.points, p=np.inf)[0].max() < most
    table = found.to_frame()
    lone = np.column_stack([found.uncertainty, found.group])
    np.testing.assert_array_equal(table[["uncertainty", "group"]], lone)
    assert "in {}×{} px".format(*scope.image_size) in repr(found)
    assert (f"px, side {found.side:.4g} pitches" in repr(found)) == (kind == "square")
    sizes = np.median(found.uncertainty), found.normalized_rms
    assert "σ {:.2g} px, residuals {:.2g} σ".format(*sizes) in repr(found)
    for pair in ("grid", "positions", "points"):
        columns = [f"{pair}_{name}" for name in ("ij" if pair == "grid" else "xy")]
        np.testing.assert_array_equal(table[columns], getattr(found, pair))
