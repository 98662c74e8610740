"""Chapter 3: labels follow from what a type's name says; windows, curvature and depth are right."""

from __future__ import annotations

import numpy as np
import pytest

from compendium.experiments import chapter_3


def test_depth_errors_are_in_frame_spacings():
    truth = np.full((40, 40), 30.0)
    frames, positions = np.zeros((9, 40, 40)), 10.0 * np.arange(9)
    rng = np.random.default_rng(0)
    texture = rng.uniform(0, 255, (40, 40))
    for k, position in enumerate(positions):  # sharpest at 30 µm
        frames[k] = 128 + (texture - 128) * np.exp(-(((position - 30) / 20) ** 2))
    _, table = chapter_3.depths(frames, positions, truth + 5.0, {"sml": {"measure": "sml"}})
    assert table.loc["sml", "RMS error (frame spacings)"] == pytest.approx(0.5, abs=0.01)
    assert table.loc["sml", "beyond one spacing (%)"] == 0
