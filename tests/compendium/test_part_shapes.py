"""The shapes that parts were learned from, where they have a formula."""

from __future__ import annotations

import json

import numpy as np
import pytest

from compendium import part_classes, part_shapes
from compendium.part_shapes import Part, _arc, _frame
from microlib.curvature import PART_KINDS, surface_curvature


def test_an_arc_has_its_width_rise_and_curvature() -> None:
    x = np.linspace(-0.5, 0.5, 2001)
    arc = _arc(x, 0.3, 0.12)
    assert arc[1000] == pytest.approx(0.12)
    assert not arc[np.abs(x) >= 0.3].any()
    assert (arc[np.abs(x) < 0.299] > 0).all()
    bend = np.gradient(np.gradient(arc, x), x)[1000]
    assert bend == pytest.approx(-2 * 0.12 / (0.3**2 + 0.12**2), rel=1e-3)


def test_coordinates_are_turned_about_the_parts_middle() -> None:
    rng = np.random.default_rng(0)
    dx, dy = rng.uniform(-0.2, 0.2, 2)
    turn = rng.uniform(0, 2 * np.pi)
    x, y = _frame(50, np.random.default_rng(0), 0.2)
    assert np.hypot(x, y)[10, 40] == pytest.approx(
        np.hypot(40.5 / 50 - 0.5 - dx, 10.5 / 50 - 0.5 - dy)
    )
    along = np.gradient(x, 1 / 50, axis=1)[0, 0], np.gradient(x, 1 / 50, axis=0)[0, 0]
    assert along == pytest.approx((np.cos(turn), np.sin(turn)))
    across = np.gradient(y, 1 / 50, axis=1)[0, 0], np.gradient(y, 1 / 50, axis=0)[0, 0]
    assert across == pytest.approx((-np.sin(turn), np.cos(turn)))


@pytest.mark.parametrize("kind", ["sphere", "cylinder", "saddle"])
def test_the_bend_is_the_mean_curvature_at_the_middle(kind: str) -> None:
    checked = 0
    for seed in range(20):
        # On a fine grid; what reaches its own edge within the windows is left out.
        part = part_shapes.KNOWN[kind](240, np.random.default_rng(seed))
        mean = surface_curvature(part.height, 1 / 240, size=5).mean
        top = np.unravel_index(
            np.nanargmax(np.where(np.isnan(mean), -np.inf, part.height)), mean.shape
        )
        if kind == "saddle":
            assert np.nanmax(np.abs(mean)) < 1.2 * part.bend
            continue
        if np.isfinite(mean[top]):
            assert -mean[top] == pytest.approx(part.bend, rel=0.05), seed
            checked += 1
    assert checked > 10 or kind == "saddle"


def test_what_was_learned_has_the_form_that_is_said() -> None:
    text = part_classes.PATH.read_text(encoding="utf-8")
    kept = json.loads(text)
    count = len(kept["features"])
    assert len(kept["nets"]) == part_classes.NETS == 3
    assert np.shape(kept["nets"][0]["inner"]) == (count, part_classes.HIDDEN) == (count, 24)
    assert np.shape(kept["axes"]) == (count, part_classes.AXES) == (count, 20)
    assert np.shape(kept["whiteners"]) == (len(PART_KINDS), 20, 20)
    assert (part_classes.SEED, part_classes.EACH) == (318, (400, 130, 200, 60))
    assert (part_classes.DECAY, part_classes.REACH) == (3e-4, 0.998)


def test_noise_is_in_ratio_to_the_parts_own_curvature() -> None:
    part = Part(np.zeros((200, 200)), 4.0)
    z, sigma = part_classes.noisy(part, np.random.default_rng(0), 0.7)
    error = surface_curvature(np.zeros((13, 13)), 1.0, noise=sigma).mean_error[6, 6]
    # 3.5 standard errors of H are 0.7 of the part's, 4 a side or 0.02 a pixel.
    assert 3.5 * error == pytest.approx(0.7 * 4.0 / 200)
    assert z.std() == pytest.approx(sigma, rel=0.02)
    lifted, _ = part_classes.noisy(Part(np.ones((64, 64)), 1.0), np.random.default_rng(0), 0.0)
    np.testing.assert_array_equal(lifted, 64.0)
    waves, told = part_classes.wavy(Part(np.zeros((80, 80)), 1.0), np.random.default_rng(1))
    assert told is None
    assert 10**-1.7 < waves.std() < 10**-0.4
    assert np.corrcoef(waves[:, 1:].ravel(), waves[:, :-1].ravel())[0, 1] > 0.5


def test_an_example_is_known_by_its_class_and_the_same_again() -> None:
    first, classes, names = part_classes.examples((1, 1, 0, 0))
    again = part_classes.examples((1, 1, 0, 0))[0]
    np.testing.assert_array_equal(first, again)
    assert classes.tolist() == [*range(6), *[6] * len(part_shapes.OTHERS)]
    rng = np.random.default_rng([318, 2, 0, False])
    cone = part_classes.example("cone", rng, by_focus=False)
    np.testing.assert_allclose(first[2], list(cone.features.values()))
    assert names == list(cone.features)
