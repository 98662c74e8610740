"""Long sequences: one row per frame, and a tracker that was stored goes on where it stopped."""

from __future__ import annotations

import pickle

import numpy as np
import pandas as pd
import pytest

from microlib.synthetic import gripper_scene
from microlib.tracking import ESMTracker, KalmanFilter


@pytest.mark.parametrize("motion", ["translation", "homography"])
def test_pickled_tracker_continues_as_the_original(motion: str) -> None:
    """With its filter, what it knows of the light and the noise, and the place it looks next."""
    rng = np.random.default_rng(3)
    scene = gripper_scene(rng, pixel_size=6.23)
    frames = [scene.frame((1.5 * k, 0.7 * k), rng, gain=1 + 0.01 * k) for k in range(10)]
    frames[6] = rng.integers(0, 255, frames[6].shape).astype(np.uint8)  # lost, and found again
    box = scene.box(50)
    kalman = KalmanFilter(
        (box[0] + 24.5, box[1] + 24.5), interval=0.03, acceleration=50.0, noise=0.1
    )
    tracker = ESMTracker(frames[0], box, motion, kalman=kalman)
    whole, parted = [], pickle.loads(pickle.dumps(tracker))
    for frame in frames[1:]:
        whole.append(tracker.track(frame).to_dict())
    rows = []
    for frame in frames[1:]:
        rows.append(parted.track(frame).to_dict())
        parted = pickle.loads(pickle.dumps(parted))
    assert rows == whole
    table = pd.DataFrame(rows)
    assert table["lost"].sum() == 1
    assert table["lost"][5]
