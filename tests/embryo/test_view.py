"""Images turned so that the probe comes from the top."""

from __future__ import annotations

import numpy as np
import pytest

from microlib.embryo._view import View


@pytest.mark.parametrize("direction", ["top", "right", "bottom", "left"])
def test_points_of_tilted_image_map_back(direction):
    """A blob in the image, and the place where the turned part has it."""
    y, x = np.mgrid[:150, :210].astype(float)
    view = View((210, 150), direction).upright(0.3, np.array([[60.0, 4.0], [75.0, 4.0]]))
    place = np.array([92.0, 71.0])
    image = np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2 * 4.0**2)).astype(np.float32)
    part = view.rotate(image)
    assert part.shape == view.frame[:1:-1]
    rows, columns = np.indices(part.shape)
    found = np.array([(columns * part).sum(), (rows * part).sum()]) / part.sum()
    np.testing.assert_allclose(view.to_image(found[np.newaxis])[0], place, atol=0.02)
    # The turn is that of the slope: the bar's direction (0.3, 1) is upright in the part.
    before = View((210, 150), direction)
    ends = view.from_image(before.to_image(np.array([[60.0, 10.0], [63.0, 20.0]])))
    assert ends[0, 0] == pytest.approx(ends[1, 0])
    assert ends[1, 1] - ends[0, 1] == pytest.approx(np.hypot(3, 10))
    # It begins below both ends of the entry, and its columns hold all corners of the part.
    entry = view.from_image(before.to_image(np.array([[60.0, 4.0], [75.0, 4.0]])))
    assert -2 <= entry[:, 1].max() <= -1
    corners = np.array([[x, y] for x in (-0.5, 209.5) for y in (-0.5, 149.5)])
    turned = view.from_image(corners)
    assert turned[:, 0].min() > -1
    assert turned[:, 0].max() < view.frame[2] + 1
    assert turned[:, 1].max() == pytest.approx(view.frame[3], abs=1.0)
