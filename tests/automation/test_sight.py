"""What one picture shows of a pipette and an egg, from an outline that is known exactly."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from microlib.automation import _sight
from microlib.automation._sight import TipTracker, see

CENTER, RADIUS, HEIGHT = np.array([52.0, 90.0]), 40.0, 120


@pytest.fixture
def asked(monkeypatch):
    """Let an outline be found that is a circle but where the pipette hides it; keep the calls."""
    calls: list[tuple] = []
    angle = np.linspace(0.2, np.pi - 0.2, 301)
    x, down = CENTER[0] + RADIUS * np.cos(angle), CENTER[1] - RADIUS * np.sin(angle)
    under = np.abs(x - CENTER[0]) < 6
    found = SimpleNamespace(
        x=x,
        y=HEIGHT - 1 - np.where(under, down - 15.0, down),
        under_probe=under,
        image_height=HEIGHT,
        probe=SimpleNamespace(slope=0.75, tip=(50.0, 35.0)),
        direction="left",
    )

    def extract(image, **options):
        calls.append((image, options))
        if image is None:
            raise ValueError("image must show one dark probe, got none")
        return found

    monkeypatch.setattr(_sight, "extract_boundary", extract)
    return calls


def test_a_picture_is_turned_into_places_with_y_down(asked):
    sight = see("picture", "auto", (1, 2, 3, 4))
    assert asked == [("picture", {"direction": "auto", "region": (1, 2, 3, 4), "dimple": False})]
    np.testing.assert_allclose(sight.tip, [50.0, 35.0])
    np.testing.assert_allclose(sight.along, [0.6, 0.8])
    # What the pipette hides is left out of the circle.
    np.testing.assert_allclose(sight.center, CENTER, rtol=1e-9)
    assert sight.radius == pytest.approx(RADIUS)
    assert sight.crown == pytest.approx(50.0)
    assert sight.direction == "left"
    assert np.abs(sight.outline[:, 0] - CENTER[0]).min() >= 6
    np.testing.assert_allclose(np.hypot(*(sight.outline - CENTER).T), RADIUS)
    lowered = replace(sight, tip=np.array([50.0, 60.0]))
    assert lowered.dimple == pytest.approx(60.0 - sight.outline[:, 1].min())


def test_it_sinks_by_the_mean_within_a_quarter_of_the_radius(asked):
    sight = see("picture", "top", None)
    x, y = sight.outline.T
    near = np.abs(x - CENTER[0]) < 10.0
    down = np.where(near, np.where(x > CENTER[0], 1.0, 3.0), 100.0)
    sunk = replace(sight, outline=np.column_stack([x, y + down]), center=CENTER + 7, radius=9.0)
    assert sunk.sunk(sight) == pytest.approx(2.0)


def test_the_tip_is_tracked_anew_in_each_frame(asked):
    tracker = TipTracker("bottom", (5, 6, 7, 8))
    found = tracker.track("picture")
    assert asked[0][1] == {"direction": "bottom", "region": (5, 6, 7, 8), "dimple": False}
    np.testing.assert_array_equal(found.center, [50.0, 35.0])
    assert not found.lost
    assert found.reason == ""
    # Two hundredths of a px either way, as the boundary's tests have it over ground.
    np.testing.assert_allclose(found.covariance, [[4e-4, 0.0], [0.0, 4e-4]])
    lost = tracker.track(None)
    assert lost.lost
    assert np.isnan(lost.center).all()
    assert lost.reason == "image must show one dark probe, got none"
