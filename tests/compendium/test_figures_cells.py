"""The rendered cells: shapes of the two kinds, and that the outlines are what is drawn."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from compendium.figures.cells import PIXEL_SIZE, render_cells


def roundness(outline: np.ndarray) -> float:
    """4π area / perimeter²: 1 for a circle."""
    shape = outline.astype(np.float32)
    return float(4 * np.pi * cv2.contourArea(shape) / cv2.arcLength(shape, True) ** 2)


def test_cell_kinds_differ_in_size_and_roundness():
    _, kidney = render_cells("293T", np.random.default_rng(0))
    _, cancer = render_cells("Jurkat", np.random.default_rng(0))
    assert np.mean([roundness(o) for o in kidney]) < 0.93
    assert min(roundness(o) for o in cancer) > 0.97
    area = [
        np.pi * 5.5**2,
        np.mean([cv2.contourArea(o.astype(np.float32)) for o in cancer]),
    ]
    # Harmonics of 2 % change an area by well under 5 %.
    assert area[1] * PIXEL_SIZE**2 == pytest.approx(area[0], rel=0.05)
