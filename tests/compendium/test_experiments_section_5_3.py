"""Section 5.3: the gripper is followed to where it was put, and speed ends tracking."""

from __future__ import annotations

import numpy as np
import pytest

from compendium.experiments import section_5_3


def test_the_gripper_is_found_where_it_was_put() -> None:
    for zoom in section_5_3.WINDOWS:
        rng = np.random.default_rng(0)
        frame, tracker = section_5_3.gripper(zoom, (-15.0, 10.0), rng)
        first, then = (tracker.track(frame(place, rng)) for place in ((-15.0, 10.0), (2.5, -3.2)))
        assert not then.lost
        # Both frames have noise; a tenth of a pixel is ten times what tracking errs by.
        assert then.center - first.center == pytest.approx([17.5, -13.2], abs=0.1)
        side = np.linalg.norm(first.corners[1] - first.corners[0])
        assert side == pytest.approx(section_5_3.WINDOWS[zoom], abs=1.5)


def test_speed_ends_tracking() -> None:
    found = section_5_3.speed_study(2, [250.0, 4000.0], runs=2)
    assert found.loc[250.0].to_list() == [1.0, 1.0]
    # 121 px from frame to frame, more than two windows.
    assert found.loc[4000.0].to_list() == [0.0, 0.0]
    assert found.index.name == "speed (px/s)"
