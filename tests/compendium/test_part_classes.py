"""Learning parts: what is drawn, and that the networks and reaches are what they are said to be."""

from __future__ import annotations

import numpy as np
import pytest

from compendium import part_classes, part_shapes
from microlib.curvature import PART_KINDS
from microlib.curvature._recognition import probabilities


@pytest.mark.parametrize("kind", [*part_shapes.KNOWN, *part_shapes.OTHERS])
def test_shapes_are_finite_and_the_same_for_a_seed(kind: str) -> None:
    first, again = (part_shapes.draw(kind, 64, np.random.default_rng(1)) for _ in range(2))
    np.testing.assert_array_equal(first.height, again.height)
    assert np.isfinite(first.height).all()
    assert first.bend > 0
    assert np.ptp(first.height) < 4


def test_known_parts_have_the_order_of_the_kinds() -> None:
    assert tuple(part_shapes.KNOWN) == PART_KINDS
    assert not {"pyramid", "torus", "egg box"} & set(part_shapes.OTHERS)


def test_the_middle_sizes_are_left_out() -> None:
    rng = np.random.default_rng(2)
    drawn = np.array([part_shapes._size(rng, 0.14, 0.42) for _ in range(300)])
    low, high = part_shapes.GAP
    assert not ((drawn > low) & (drawn < high)).any()
    assert (drawn < low).any()
    assert (drawn > high).any()


def test_a_network_tells_groups_apart_and_the_reach_holds_most_of_them() -> None:
    rng = np.random.default_rng(3)
    classes = np.repeat(np.arange(7), 40)
    unit = np.eye(7, 24)[classes] * 4 + 0.3 * rng.standard_normal((280, 24))
    net = part_classes.fit_network(unit, classes, 0)
    likely = probabilities(unit, [net])
    np.testing.assert_allclose(likely.sum(axis=1), 1)
    assert (likely.argmax(axis=1) == classes).all()
    found = part_classes.spreads(unit, classes)
    offsets = unit[classes == 2] @ found["axes"] - found["centers"][2]
    distance = np.linalg.norm(offsets @ found["whiteners"][2], axis=1)
    # 998 of 1000 lie within: of 40 all but the one that the quantile lies under.
    assert np.sum(distance > 1) == 1


def test_no_step_makes_a_fitted_network_better() -> None:
    """Its cost written once more: cross entropy, and half of DECAY times the squared weights."""
    rng = np.random.default_rng(5)
    classes = np.repeat(np.arange(7), 12)
    unit = np.eye(7, 9)[classes] * 2 + rng.standard_normal((84, 9))
    net = part_classes.fit_network(unit, classes, 1)

    def cost(one: dict[str, np.ndarray]) -> float:
        likely = probabilities(unit, [one])[np.arange(84), classes]
        weights = (one["inner"] ** 2).sum() + (one["outer"] ** 2).sum()
        return -np.log(likely).mean() + part_classes.DECAY * weights / 2

    for name in net:
        step = 1e-3 * rng.standard_normal(net[name].shape)
        there, back = (cost(net | {name: net[name] + sign * step}) for sign in (1, -1))
        # Over steps of the weights' own size the cost would change by less than a hundredth.
        assert abs(there - back) / 2e-3 < 0.01, name
        assert there + back > 2 * cost(net) - 1e-9, name


def test_examples_are_described_both_ways() -> None:
    features, classes, names = part_classes.examples((1, 0, 1, 0))
    assert features.shape == (12, len(names))
    assert classes.tolist() == [k for k in range(6) for _ in range(2)]
    assert np.isfinite(features).all()
