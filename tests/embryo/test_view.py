"""Parts of an image, turned so that the probe comes from the top, and back again."""

from __future__ import annotations

import numpy as np
import pytest

from microlib.embryo._view import DIRECTIONS, View

IMAGE = np.arange(7.0 * 9).reshape(7, 9)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_part_goes_back_to_where_it_was_cut(direction: str) -> None:
    view = View((2, 1, 5, 4), direction)
    before = IMAGE.copy()
    part = view.of(IMAGE)
    changed = view.put_back(part + 100, IMAGE)
    np.testing.assert_array_equal(IMAGE, before)
    inside = np.zeros(IMAGE.shape, bool)
    inside[1:5, 2:7] = True
    np.testing.assert_array_equal(changed, IMAGE + 100 * inside)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_points_of_the_part_are_pixels_of_the_image(direction: str) -> None:
    view = View((2, 1, 5, 4), direction)
    part = view.of(IMAGE)
    rows, columns = np.indices(part.shape)
    points = view.to_image(np.column_stack([columns.ravel(), rows.ravel()]))
    x, y = points.astype(int).T
    np.testing.assert_array_equal(IMAGE[y, x], part.ravel())


def test_the_edge_that_is_named_is_the_upper_one_of_the_part() -> None:
    edges = {
        "top": IMAGE[0], "bottom": IMAGE[-1][::-1], "left": IMAGE[::-1, 0], "right": IMAGE[:, -1]
    }  # fmt: skip
    assert set(edges) == set(DIRECTIONS)
    for direction, edge in edges.items():
        np.testing.assert_array_equal(View((0, 0, 9, 7), direction).of(IMAGE)[0], edge)
