"""The live depth's experiment: its microscope, its scenes, and what it counts."""

from __future__ import annotations

import numpy as np
import pytest

from compendium.experiments import live_depth
from compendium.experiments.live_depth import POSITIONS, SCENES, frames_of, saved


def test_scenes_lie_within_the_positions_and_differ() -> None:
    heights = {name: make() for name, make in SCENES.items()}
    assert len(heights) == 5
    greatest = {name: float(z.max()) for name, z in heights.items()}
    assert greatest == pytest.approx(
        {"cylinder": 150, "cone": 150, "step": 120, "fills the range": 390, "small part": 220},
        rel=0.02,
    )
    assert all(POSITIONS[0] < z.min() and z.max() < POSITIONS[-1] for z in heights.values())
    assert np.sum(heights["small part"] == greatest["small part"]) == 12**2
    first, again = (frames_of("step", 3)[20] for _ in range(2))
    assert (first == again).all()
    assert (frames_of("step", 4)[20] != first).any()
    flat = frames_of("step", 3).astype(float)
    # In focus at its height: neighbors differ most there.
    left = np.abs(np.diff(flat[:, :, :50], axis=2)).mean(axis=(1, 2))
    assert POSITIONS[left.argmax()] == 0.0


def test_what_is_saved_and_seen_is_counted(monkeypatch) -> None:
    monkeypatch.setattr(live_depth, "SHAPE", (40, 40))
    monkeypatch.setattr(live_depth, "SCENES", {"step": SCENES["step"]})
    table = saved(20)
    assert table["scene"].tolist() == ["step"] * 2
    assert table["way"].tolist() == ["farthest", "coarse"]
    assert table["seen"].all()
    # Of 44 positions those up to three or four beyond the step's 120 µm, at the nineteenth.
    assert (table["saved"].between(25, 60)).all()
    assert table["rms of all"].nunique() == 1
    assert (table["rms"] < 12).all()
