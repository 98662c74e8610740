"""Halos of strong edges and bare ground: depths that only blurred light or noise gives."""

from collections.abc import Iterator

import numpy as np
import pytest
from skimage import data

from microlib import synthetic
from microlib.focus import depth_from_focus
from tests.scenes import tilted_plane
from tests.scenes.focus import stack_of

SHAPE = (168, 160)
POSITIONS = np.arange(15.0)


def lettering() -> np.ndarray:
    """Bright strokes on a dark ground that has no texture to speak of."""
    texture = np.full(SHAPE, 40.0)
    for left in range(10, 160, 36):
        texture[20:140, left : left + 6] = 230
        texture[60:66, left : left + 20] = 230
    return texture


def scenes() -> Iterator[tuple]:
    """Yield a surface, its texture and noise, where it is judged, and two shares of pixels there.

    They are the largest share without a depth, and of depths that are off by more than a frame;
    without the rule that a comment names, at least one of both is higher.
    """
    y, x = np.indices(SHAPE)
    plain = [synthetic.mixed_texture(SHAPE, seed) for seed in range(4)]
    everywhere, inner = np.s_[:, :], np.s_[10:-10, 10:-10]

    def scene(name, *values):
        return pytest.param(*values, id=name)

    # Both measures disagree on bare ground, which has the depth of the wide window, and no other.
    tilt = 7 + tilted_plane(SHAPE, 0.02, 0.015)
    yield scene("ground between strokes", tilt, lettering(), 2.0, everywhere, 0.004, 0.01)
    # Four frames higher than strokes that are brighter, up to 12 px inside it by the wide window.
    texture, height, patch = lettering(), np.full(SHAPE, 5.0), np.s_[76:116, 90:116]
    texture[patch], height[patch] = plain[3][patch], 9.0
    yield scene("patch above strokes", height, texture, 1.0, np.s_[88:101, 96:110], 0.1, 0.2)
    # Narrower than the windows of the coarse measure.
    height = np.where((x >= 76) & (x < 88), 9.0, 5.0)
    yield scene("narrow bar", height, plain[2], 1.0, np.s_[10:-10, 78:86], 0.01, 0.01)
    # At the border the wide window has its inner side only.
    height = 7 + tilted_plane(SHAPE, 0.08, 0.02)
    weak = synthetic.mixed_texture(SHAPE, 4, std=5)
    yield scene("slope at the border", height, weak, 2.0, np.s_[:, -12:], 0.01, 0.003)
    coins = data.coins()[: SHAPE[0], : SHAPE[1]].astype(float)
    dome = 5 + synthetic.paraboloid(SHAPE, 4.0)
    yield scene("coins on cloth", dome, coins, 2.0, inner, 0.05, 0.009)
    # The wide window takes the better lit side's depth up to 26 px beyond the edge.
    for axis, place in {"x": x, "y": y}.items():
        texture = np.where(place < 80, 128 + 0.2 * (plain[1] - 128), plain[1])
        step = np.where(place < 80, 3.2, 10.9)
        yield scene(f"step of other contrast along {axis}", step, texture, 1.0, inner, 0.09, 0.03)
    # The better textured side must not win beside it: the pixel's own light decides.
    distance = np.hypot(x - 77, y - 84)
    height = np.where(distance < 55, 6.0 + 5 * (1 - distance / 55), 3.0)
    yield scene("round rim", height, plain[0], 2.0, inner, 0.01, 0.017)  # one px of the rim


@pytest.mark.parametrize(
    ("height", "texture", "noise", "where", "unknown", "wrong"), list(scenes())
)
def test_few_depths_beside_edges_are_unknown_or_off_by_a_frame(
    height, texture, noise, where, unknown, wrong
):
    stack = stack_of(height, POSITIONS, texture=texture, noise=noise)
    error = (depth_from_focus(stack, POSITIONS).depth - height)[where]
    assert np.isnan(error).mean() < unknown
    assert np.mean(np.abs(error) > 1) < wrong
