"""Rendered parts have their true geometry, and descriptions do not depend on the pose."""

import numpy as np
import pytest

from compendium.experiments import recognition
from compendium.experiments.recognition import PARTS, PIXEL, RADIUS, Pose

POSES = {"flat": Pose(), "tilted": Pose(turn=0.4, tilt=0.25, towards=1.1, scale=1.1, shift=(2, -1))}


@pytest.mark.parametrize("pose", POSES.values(), ids=POSES)
def test_rendered_ball_has_its_true_height_in_every_pose(pose):
    height, _ = recognition.surface(PARTS["solder ball"], pose)
    radius = RADIUS * pose.scale
    # The middle of the ball is one radius above the ground, along its normal.
    lean = np.array([np.cos(pose.towards), np.sin(pose.towards)])
    middle = radius * np.array([*(np.sin(pose.tilt) * lean), np.cos(pose.tilt)])
    y, x = np.indices(height.shape) - (recognition.SIDE - 1) / 2
    across, down = PIXEL * (x - pose.shift[0]), PIXEL * (y - pose.shift[1])
    away = (across - middle[0]) ** 2 + (down - middle[1]) ** 2
    on = away < (0.6 * radius) ** 2
    # The rays stop 0.05 / 2¹⁰ of the radius above the surface.
    wanted = middle[2] + np.sqrt(radius**2 - away[on])
    np.testing.assert_allclose(height[on], wanted, atol=0.01)


def test_a_description_does_not_depend_on_direction_and_unit_of_length():
    rng = np.random.default_rng(4)
    height = recognition.surface(PARTS["gripper jaw"], POSES["tilted"])[0]
    height = height + rng.normal(0, 1.0, height.shape)
    height[10:14, 60:63] = np.nan
    found = recognition.describe_part(height, 1.0, PIXEL)
    assert len(found) == sum(recognition.GROUPS.values())
    turned = [np.rot90(height), np.rot90(height, 2), height[::-1], height.T]
    for other, unit in (*((one, 1.0) for one in turned), (3 * height, 3.0)):
        again = recognition.describe_part(other, unit, unit * PIXEL)
        # Rounding may move a pixel across a threshold: 1 of 5000.
        np.testing.assert_allclose(again, found, atol=2e-3)


def test_shares_regions_borders_and_curvatures_are_those_of_a_drawn_map():
    labels = np.full((6, 9), 5, np.uint8)
    labels[:2, :3] = labels[2:4, 3:6] = 1  # two regions of 6 px, which touch at a corner
    labels[:, 8] = 0  # not known
    mean = np.where(labels == 1, -0.5, 0.0)
    mean[labels == 0] = np.nan
    ends = np.cumsum(list(recognition.GROUPS.values()))
    found = np.split(recognition.describe(labels, mean), ends[:-1])
    first, plane = (recognition.TYPES.index(kind) for kind in (1, 5))
    assert found[0][[first, plane]] == pytest.approx([12 / 48, 36 / 48])
    assert np.expm1(found[1][[first, plane]]) == pytest.approx([2, 1])
    assert found[2][recognition.PAIRS.index((1, 5))] == 1
    assert found[3][first] == pytest.approx(-0.5 * 12 / 48)
    assert found[0].sum() == found[2].sum() == 1


def test_share_and_its_interval_are_those_of_wilson():
    # (p + z²/2n ± z √(p(1 − p)/n + z²/4n²)) / (1 + z²/n) with p = 0.8, n = 10 and z = 1.96.
    found = recognition.wilson(np.arange(10) < 8)
    assert found == pytest.approx((80.0, 49.02, 94.33), abs=0.01)


def test_the_nearest_neighbor_is_named_and_a_stranger_is_not_sure():
    training = np.array([[0.0, 0.0], [0.4, 0.0], [0.9, 0.9], [0.9, 0.5]])
    names = np.array(["a", "a", "b", "b"])
    given = np.array([[0.05, 0.0], [0.9, 0.85], [0.9, 3.0], [0.66, 0.26]])
    found = recognition.recognize(given, training, names, [1, 1])
    assert found["name"].tolist()[:3] == ["a", "b", "b"]
    # The third is far from both names, the last as near to one name as to the other.
    assert found["sure"].tolist() == [True, True, False, False]
    assert found["distance"][3] < 0.4 / training.std(axis=0).max()
    # Each group is scaled by itself: a feature in other units changes nothing.
    units = np.array([1.0, 1000.0])
    scaled = recognition.recognize(given * units, training * units, names, [1, 1])
    np.testing.assert_allclose(scaled["distance"], found["distance"])
