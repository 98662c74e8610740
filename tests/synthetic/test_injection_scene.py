"""The scene of an injection: no jump at contact, the outline where the capsule is."""

from __future__ import annotations

import numpy as np
import pytest

from microlib.membrane import indent_capsule
from microlib.synthetic import InjectionScene


@pytest.fixture(scope="module")
def scene():
    return InjectionScene(0, modulus=1.5, strongest=60.0, noise=0.0)


def at(scene, micrometers):
    return scene.contact + np.array([0.0, micrometers / scene.pixel_size])


def test_force_is_the_capsules_between_the_solved_states(scene):
    sizes = {"modulus": 1.5, "radius": 600.0, "thickness": 3.0, "probe_half_width": 25.0}
    for force in (9.0, 40.0, 77.0):
        state = indent_capsule(force, inflation=1.05, **sizes)
        # Interpolated between forces a quarter apart: under half a percent.
        assert scene.force(at(scene, state.approach)) == pytest.approx(force, rel=5e-3)
        assert scene.depth(at(scene, state.approach)) == pytest.approx(state.depth, rel=5e-3)


def test_nothing_jumps_at_contact(scene):
    assert scene.force(at(scene, -1.0)) == 0.0
    assert 0 < scene.force(at(scene, 0.01)) < 0.01
    before, after = (scene.frame(at(scene, way)).astype(float) for way in (-0.02, 0.02))
    # The pipette's end goes on by 0.01 px, the top sinks by half of that.
    assert np.abs(after - before).max() <= 3
    # A bonded face takes over from one without friction where both agree.
    ways = np.linspace(0.0, 15.0, 301)
    steps = np.diff([scene.force(at(scene, way)) for way in ways])
    assert (steps > 0).all()
    assert np.abs(np.diff(steps)).max() < 0.2 * steps.max()


def test_the_crown_and_the_pipette_are_drawn_where_they_are(scene):
    x, y = scene.contact
    image = scene.frame(at(scene, -60.0)).astype(float) / scene._light
    column = image[:, round(x)]
    tip = y - 60.0 / scene.pixel_size
    dark = np.flatnonzero(column[: round(y)] < (195 + 42) / 2)
    assert dark[-1] == pytest.approx(tip, abs=0.8)  # the last whole pixel over half of the edge
    near = slice(round(y) - 4, round(y) + 6)
    wall = column[near].argmin() + near.start
    # The middle of the wall, 1.5 µm below its outside.
    assert wall == pytest.approx(y + 1.5 / scene.pixel_size, abs=0.6)


def test_a_wall_that_gives_way_lets_the_egg_be_round_again():
    scene = InjectionScene(0, modulus=1.0, strongest=20.0, rupture=5.0, noise=0.0)
    assert scene.force(at(scene, 5.0)) > 0
    assert scene.force(at(scene, 40.0)) == 0.0
    assert scene.depth(at(scene, 40.0)) == 0.0
    torn, free = scene.frame(at(scene, 40.0)), scene.frame(at(scene, -40.0))
    np.testing.assert_array_equal(torn[:, :100], free[:, :100])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"strongest": 1e6}, "strongest must suit the capsule: force must have an equilibrium"),
        ({"pixel_size": 601.0}, "pixel_size must be at most 600"),
        ({"pixel_size": 0.009}, "pixel_size must be at least 0.0091"),
    ],
)
def test_what_is_no_scene_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        InjectionScene(0, modulus=1.0, **change)


def test_what_no_egg_bears_is_refused(scene):
    with pytest.raises(ValueError, match="tip must be at most"):
        scene.frame(at(scene, scene.deepest + 1.0))
