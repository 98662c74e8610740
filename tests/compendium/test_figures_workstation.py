"""Tracks, detectors and settling times: every column is drawn against the right index."""

from itertools import pairwise
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium.figures import workstation


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def drawn(axes):
    return {line.get_label(): line.get_xydata() for line in axes.lines}


def test_errors_are_drawn_against_the_blur():
    errors = pd.DataFrame(
        {"circles": [0.01, 0.02], "squares": [0.1, 0.2], "other": [1.0, 2.0]}, [0.5, 3.0]
    )
    axes = workstation.draw_blur_study(errors).axes[0]
    np.testing.assert_allclose(drawn(axes)["squares"], [[0.5, 0.1], [3, 0.2]])
    np.testing.assert_allclose(drawn(axes)["other"], [[0.5, 1], [3, 2]])
    assert axes.get_yscale() == "log"
    assert axes.get_xlim()[0] == 0
    assert axes.get_xlim()[1] > 3
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("PSF σ (px)", "RMS error (px)")


def test_completed_runs_are_drawn_in_percent():
    shares = pd.DataFrame({"with": [1.0, 0.5], "without": [0.9, 0.0]}, [200.0, 1500.0])
    axes = workstation.draw_speed_study(shares).axes[0]
    np.testing.assert_allclose(drawn(axes)["with"], [[200, 100], [1500, 50]])
    np.testing.assert_allclose(drawn(axes)["without"], [[200, 90], [1500, 0]])
    assert axes.lines[-1].get_xdata() == [250, 250]  # §5.3: up to 250 px/s
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("speed (px/s)", "runs completed (%)")
    assert axes.get_ylim() == (-5, 105)


def test_every_pattern_has_its_points_and_their_number():
    names = ("circle-1X", "circle-4X", "square-1X", "square-4X")
    grid = np.stack(np.meshgrid([0, 1, 4, 6], [0, 4, 6]), axis=-1).reshape(-1, 2)
    examples = {
        name: SimpleNamespace(
            image=np.zeros((90, 90)),
            found=SimpleNamespace(points=10.0 * grid[k:] + k, grid=grid[k:]),
        )
        for k, name in enumerate(names)
    }
    panels = workstation.draw_patterns(examples).axes
    for k, (axes, name) in enumerate(zip(panels, names, strict=True)):
        np.testing.assert_allclose(axes.lines[0].get_xydata(), 10.0 * grid[k:] + k)
        assert axes.get_title().endswith(f": {12 - k} points")
        every = {"circle-1X": 4, "circle-4X": 1}.get(name, 6)
        labeled = (grid[k:] % every == 0).all(axis=1).sum()
        assert len(axes.texts) == labeled


def test_every_frame_has_its_window():
    corners = np.array([[40.0, 20.0], [60.0, 20.0], [60.0, 42.0], [40.0, 42.0]])
    shown = [
        (f"t = {k}", np.zeros((90, 160), np.uint8), SimpleNamespace(corners=c, center=c.mean(0)))
        for k, c in enumerate((corners, corners + np.array([7, 3])))
    ]
    first, second = workstation.draw_tracks(shown).axes
    np.testing.assert_allclose(first.lines[0].get_xydata(), [[50, 31]])
    np.testing.assert_allclose(second.patches[0].get_xy()[0], [47, 23])
    assert second.get_xlim() == (57 - 60, 57 + 60)
    assert (first.get_ylabel(), second.get_ylabel()) == ("y (px)", "")
    assert (first.get_title(), second.get_title()) == ("t = 0", "t = 1")


def test_the_parts_of_the_workstation_carry_their_names():
    axes = workstation.draw_workstation().axes[0]
    boxes = [patch.get_bbox() for patch in axes.patches]
    texts = {text.get_text(): text.get_position() for text in axes.texts}
    named = [name for name in texts if name not in ("probe", "gripper")]
    assert len(boxes) == 8
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    assert all(left < b.x0 and b.x1 < right and low < b.y0 and b.y1 < high for b in boxes)
    assert len(named) == 7  # both manipulators have one name
    for x, y in (texts[name] for name in named):
        middle = [((b.x0 + b.x1) / 2, (b.y0 + b.y1) / 2) for b in boxes]
        assert min(np.hypot(x - u, y - v) for u, v in middle) < 1e-9
    # The camera looks down through zoom and objective at the sample on its stage.
    column = ["camera\nBasler A602fc", "zoom\n0.75–11.25", "objective\n1.6X"]
    heights = [texts[name][1] for name in (*column, "sample stage, x and y")]
    assert heights == sorted(heights, reverse=True)
    np.testing.assert_allclose([texts[name][0] for name in column], 4.6)
    # Probe and gripper reach from their manipulators to the sample, as mirror images.
    *_, probe, gripper, sample = (line.get_xydata() for line in axes.lines)
    np.testing.assert_allclose(probe + gripper, [[9.2, 4.0], [9.2, 3.5]])
    assert boxes[4].x1 == probe[0, 0]
    assert boxes[5].x0 == gripper[0, 0]
    assert np.hypot(*(probe[1] - sample[0])) < 0.6
    for one, other in pairwise(boxes):
        assert not one.overlaps(other)


def test_dots_are_over_the_printed_number():
    (axes,) = workstation.draw_printed_and_recomputed(
        {
            "Table 5.3": pd.DataFrame(
                {
                    "claim": ["table-5.3/1X/settling-time", "table-5.3/1X/accuracy"],
                    "value": [0.8, 4.93],
                    "low": [0.4, 4.93],
                    "high": [1.6, 9.86],
                    "input": [True, False],
                }
            )
        }
    ).axes
    np.testing.assert_allclose(drawn(axes)["input"], [[1, 0]])
    np.testing.assert_allclose(drawn(axes)["computed"], [[0.5, -1]])
    ends = [lines.get_segments()[0] for lines in axes.collections]
    np.testing.assert_allclose(ends, [[[0.5, 0], [2, 0]], [[0.5, -1], [1, -1]]])
    assert [label.get_text() for label in axes.get_yticklabels()] == [
        "1X settling-time",
        "1X accuracy",
    ]
