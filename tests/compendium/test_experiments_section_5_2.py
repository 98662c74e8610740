"""Section 5.2: the chain from pixels to microscope gives back the microscope that rendered them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from compendium import thesis
from compendium.experiments import section_5_2


def test_prediction_interval_covers_next_draw():
    rng = np.random.default_rng(0)
    inside = []
    for _ in range(2000):
        *seen, after = rng.normal(5.0, 2.0, 6)
        mean, low, high = section_5_2.over_draws(seen, len(seen))
        assert mean == pytest.approx(np.mean(seen))
        inside.append(low <= after <= high)
    assert np.mean(inside) == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 2000))


def test_pattern_errors_are_those_of_the_logarithms():
    """So no interval reaches below zero: it ends as far below as above, in factors."""
    errors = (SimpleNamespace(mean=v, std=v, max=v) for v in (1.0, 2.0, 8.0))
    fits = [SimpleNamespace(plane_error=error) for error in errors]
    found = section_5_2.pattern_errors({"square-4X": SimpleNamespace(with_f=fits, images=3)})
    np.testing.assert_allclose(found["value"], 16 ** (1 / 3))
    np.testing.assert_allclose(found["low"] * found["high"], found["value"] ** 2)


def test_printed_pose_affects_only_point_labels():
    """Another pose by far more than the fit's error, but with the same nearest labels."""
    for column in ("circle-4X", "square-1X"):
        found = section_5_2.render(column, np.random.default_rng(6))[1]
        truth = thesis.microscope(column)
        aside = 0.3 * thesis.pattern_pitch(column)
        turned = {"alpha": truth.alpha + 0.5, "beta": -truth.beta}
        other = replace(truth, **turned, tx=truth.tx + aside, ty=truth.ty - aside)
        labels = section_5_2.printed_labels(column, found, truth)
        np.testing.assert_array_equal(labels, section_5_2.printed_labels(column, found, other))
        np.testing.assert_allclose(truth.project(labels), found.points, atol=0.2)


def test_squares_over_circles_uses_zoom_with_smaller_ratio():
    means = {"circle-1X": 2.0, "square-1X": 3.0, "circle-4X": 1.0, "square-4X": 4.0}
    assert section_5_2.squares_over_circles(means) == 1.5
    assert section_5_2.squares_over_circles(means | {"square-4X": 0.5}) == 0.5
