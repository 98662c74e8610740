"""Section 5.5: rendered shapes come back from focus, and their types are what geometry says."""

from __future__ import annotations

import numpy as np
import pytest

from compendium import thesis
from compendium.experiments import section_5_5


@pytest.fixture(scope="module")
def ridge() -> section_5_5.Scene:
    return section_5_5.render_ridge(9)


@pytest.fixture(scope="module")
def ball() -> section_5_5.Scene:
    return section_5_5.render_ball(9)


def test_the_scenes_are_as_assumed(ridge, ball) -> None:
    assert ridge.frames.shape == (21, *section_5_5.RIDGE_SHAPE)
    # No pixel lies on the crest itself, between two columns: 500 (1 − (0.5/50)²).
    assert ridge.height.max() == pytest.approx(500 * (1 - (0.5 / 50) ** 2))
    assert (ridge.height > 0).sum(axis=1) == pytest.approx(section_5_5.RIDGE_WIDTH, abs=1)
    assert ball.frames.shape == (19, *section_5_5.BALL_SHAPE)
    # A camera sees the upper half; three standard deviations of roughness.
    top = ball.height.max() - 2 * section_5_5.BALL_RADIUS
    assert abs(top) < 4 * section_5_5.BALL_ROUGHNESS
    assert not np.array_equal(section_5_5.render_ball(10).frames, ball.frames)
    np.testing.assert_array_equal(section_5_5.render_ball(9).frames, ball.frames)


def test_the_thesis_chain_finds_the_ridge(ridge) -> None:
    depth, found = section_5_5.thesis_depth(ridge.frames, ridge.positions)
    inner = section_5_5.inside_ridge()
    error = (depth - ridge.height)[inner]
    assert np.sqrt(np.mean(error**2)) < thesis.RIDGE_STEP / 2
    table = section_5_5.ridge_errors(ridge, 9)
    assert table.loc["two levels of blur", "and corrected, averaged"] == pytest.approx(
        np.sqrt(np.mean(error**2))
    )
    raw = np.sqrt(np.nanmean((found.depth - ridge.height)[inner] ** 2))
    assert table.loc["two levels of blur", "SML, (3.13)"] == pytest.approx(raw)
    assert raw > np.sqrt(np.mean(error**2))
    # A lens tells more than the nearest frame, in every chain.
    assert (table.loc["blur by distance"] < table.loc["two levels of blur"]).all()
    assert table.loc["blur by distance"].max() < thesis.RIDGE_STEP / 2


def test_the_inside_of_the_ridge_is_on_it(ridge) -> None:
    inner = section_5_5.inside_ridge()
    assert (ridge.height[inner] > 0).all()
    assert not inner[:10].any()
    assert inner.sum() == 180 * 84


def test_the_steepest_step_is_the_parabolas_slope(ridge) -> None:
    # 500 (1 − (x/50)²) falls by 20 µm a pixel at its foot, between pixels by 19.8.
    assert section_5_5.steepest_step(ridge) == pytest.approx(19.8 / 25, rel=0.02)


def test_the_true_ridge_has_crest_flanks_and_feet(ridge) -> None:
    labels = section_5_5.thesis_labels(ridge.height)
    middle = labels[100]
    assert middle[100] == 2  # convex cylindric
    assert middle[70] == middle[130] == 5  # planar on the flank
    assert 8 in middle[45:55]  # concave cylindric at the foot
    assert middle[10] == 5
    # One profile all along the ridge.
    np.testing.assert_array_equal(labels[20:-20], np.tile(middle, (160, 1)))


def test_the_crest_passes_the_threshold_up_to_a_width() -> None:
    x = np.arange(200.0) - 99.5
    for printed_window, share in ((False, 1.0), (True, 0.5)):
        limit = section_5_5.widest_ridge(printed_window=printed_window)
        bend = 8 * thesis.RIDGE_HEIGHT / limit**2  # -z'' of 500 (1 − (2 x / width)²)
        z = thesis.RIDGE_HEIGHT * (1 - (2 * x / limit) ** 2)
        assert -np.diff(z, 2)[99] == pytest.approx(bend)
        assert share * bend / 2 == pytest.approx(thesis.H_THRESHOLD)


def test_the_shares_bear_out_the_sentences() -> None:
    table = section_5_5.sentence_shares(seed=20, runs=1)
    assert table.shape == (1, 8)
    shares = table.iloc[0]
    assert shares.between(0, 1).all()
    assert shares["sides-planar"] > 0.9
    assert shares["ball-background-planar"] > 0.7
    assert shares["crest-convex-cylindric"] > 0.8
    again = section_5_5.sentence_shares(seed=19, runs=2).iloc[1]
    assert again.to_dict() == shares.to_dict()


def test_distances_from_the_balls_middle() -> None:
    distance = section_5_5.from_ball_center()
    assert distance.shape == section_5_5.BALL_SHAPE
    radius = section_5_5.BALL_RADIUS / section_5_5.BALL_PIXEL  # px
    assert (distance < 1).sum() == pytest.approx(np.pi * radius**2, rel=0.01)
    np.testing.assert_allclose(distance, distance[::-1, ::-1])


def test_a_wide_window_sees_the_ball(ball) -> None:
    labels = section_5_5.ball_labels_by_window(ball, (7, 31))
    top = section_5_5.from_ball_center() < 0.5
    rough, smooth = (section_5_5.share_of(labels[size], top, (1,)) for size in (7, 31))
    assert smooth > 0.7  # convex elliptic, as a ball is
    assert rough < smooth - 0.2
