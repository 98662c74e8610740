"""The numbers that describe a part, where they have a known truth."""

from __future__ import annotations

import numpy as np
import pytest

from microlib.curvature._descriptor import NARROW, WIDE, Bends, bends, describe
from microlib.curvature._graph import region_graph
from microlib.curvature._grid import on_grid, white_noise
from microlib.curvature._recognition import probabilities, standardized


def test_bends_of_a_known_surface() -> None:
    """On z = a x²/2 + b y²/2 at its vertex κ are a and b, and the greater lies along its axis."""
    y, x = np.mgrid[-25:26, -20:21].astype(float)
    for a, b, direction in ((0.004, 0.001, 0.0), (0.001, 0.004, np.pi / 2)):
        found = bends(3.0 * (a * x**2 + b * y**2) / 2, 3.0, 0.5, 7)
        assert found.mean.shape == (51 - 12, 41 - 12)
        middle = (19, 14)
        assert found.mean[middle] == pytest.approx((a + b) / 6)
        assert found.deviator[middle] == pytest.approx(0.003 / 6)
        assert abs(found.direction[middle]) == pytest.approx(direction)
        assert found.curvedness[middle] == pytest.approx(np.hypot(a, b) / 3 / np.sqrt(2))
        assert found.strongest == pytest.approx(np.percentile(found.curvedness, 95))
    turned = bends(0.002 * (x + y) ** 2 / 2, 1.0, 0.0, 7)
    assert turned.direction[middle] == pytest.approx(np.pi / 4)
    assert (NARROW, WIDE) == (7, 11)


def test_a_bend_counts_from_the_greater_of_two_limits() -> None:
    field = np.zeros((2, 2))
    assert Bends(field, field, field, error=2.0, strongest=4.0).limit == 7.0
    assert Bends(field, field, field, error=0.1, strongest=4.0).limit == 1.0


def test_features_of_forms_that_are_known() -> None:
    """A ball's cap: all convex elliptic, of one curvature, round, without a direction."""
    y, x = np.mgrid[-32:33, -32:33].astype(float)
    found = describe(-(x**2 + y**2) / 400, 1.0, 1e-5).features
    assert found["label 1"] == 1
    assert found["convex regions"] == pytest.approx(np.log(2))
    assert found["convex largest"] == found["main area"] == found["main solidity"] == 1
    assert found["main border"] == 1
    assert found["main holes"] == found["main flat inside"] == 0
    assert found["main elongation"] == pytest.approx(0, abs=1e-9)
    assert found["main K/H²"] == pytest.approx(1, abs=0.05)
    assert found["wide bent"] == found["narrow bent"] == 1
    assert found["wide index 0"] > 0.85  # κ₁ = κ₂ < 0, but for the slopes towards the rim
    assert found["balance"] == pytest.approx(-1, abs=0.01)
    assert found["convex weight"] == pytest.approx(1)
    assert found["concave weight"] == 0
    for m in (1, 2, 3, 5, 6):  # the square map has the fourth
        assert found[f"convex ray {m}"] == pytest.approx(0, abs=1e-6)
    rod = describe(-(x**2) / 100, 1.0, 1e-5).features
    assert rod["label 2"] == 1
    assert rod["main K/H²"] == pytest.approx(0, abs=1e-6)
    assert rod["main aligned"] == pytest.approx(1 / np.sqrt(2))
    assert rod["convex aligned 2"] == pytest.approx(1 / np.sqrt(2), abs=1e-3)
    assert rod["wide index 2"] + rod["wide index 1"] > 0.99  # −1/2 lies between the two


def test_the_graph_goes_by_families_and_takes_the_smaller_number_first() -> None:
    labels = np.array([[2, 1, 0, 9], [3, 6, 6, 8], [5, 4, 0, 7]], np.uint8)
    graph = region_graph(labels)
    assert graph.family.tolist() == [1, 3, 2, 0]  # convex, concave, saddle, flat
    assert graph.area.tolist() == [3, 3, 2, 2]
    assert graph.regions.tolist() == [[1, 1, 0, 2], [1, 3, 3, 2], [4, 4, 0, 2]]
    assert graph.edges.tolist() == [[1, 3, 2], [1, 4, 1], [2, 3, 1], [3, 4, 1]]


def test_a_map_comes_to_the_grid_with_its_noise() -> None:
    rng = np.random.default_rng(5)
    z = rng.standard_normal((48, 96))
    same = on_grid(z, 3.0, 0.5)
    assert (same.pixel_size, same.noise) == (3.0, 0.5)
    np.testing.assert_array_equal(same.height, z)
    assert on_grid(z, 3.0, 0.0).noise == pytest.approx(1e-5 * 96 * 3.0)
    ramp = np.add.outer(np.arange(96.0), 2 * np.arange(192.0))
    half = on_grid(ramp, 3.0, 0.5)
    np.testing.assert_allclose(half.height, (ramp[::2, ::2] + ramp[1::2, 1::2]) / 2)
    assert (half.pixel_size, half.noise) == (6.0, 0.25)
    holes = z.copy()
    holes[10:12, 40], holes[5, :2] = np.nan, np.nan
    filled = on_grid(holes, 1.0, 0.1).height
    assert filled[10, 40] in (z[9, 40], z[10, 39], z[10, 41])
    assert filled[5, 0] in (z[4, 0], z[6, 0])
    assert filled[5, 1] in (z[4, 1], z[6, 1], z[5, 2])
    known = ~np.isnan(holes)
    np.testing.assert_array_equal(filled[known], z[known])
    # Planes and cylinders along the axes leave nothing of the mask.
    y, x = np.mgrid[:40, :50].astype(float)
    assert white_noise(0.3 * x - y + x**2 / 40) == pytest.approx(0, abs=1e-12)


def test_networks_are_averaged_and_features_cut_at_five() -> None:
    unit = np.array([1.0, -2.0])
    net = {"inner": np.eye(2), "inner_bias": np.array([0.0, 1.0]), "outer": np.eye(2),
           "outer_bias": np.array([0.5, 0.0])}  # fmt: skip
    other = {name: 0 * value for name, value in net.items()}
    score = np.exp([np.tanh(1.0) + 0.5, np.tanh(-1.0)])
    expected = (score / score.sum() + 0.5) / 2
    np.testing.assert_allclose(probabilities(unit, [net, other]), expected)
    middle, spread = np.array([1.0, 2.0, 3.0]), np.array([2.0, 0.1, 1.0])
    found = standardized(np.array([4.0, 9.0, -9.0]), middle, spread)
    np.testing.assert_allclose(found, [1.5, 5.0, -5.0])
