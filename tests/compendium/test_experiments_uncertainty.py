"""The page on uncertainty: coverage of known errors, and the renderers' geometry."""

from __future__ import annotations

import numpy as np
import pytest

from compendium.experiments import uncertainty
from compendium.experiments.disc_blur import disc_blur


def test_coverage_of_normal_errors_is_the_level():
    error = np.random.default_rng(0).normal(0, 3.0, 40_000)
    found = uncertainty.coverage(error, np.full(error.shape, 3.0))
    np.testing.assert_allclose(found, found.index, atol=0.01)  # four binomial standard errors


def test_coverage_leaves_out_pixels_without_a_height():
    found = uncertainty.coverage(np.array([0.1, np.nan]), np.array([1.0, np.nan]))
    assert (found == 1).all()


@pytest.mark.parametrize("radius", [4.0, 7.3])
def test_disc_blur_keeps_the_sum_and_has_the_variance_of_a_disc(radius):
    point = np.zeros((41, 41), np.float32)
    point[20, 20] = 1.0
    blurred = disc_blur(point, radius)
    x = np.arange(41.0) - 20
    assert blurred.sum() == pytest.approx(1, abs=1e-5)
    # A uniform disc has the variance r²/4 along each axis, and a pixel adds 1/12.
    assert (blurred.sum(axis=0) * x**2).sum() == pytest.approx(radius**2 / 4 + 1 / 12, rel=0.01)


def test_slope_is_sharpest_where_its_height_is_that_of_the_frame():
    name, height, stack = next(uncertainty.focal_stacks(1))
    assert name == "slope"
    for k in (8, 12):
        contrast = np.abs(np.diff(stack[k].astype(float), axis=1)).mean(axis=0)
        assert abs(height[80, contrast.argmax()] - k) < 1.0
