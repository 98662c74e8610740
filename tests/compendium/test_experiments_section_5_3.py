"""Section 5.3: the gripper is followed to where it was put, and speed ends tracking."""

import numpy as np
import pytest

from compendium.experiments import section_5_3
from microlib.tracking import ESMTracker


def test_gripper_is_tracked_to_its_true_position():
    for zoom in section_5_3.WINDOWS:
        rng = np.random.default_rng(0)
        frame, tracker = section_5_3.gripper(zoom, (-15.0, 10.0), rng)
        first, then = (tracker.track(frame(place, rng)) for place in ((-15.0, 10.0), (2.5, -3.2)))
        assert not then.lost
        # Both frames have noise; a tenth of a pixel is ten times what tracking errs by.
        assert then.center - first.center == pytest.approx([17.5, -13.2], abs=0.1)
        side = np.linalg.norm(first.corners[1] - first.corners[0])
        assert side == pytest.approx(section_5_3.WINDOWS[zoom], abs=1.5)


def test_tracking_fails_at_high_speed():
    # At 4000 px/s 121 px from frame to frame, more than two windows.
    assert section_5_3.speed_study(2, [250.0, 4000.0], runs=2).tolist() == [2, 0]


def test_esm_alone_converges_farther_on_coarser_texture():
    """Both textures within 3 px, the coarser one only at 12 px, and neither beyond its square."""
    found = section_5_3.esm_study(3, [3.0, 12.0, 40.0], [1.0, 5.0], trials=6)
    assert found.loc[3.0].tolist() == [6, 6]
    assert found.loc[12.0, 1.0] == 0
    assert found.loc[12.0, 5.0] >= 5
    assert found.loc[40.0].tolist() == [0, 0]


def test_texture_sequence_moves_by_fractions_of_a_pixel():
    """By the tracker, which shares nothing with the renderer and errs by a hundredth of a pixel."""
    path = [[9.2, 8.7], [9.5, 8.5]]
    one, other = section_5_3.texture_sequence(path, np.random.default_rng(0), size=40, noise=0.0)
    tracker = ESMTracker(one, (12, 12, 34, 34), "translation")
    moved = tracker.track(other).center - tracker.track(one).center
    np.testing.assert_allclose(moved, [0.3, -0.2], atol=0.03)
