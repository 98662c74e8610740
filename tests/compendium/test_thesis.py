"""The thesis' apparatus and settings: as printed, and drawn within its rounding."""

import numpy as np

from compendium import thesis
from microlib import synthetic

SHAPE = (60, 80)


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
