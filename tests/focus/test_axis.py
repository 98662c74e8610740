"""More frames over the same travel: how many are averaged, and that they never hurt."""

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from microlib.focus import depth_from_focus
from tests.scenes import tilted_plane
from tests.scenes.focus import inner, rms, stack_of

SHAPE = (92, 100)
HEIGHT = 7.2 + tilted_plane(SHAPE, 5 / 96, 2 / 96)


def test_error_falls_with_the_number_of_frames():
    errors = []
    for factor in (1, 4, 12):
        positions = np.linspace(0, 14, 14 * factor + 1)
        found = depth_from_focus(stack_of(HEIGHT, positions, noise=3.0), positions)
        errors.append(rms(inner(found.depth - HEIGHT)))
    assert errors[1] < 0.85 * errors[0]
    # What is left is no noise, on an image this small; with constants in frames it was 0.06.
    assert errors[2] < 0.95 * errors[1]


@pytest.mark.parametrize("count", [11, 81])
@pytest.mark.parametrize("end", [0.02, 9.98])
def test_surface_in_focus_in_the_first_or_last_frame_has_depth(end, count):
    """As the background of section 3.1.2 is; the mean of the first three frames lies inside."""
    positions = np.linspace(0, 10, count)
    found = depth_from_focus(stack_of(np.full(SHAPE, end), positions, noise=1.0), positions)
    # Of 81 frames, the first three have their mean at 0.125 µm.
    assert np.mean(np.abs(found.depth - end) < 0.05) > 0.9
    assert found.at_end.mean() > 0.9


@pytest.mark.parametrize("kind", ["grey", "in color"])
def test_all_in_focus_and_index_are_of_the_frame_nearest_to_the_depth(kind):
    """A black frame is left out, and counted."""
    positions = np.linspace(0, 14, 57)
    stack = stack_of(HEIGHT, positions, noise=3.0)
    stack[25] = 0
    if kind == "in color":
        stack = np.rint(stack[..., None] * [1, 0.8, 0.6]).astype(np.uint8)
    for order in (1, -1):
        frames, z = stack[::order], positions[::order]
        with pytest.warns(UserWarning, match="left out"):
            found = depth_from_focus(frames, z)
        depth, index = found.depth, found.index
        least = np.abs(np.delete(positions, 25)[:, None, None] - depth).min(axis=0)
        np.testing.assert_allclose(np.abs(z[index] - depth), least, atol=1e-5)  # of float32
        shares = [(index == k).astype(float) for k in range(57)]
        for _ in range(2):
            shares = [uniform_filter(share, 5, mode="mirror") for share in shares]
        blended = np.einsum("kyx,kyx...->yx...", shares, frames)
        np.testing.assert_allclose(found.all_in_focus, blended, atol=0.51)  # rounded
        assert found.all_in_focus.dtype == frames.dtype
