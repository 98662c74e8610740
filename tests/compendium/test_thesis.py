"""The thesis' apparatus and settings: as printed, and drawn within its rounding."""

from __future__ import annotations

import numpy as np
import pytest

from compendium import thesis
from microlib import synthetic

SHAPE = (60, 80)


@pytest.mark.parametrize("column", thesis.COLUMNS)
def test_microscope_has_parameters_of_table_5_1(column):
    scope = thesis.microscope(column)
    # The print's own ratio, up to the gap that section 5.2 finds between its three lengths.
    assert scope.tube_length / scope.focal_length == pytest.approx(
        thesis.table_5_1(column, "M"), rel=1e-4
    )
    assert scope.magnification == pytest.approx(thesis.table_5_1(column, "M"), rel=4e-3)
    names = ("alpha", "beta", "gamma", "T_x", "T_y", "kappa", "d")
    angles = np.rad2deg([scope.alpha, scope.beta, scope.gamma])
    found = [*angles, scope.tx, scope.ty, scope.distortion, scope.distance]
    assert found == pytest.approx([thesis.table_5_1(column, name) for name in names])
    assert np.all(scope.cell == 9.9)


def test_thesis_stack_has_two_levels_of_blur():
    texture = synthetic.mixed_texture(SHAPE, np.random.default_rng(0))
    positions = 25.0 * np.arange(21)
    height = synthetic.parabolic_cylinder(SHAPE, 500.0)
    stack = thesis.thesis_stack(texture, height, positions)
    sharp = np.clip(np.rint(texture), 0, 255)
    focused = (stack == sharp[None]).sum(axis=0)
    assert np.median(focused) <= 2  # its own frame, and chance
    nearest = np.abs(height - positions[:, None, None]).argmin(axis=0)
    np.testing.assert_array_equal(np.take_along_axis(stack, nearest[None], 0)[0], sharp)
