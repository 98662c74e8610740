"""More frames over the same travel: how many are averaged, and that they never hurt."""

import numpy as np

from microlib import synthetic
from microlib.focus import depth_from_focus
from tests.scenes import tilted_plane

SHAPE = (96, 96)


def tilted(factor: int, *, noise: float = 3.0, seed: int = 0):
    """True depth, positions and a stack over twenty depths of field, with `factor` frames a step.

    Blur grows by 1 px for a step of 1 µm.
    """
    rng = np.random.default_rng(seed)
    positions = np.linspace(0, 14, 14 * factor + 1)
    height = 7.2 + tilted_plane(SHAPE, 5 / 96, 2 / 96)
    texture = synthetic.mixed_texture(SHAPE, rng)
    stack = synthetic.focal_stack(texture, height, positions, blur_rate=1.0, noise=noise, rng=rng)
    return height, positions, stack


def rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(error[8:-8, 8:-8] ** 2)))


def test_error_falls_with_the_number_of_frames():
    errors = []
    for factor in (1, 4, 12):
        height, positions, stack = tilted(factor)
        found = depth_from_focus(stack, positions)
        assert np.isnan(found.depth[8:-8, 8:-8]).mean() <= 0.01
        errors.append(rms(found.depth - height))
    assert errors[1] < 0.85 * errors[0]
    # What is left is no noise, on an image this small; with constants in frames it was 0.06.
    assert errors[2] < 0.95 * errors[1]


def test_surface_at_the_end_of_an_averaged_stack_is_measured():
    """The first mean lies half a group inside; a surface in focus in the first frame lies not."""
    positions = np.linspace(0, 10, 81)
    texture = synthetic.mixed_texture(SHAPE, np.random.default_rng(0))
    for end in (0.02, 9.98):
        height = np.full(SHAPE, end)
        stack = synthetic.focal_stack(
            texture, height, positions, blur_rate=1.0, noise=1.0, rng=np.random.default_rng(1)
        )
        found = depth_from_focus(stack, positions)
        # The first three frames have their mean 0.125 µm inside.
        assert np.abs(np.median(found.depth) - end) < 0.05
        assert found.at_end.mean() > 0.9


def test_all_in_focus_and_index_are_of_the_frame_nearest_to_the_depth():
    _, positions, stack = tilted(4)
    for order in (1, -1):
        found = depth_from_focus(stack[::order], positions[::order])
        away = np.abs(positions[::order][found.index] - found.depth)
        assert away.max() <= 0.125 + 1e-5  # half the spacing
        chosen = np.take_along_axis(stack[::order], found.index[None], axis=0)[0]
        np.testing.assert_array_equal(found.all_in_focus, chosen)
