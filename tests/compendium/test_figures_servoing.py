"""Runs, tracks and the loop are drawn with what is x on x and what is y on y."""

from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium.figures import servoing

RUN = SimpleNamespace(
    time=np.array([0.0, 0.1, 0.2]),
    reference=np.array([[5.0, 7.0], [15.0, 7.5], [25.0, 9.0]]),
    feature=np.array([[4.0, 6.0], [9.0, 6.5], [14.0, 6.7]]),
    measured=np.array([[4.1, 6.2], [9.2, 6.4], [14.3, 6.6]]),
    command=np.array([[100.0, -3.0], [50.0, -2.0], [20.0, -1.0]]),
)


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def drawn(axes):
    return {line.get_label(): line.get_xydata() for line in axes.lines}


def test_a_track_lies_on_its_frame():
    _, axes = plt.subplots()
    corners = np.array([[40.0, 20.0], [60.0, 22.0], [58.0, 42.0], [38.0, 40.0]])
    track = SimpleNamespace(corners=corners, center=corners.mean(axis=0))
    servoing.draw_track(axes, np.zeros((80, 120), np.uint8), track, "t = 1 s", margin=30)
    np.testing.assert_allclose(axes.patches[0].get_xy()[:4], corners)
    np.testing.assert_allclose(axes.lines[0].get_xydata(), [[49, 31]])
    assert axes.get_xlim() == (19, 79)
    assert axes.get_ylim() == (61, 1)  # y down
    assert axes.get_title() == "t = 1 s"
    _, axes = plt.subplots()
    servoing.draw_track(axes, np.zeros((80, 120), np.uint8), track, "")
    assert np.ptp(axes.get_xlim()) == 90  # px, two windows of 40 and a rim


def test_one_step_ends_where_its_tangent_meets_the_template():
    errors = pd.DataFrame({"template": [9.0, 1.0], "image": [9.0, 4.0], "mean": [9.0, 0.1]})
    left, right = servoing.draw_esm_step(errors).axes
    tangents = [line.get_xydata() for line in left.lines if len(line.get_xydata()) == 2]
    level = left.lines[1].get_ydata()[0]
    ends = [points[1] for points in tangents if points[0, 0] == 0 and points[0, 1] == 100]
    assert len(ends) == 3
    x, grey = left.lines[0].get_xydata().T
    truth = np.interp(level, grey[x < 5], x[x < 5])
    assert [end[1] for end in ends] == pytest.approx([level] * 3)
    by_template, by_image, by_mean = (end[0] for end in ends)
    assert by_image < truth < by_mean < by_template
    assert abs(by_mean - truth) < min(truth - by_image, by_template - truth)
    # The slope of the mean tangent is the mean of both.
    slopes = (level - 100) / np.array([by_template, by_image, by_mean])
    assert slopes[2] == pytest.approx(slopes[:2].mean())
    for name, points in drawn(right).items():
        np.testing.assert_allclose(points[:, 1], errors[name])
    assert right.get_yscale() == "log"
    with pytest.raises(ValueError, match="argument"):  # a fourth gradient has no line of its own
        servoing.draw_esm_step(errors.assign(other=1.0))


def test_the_bells_have_their_means_and_widths():
    track = pd.DataFrame(
        {
            "frame": [1, 2, 3],
            "true": [0.0, 2.0, 4.0],
            "measured": [0.5, 2.5, 4.5],
            "predicted": [0.0, 1.0, 3.0],
            "predicted_std": [30.0, 2.0, 1.5],
            "estimated": [0.5, 2.0, 4.0],
            "estimated_std": [1.0, 0.9, 0.8],
        }
    )
    left, right = servoing.draw_kalman_step(track, 1.0).axes
    np.testing.assert_allclose(drawn(left)["measured"], [[2, 2.5], [3, 4.5]])
    bells = drawn(right)
    for name, mean, std in (("predicted", 3, 1.5), ("measured", 4.5, 1), ("estimated", 4, 0.8)):
        x, density = bells[name].T
        step_of_x = x[1] - x[0]
        assert density.sum() * step_of_x == pytest.approx(1, abs=0.02)  # cut off at its tails
        assert x[density.argmax()] == pytest.approx(mean, abs=step_of_x)
        assert density.max() == pytest.approx(1 / (std * np.sqrt(2 * np.pi)), rel=1e-3)
