"""The loop behind `inject` in a world of numbers, where every place and way is known exactly.

The camera's picture is the place of the pipette's end, and `see` and `fit_capsule` are replaced by
what a perfect eye and a perfect model would say. Pictures are in `test_inject.py`.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from microlib._common import EndRun
from microlib.automation import _press, _sight, inject
from microlib.automation._press import Press
from microlib.automation._sight import Sight

PIXEL = 4.0
#: The stage's axes lie turned by 30 degrees, one of them reversed.
TURN = np.array([[np.cos(0.5), np.sin(0.5)], [np.sin(0.5), -np.cos(0.5)]]) / PIXEL
HOME = np.array([90.0, 30.0])
CENTER, RADIUS = np.array([110.0, 160.0]), 80.0
THICKNESS = 3.0
#: Height of the pipette's end where it touches the outside of the wall, px.
TOUCH = CENTER[1] - RADIUS - THICKNESS / 2 / PIXEL


class World:
    """An egg whose top sinks by half of the way since contact, and whose dimple is as deep."""

    def __init__(self) -> None:
        self.place, self.time = np.zeros(2), 0.0
        self.fits: list[tuple[tuple, dict]] = []
        self.blind: tuple[int, ...] = ()
        self.pictures = -1
        self.camera = self.stage = self.clock = self
        self.sink = lambda way: max(0.0, 0.5 * way)  # µm

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds

    def snap(self):
        self.time += 0.01
        self.pictures += 1
        return HOME + TURN @ self.place, self.time

    def position(self):
        return self.place.copy()

    def move_to(self, place) -> None:
        self.place = np.array(place)

    def moving(self) -> bool:
        return False

    def stop(self) -> None:
        pass

    def way(self, tip) -> float:
        """Return how far the pipette's end has gone since contact, µm."""
        return (tip[1] - TOUCH) * PIXEL

    def see(self, tip, direction, region) -> Sight:
        if self.pictures in self.blind:
            raise ValueError("image must show something, got nothing")
        across = np.linspace(-60.0, 60.0, 401)
        heights = CENTER[1] - np.sqrt(RADIUS**2 - across**2) + self.sink(self.way(tip)) / PIXEL
        return Sight(
            tip=np.array(tip),
            along=np.array([0.0, 1.0]),
            outline=np.column_stack([CENTER[0] + across, heights]),
            center=CENTER,
            radius=RADIUS,
            direction="top" if direction == "auto" else direction,
        )

    def fit(self, force, points, **settings):
        self.fits.append(((force, points), settings))
        way = self.way(HOME + TURN @ self.place)
        modulus = 1 / (0.004 * way**1.5)
        state = SimpleNamespace(depth=0.5 * way)
        return SimpleNamespace(
            modulus=modulus, modulus_std=0.03 * modulus, inflation=1.0 + way / 1e4, state=state
        )


@pytest.fixture
def world(monkeypatch) -> World:
    made = World()
    for module in (_press, _sight):
        monkeypatch.setattr(module, "see", made.see)
    monkeypatch.setattr(_press, "fit_capsule", made.fit)
    return made


def run(world: World, **options):
    known = {
        "pixel_size": PIXEL, "probe_half_width": 25.0, "thickness": THICKNESS, "travel": 900.0,
        "force": 2.0, "modulus": 1.5, "jacobian": TURN, "approach_step": 1.0,
    }  # fmt: skip
    return inject(world, **(known | options))


def ways(world: World, log):
    """Return the true way since contact at the rows of a log, µm."""
    places = log[["stage_x_um", "stage_y_um"]].to_numpy()
    return np.array([world.way(HOME + TURN @ place) for place in places])


def test_the_way_down_is_gone_in_steps_to_two_behind_the_contact(world):
    found = run(world)
    assert found.reached, found.reason
    log = found.log
    assert world.way(HOME + TURN @ found.contact) == pytest.approx(2.0)
    down = log.query("phase == 'approach'")
    # It hangs 10 px over the crown, and from 3 px over the contact on it goes in steps.
    true = ways(world, down)
    np.testing.assert_allclose(true, [-38.5, *np.arange(-12.0, 2.1)], atol=1e-9)
    np.testing.assert_allclose(down["gap_um"], -true, atol=1e-9)
    np.testing.assert_allclose(down["sunk_um"].iloc[1:], np.maximum(0.0, true[1:] / 2), atol=1e-9)
    np.testing.assert_allclose(down["tip_x_px"], CENTER[0], atol=1e-9)
    np.testing.assert_allclose(down["tip_y_px"], TOUCH + true / PIXEL, atol=1e-9)
    assert down["event"].tolist() == [*[""] * (len(down) - 1), "contact"]
    assert down["approach_um"].iloc[-1] == 0
    assert (log["event"] == "contact").sum() == 1
    # The first picture: how far the end is above the crown.
    assert log["gap_um"].iloc[0] == pytest.approx((80.0 - HOME[1]) * PIXEL)
    lined = log.query("phase == 'line up'")
    assert len(lined) >= 1
    assert (np.diff(log["time_s"]) >= 0).all()


def test_an_outline_is_sunk_from_a_hundredth_of_a_pixel_and_a_half_on(world):
    found = run(world, approach_step=0.1)
    # After 0.1 µm it is 0.0125 px, which is too little to be sure of; 0.025 and 0.0375 are two.
    assert world.way(HOME + TURN @ found.contact) == pytest.approx(0.3)


def test_force_and_depth_are_the_models_and_the_run_ends_at_the_target(world):
    found = run(world)
    log = found.log.query("phase == 'press'")
    true = ways(world, log)
    force = 1.5 * 0.004 * true**1.5
    seen = TOUCH + true / PIXEL - (80.0 + true / 2 / PIXEL)  # of the dimple, px
    fitted = seen >= 4
    assert 0 < fitted.sum() < len(log)
    np.testing.assert_allclose(log["force_uN"], np.where(fitted, force, np.nan))
    np.testing.assert_allclose(log["force_std_uN"], np.where(fitted, 0.03 * force, np.nan))
    depth = np.where(fitted, true / 2, np.where(seen > 0, seen * PIXEL, np.nan))
    np.testing.assert_allclose(log["depth_um"], depth)
    np.testing.assert_allclose(log["approach_um"], true - 2.0)  # it was seen 2 µm late
    np.testing.assert_allclose(log["sunk_um"], true / 2)
    assert 0.98 * 2.0 <= found.force <= 1.1 * 2.0
    assert (found.force, found.force_std) == (
        log["force_uN"].iloc[-1],
        log["force_std_uN"].iloc[-1],
    )
    assert found.depth == log["depth_um"].iloc[-1]
    assert (log["force_uN"].iloc[:-1].fillna(0.0) < 0.98 * 2.0).all()
    assert log["event"].iloc[-1] == "reached"
    # Until a force is known the steps are of a pixel.
    np.testing.assert_allclose(np.diff(true)[: (~fitted).sum() - 1], PIXEL)
    assert np.diff(true).max() <= 10.0


def test_steps_are_part_of_what_the_last_two_values_foretell(world):
    log = run(world).log.query("phase == 'press'")
    way, force = log["approach_um"].to_numpy(), log["force_uN"].to_numpy()
    known = np.flatnonzero(np.isfinite(force))
    assert len(known) >= 4
    for before, here, after in zip(known, known[1:], known[2:], strict=False):
        power = np.log(force[here] / force[before]) / np.log(way[here] / way[before])
        left = way[here] * (2.0 / force[here]) ** (1 / np.clip(power, 1, 3)) - way[here]
        assert way[after] - way[here] == pytest.approx(np.clip(0.7 * left, 1.0, 10.0))


def test_what_the_model_is_asked(world):
    found = run(world, law="hooke")
    known = {"thickness": THICKNESS, "probe_half_width": 25.0, "radius": RADIUS * PIXEL}
    first = (~np.isnan(found.log["force_uN"])).idxmax()
    way = found.log["approach_um"].iloc[first]
    softness = 1 / (0.07 * THICKNESS * way)
    start = (pytest.approx(softness), 1.03)
    assert len(world.fits) >= 2
    for (force, points), settings in world.fits:
        assert force == 1.0
        assert settings["law"] == "hooke"
        assert {name: settings[name] for name in known} == known
        assert settings["start"] == start
        # In µm, y up, every second of 401 points.
        np.testing.assert_allclose(points[:, 0], PIXEL * (110.0 + np.linspace(-60, 60, 401)[::2]))
        assert (points[:, 1] < 0).all()
        true = 2 * (-points[100, 1] - PIXEL * 80.0)  # the crown has sunk by half of the way
        # From where the search before ended.
        start = (pytest.approx(1 / (0.004 * true**1.5)), pytest.approx(1 + true / 1e4))


def test_it_comes_back_to_where_it_hung_in_four_looks(world):
    found = run(world)
    back = ways(world, found.log.query("phase == 'withdraw'"))
    deepest = ways(world, found.log.query("phase == 'press'"))[-1]
    np.testing.assert_allclose(back, np.linspace(deepest, -38.5, 5)[1:], atol=1e-9)
    np.testing.assert_allclose(
        found.log.query("phase == 'withdraw'")["approach_um"], back - 2.0, atol=1e-9
    )


def test_each_row_is_told_once_and_complete(world):
    told: list[dict] = []
    found = run(world, progress=told.append, hold=3.0)
    log = found.log.iloc[:-1]
    assert [row["time_s"] for row in told] == log["time_s"].tolist()
    assert [row["event"] for row in told] == log["event"].tolist()
    np.testing.assert_array_equal([row["force_uN"] for row in told], log["force_uN"])
    np.testing.assert_array_equal([row["approach_um"] for row in told], log["approach_um"])
    reached = log.query("phase == 'press'").index[-1]
    gaps = np.diff(log["time_s"])
    assert 3.0 <= gaps[reached] < 3.1
    assert np.delete(gaps, reached).max() < 1.0
    assert found.frames == ()


def test_pictures_without_an_egg_are_passed_over_until_there_are_too_many(world):
    world.blind = (9, 10)
    found = run(world, keep_frames=True)
    assert found.reached
    assert found.log["lost"].sum() == 2
    assert len(found.frames) == len(found.log) - 1
    world.__init__()
    world.blind = (9, 10)
    found = run(world, most_lost=2)
    assert found.reason == "lost: image must show something, got nothing, in 2 frames in a row"


@pytest.mark.parametrize(
    ("sink", "reason"),
    [
        # 0.31 px, and 3 px before the contact.
        (lambda way: 1.24 * (way > -13), "the egg moves before it is touched: 0.31 px"),
        (lambda way: -1.24 * (way > -13), "the egg moves before it is touched: -0.31 px"),
        (lambda way: 0.0, "no contact is seen where the egg should be touched"),
        (lambda way: 0.5 * max(0, way) * (way < 10) + 0.1 * way * (way >= 10), "springs back from"),
    ],
)
def test_what_the_egg_should_not_do_ends_the_run(world, sink, reason):
    world.sink = sink
    found = run(world)
    assert reason in found.reason
    assert not found.reached


def test_an_egg_may_move_and_sink_within_what_its_place_is_known_to(world):
    world.sink = lambda way: 1.16 * (way > -13)  # 0.29 px may be the scatter
    assert "moves" not in run(world).reason
    world.__init__()
    # 2 px, 8 µm, before and behind the place where it should be touched.
    for touched, fine in ((-9.5, False), (-7.5, True), (6.5, True), (8.5, False)):
        world.__init__()
        world.sink = lambda way, at=touched: max(0.0, 8.0 * (way - at))
        assert np.isfinite(run(world).contact).all() == fine, touched


def test_half_of_what_it_sank_may_come_up_again(world):
    for share, fine in ((0.55, True), (0.45, False)):
        world.__init__()
        world.sink = lambda way, s=share: max(0.0, 0.5 * way if way < 12 else 5.0 * s)
        found = run(world, force=1e6, travel=300.0)
        assert ("springs back" not in found.reason) == fine, found.reason


def test_a_target_that_is_passed_is_said_to_be(world):
    found = run(world, force=0.1)
    assert found.reason.startswith("the target was passed: force ")
    assert not found.reached
    assert np.isnan(found.force)


def press_of(world: World, **plan) -> Press:
    given = {
        "pixel_size": PIXEL, "press_step": 50.0, "approach_step": 0.5, "target": 8.0,
        "direction": "top", "travel": np.array([100.0, 50.0]), "keep_frames": False,
    }  # fmt: skip
    guard = SimpleNamespace(call=lambda f, *a: f(*a), settle=lambda: None)
    return Press(world, guard, SimpleNamespace(**(given | plan)))  # type: ignore[arg-type]


def test_the_scatter_of_the_untouched_outline_tells_what_is_too_far():
    still = [0.01, -0.01, 0.02, 0.0, 0.03]
    over, least = Press._sinking(0.2, still)
    assert over == pytest.approx(0.19)
    # Of a new value about the mean of five: s √(1 + 1/5), four times.
    assert least == pytest.approx(4 * np.sqrt(0.001 / 4) * np.sqrt(1.2))
    assert Press._sinking(0.2, [0.0] * 5) == (0.2, 0.015)
    assert Press._sinking(0.2, still[:4]) == (0.2, 0.3)  # too few to tell


def test_a_step_supposes_a_power_and_bounds_it(world):
    loop = press_of(world)
    # 1 at 10: with the power 1.5 that is supposed, 8 comes at 40.
    assert loop._next_step([(10.0, 1.0)], 10.0) == pytest.approx(0.7 * 30.0)
    # 1 at 10, 16 at 20 would be the fourth power, and nothing is steeper than the third.
    loop = press_of(world, target=16.0 * 8)
    assert loop._next_step([(10.0, 1.0), (20.0, 16.0)], 20.0) == pytest.approx(0.7 * 20.0)
    # 1 at 10, 1.1 at 20 would be less than a line.
    loop = press_of(world, target=2.2)
    assert loop._next_step([(10.0, 1.0), (20.0, 1.1)], 20.0) == pytest.approx(0.7 * 20.0)
    # From where it is, not from where the last value was known.
    assert loop._next_step([(10.0, 1.0), (20.0, 1.1)], 25.0) == pytest.approx(0.7 * 15.0)
    assert press_of(world, press_step=3.0)._next_step([], 0.0) == 3.0
    assert press_of(world, approach_step=6.0)._next_step([], 0.0) == 6.0
    assert press_of(world)._next_step([(10.0, 0.0)], 10.0) == PIXEL
    # A value that fell says nothing of the power.
    assert press_of(world)._next_step([(8.0, 2.0), (10.0, 1.0)], 10.0) == pytest.approx(21.0)


def test_the_way_is_along_the_axis_from_where_it_was_lined_up(world):
    loop = press_of(world)
    loop._origin, loop._axis = np.array([10.0, 20.0]), np.array([0.6, -0.8])
    loop._start = np.array([-5.0, 0.0])
    loop._go(5.0)
    np.testing.assert_allclose(world.place, [13.0, 16.0])
    for way in (100.0, -40.0):  # x is 75 from the start, y −60; then x −9 and y 52
        with pytest.raises(EndRun, match="beyond the travel"):
            loop._go(way)
    np.testing.assert_allclose(world.place, [13.0, 16.0])
    world.move_to = lambda place: setattr(world, "place", np.add(place, [0.0, 0.4]))
    loop._go(4.0)
    world.move_to = lambda place: setattr(world, "place", np.add(place, [0.4, 0.4]))
    with pytest.raises(EndRun, match=r"stands 0\.57 µm from where"):
        loop._go(3.0)


def test_the_image_follows_within_half_of_the_way(world):
    def look(x, y):
        return SimpleNamespace(sight=SimpleNamespace(tip=np.array([x, y])))

    loop = press_of(world)
    loop.jacobian, loop._axis = TURN, np.linalg.solve(TURN, [0.0, 1.0]) / PIXEL
    loop._follow(look(100.0, 50.0))
    loop._advance = 7.9  # less than 2 px tell nothing
    loop._follow(look(100.0, 40.0))
    loop._advance = 40.0
    loop._follow(look(102.0, 56.0))  # instead of 10 px: off by 4.5
    loop._advance = 80.0
    with pytest.raises(EndRun, match=r"went \[0\. 4\.\] px instead of \[ 0\. 10\.\] px"):
        loop._follow(look(102.0, 60.0))
    loop._advance = 48.2  # 2.05 px after the last that followed
    with pytest.raises(EndRun, match="does not follow"):
        loop._follow(look(102.0, 57.0))


def test_a_picture_that_did_not_change_is_no_news_only_after_a_move(world):
    loop = press_of(world, region=None)
    loop._sight(np.array([100.0, 50.0]))
    loop._sight(np.array([100.0, 50.0]))
    loop._moved = True
    with pytest.raises(ValueError, match="got the one before again"):
        loop._sight(np.array([100.0, 50.0]))
    buffer = np.array([100.0, 50.0])
    loop._moved = True
    loop._sight(buffer + 1)
    loop._sight(buffer)
    buffer[:] = 60.0  # the camera writes the next into the same place
    loop._moved = True
    loop._sight(buffer)


@pytest.mark.parametrize(("jacobian", "needed"), [(TURN, 10), (None, 23)])
def test_the_pipette_begins_high_enough(world, jacobian, needed):
    begin = np.linalg.solve(TURN, [0.0, 80.0 - needed + 0.2 - HOME[1]])
    world.place = begin
    found = run(world, jacobian=jacobian)
    assert f"at least {needed} px above the egg, got {needed - 0.2:.1f} px" in found.reason
    world.place = np.linalg.solve(TURN, [0.0, 80.0 - needed - 0.2 - HOME[1]])
    assert "must begin" not in run(world, jacobian=jacobian).reason


def test_a_stage_of_another_scale_than_the_pixel_is_refused(world):
    for share, fine in ((1.08, True), (1.12, False), (0.93, True), (0.89, False)):
        world.__init__()
        assert ("but the stage moves" not in run(world, pixel_size=share * PIXEL).reason) == fine
