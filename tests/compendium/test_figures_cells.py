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


def test_cells_are_dark_where_their_outlines_are_and_do_not_overlap():
    image, outlines = render_cells("Jurkat", np.random.default_rng(2))
    masks = []
    for outline in outlines:
        mask = np.zeros(image.shape, dtype=np.uint8)
        cv2.fillPoly(mask, [np.rint(outline).astype(np.int32)], 1)
        masks.append(mask)
    together = np.sum(masks, axis=0)
    assert together.max() == 1
    core = cv2.erode(together.astype(np.uint8), np.ones((25, 25), np.uint8)) > 0
    rim = cv2.dilate(together.astype(np.uint8), np.ones((5, 5), np.uint8)) > together
    ground = np.median(image)
    assert image[core].mean() < ground - 20
    assert image[rim].mean() > ground + 20
    # The body's edge fades inwards from the halo's grey: a px inside it is as bright.
    inside = together - cv2.erode(together.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    assert image[inside].mean() > ground + 20
    # In the middle is the nucleus, 18 levels below the body, whose own light rises outwards by 23.
    y, x = np.indices(image.shape)
    depths = []
    for outline, mask in zip(outlines, masks, strict=True):
        far = np.hypot(x - outline[:, 0].mean(), y - outline[:, 1].mean()) / np.sqrt(mask.sum())
        beside = (far > 0.25) & (far < 0.35)
        depths.append(image[beside].mean() - image[far < 0.1].mean())
    assert np.mean(depths) > 23 + 18 / 2  # grain leaves 2 levels
