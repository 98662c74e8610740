"""More frames over the same travel: how many are averaged, and that they never hurt."""

import numpy as np
import pytest

from microlib import synthetic
from microlib.focus import depth_from_focus
from microlib.focus.multiscale._axis import find_axis, peak_width, sample_tiles
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


def test_peak_width_is_area_over_height():
    """The contrast of a checkerboard rises and falls as a triangle of known area over height."""
    y, x = np.indices((288, 288))
    board = np.where((x // 3 + y // 3) % 2 == 0, -1.0, 1.0)
    contrast = np.clip(1 - np.abs(np.arange(40.0) - 17) / 8, 0, 1)
    frames = [(128 + 50 * c * board).astype(np.float32) for c in contrast]
    # The area of a triangle of half width 8 over its height; its foot is on frames.
    assert peak_width(frames) == pytest.approx(8.0, rel=1e-5)
    assert peak_width([np.full((288, 288), 7, np.uint8)] * 5) == 1.0


@pytest.mark.parametrize("factor", [1, 5])
def test_groups_are_even_means_of_frames_and_positions(factor):
    _, positions, stack = tilted(factor)
    axis = find_axis([sample_tiles(frame) for frame in stack], positions, 3.7)
    sizes = np.diff(axis.ends)
    assert (axis.ends[0], axis.ends[-1]) == (0, len(stack))
    assert np.ptp(sizes) <= 1
    assert sizes.mean() == pytest.approx(factor, rel=0.5)
    for k, (a, b) in enumerate(zip(axis.ends[:-1], axis.ends[1:], strict=True)):
        seen = axis.frame(list(stack), k, np.s_[3:20, 5:])
        np.testing.assert_allclose(seen, stack[a:b, 3:20, 5:].mean(axis=0), rtol=1e-6)  # float32
        assert axis.means[k] == pytest.approx(positions[a:b].mean())


def test_steps_rise_for_falling_positions():
    axis = find_axis([np.full((48, 48), 7, np.uint8)] * 4, np.array([30.0, 20, 10, 0]), 3.7)
    np.testing.assert_allclose(axis.steps, [0, 1, 2, 3])
    found = axis.micrometers(np.array([-1.0, 0.25, 3.5], np.float32))
    np.testing.assert_allclose(found, [30.0, 27.5, 0.0])  # never outside of the stack


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
