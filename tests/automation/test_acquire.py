"""The focus drive: where it goes, when it turns round and what it says, with known measures."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from microlib.automation import LiveDepth, _acquire, acquire_depth, autofocus
from microlib.automation._live import UNKNOWN, Peaks
from microlib.focus import depth_from_focus, sum_modified_laplacian, three_point_peak

POSITIONS = np.arange(0.0, 200.0, 10.0)
TEXTURE = np.random.default_rng(5).integers(-90, 90, (24, 24))


class Scope:
    """A drive that arrives at once, and a camera whose picture is as sharp as is asked for."""

    def __init__(self, sharp) -> None:
        self.z, self.visited, self.stops, self.off = 0.0, [], 0, 0.0
        self.pictures: dict[float, np.ndarray] = {}
        self.sharp, self.time = sharp, 0.0
        self.buffer = np.empty(TEXTURE.shape, np.uint8)
        self.camera = self.clock = self
        self.focus = SimpleNamespace(
            position=self.position, move_to=self.move_to, moving=lambda: False, stop=self.stop
        )

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds

    def position(self):
        return np.array([self.z])

    def move_to(self, place) -> None:
        self.z = float(place[0]) + self.off

    def stop(self) -> None:
        self.stops += 1

    def snap(self):
        self.visited.append(self.z)
        picture = np.clip(128 + self.sharp(self.z) * TEXTURE, 0, 255).astype(np.uint8)
        self.pictures[self.z] = picture
        self.buffer[:] = picture  # as a camera may, over the one before
        return self.buffer, 0.0


@pytest.fixture
def measured(monkeypatch):
    """Let autofocus be told the measure at each position."""

    def scope(measure):
        made = Scope(lambda z: 1.0)
        monkeypatch.setattr(_acquire, "_sharpness", lambda frame, part: measure(made.z))
        return made

    return scope


def bell(center, width, height=10.0, ground=1.0):
    return lambda z: ground + height * np.exp(-((z - center) ** 2) / (2 * width**2))


@pytest.mark.parametrize(
    ("width", "frames"),
    # The best is the fifth. Three later the narrow one has fallen to half; the wide one has then
    # fallen to 6.3 of 10.9, and in the next to 4.2.
    [(10.0, 8), (25.0, 9)],
)
def test_it_turns_round_three_frames_behind_the_best_at_half(measured, width, frames):
    scope = measured(bell(42.0, width))
    run = autofocus(scope, POSITIONS)
    assert run.complete
    assert run.error is None
    assert run.result is None
    assert run.positions.size == 0
    assert run.frames == frames
    assert scope.visited == POSITIONS[:frames].tolist()
    assert scope.stops == 1
    assert run.focus == scope.z
    assert run.reason == "the sharpest position was passed and gone back to"


def test_the_vertex_is_that_of_the_gaussian(measured):
    run = autofocus(Scope(lambda z: float(bell(42.0, 15.0, 1.0, 0.0)(z))), POSITIONS)
    # The measure is of the second order in the contrast, but noise of the rounding is in it.
    assert run.focus == pytest.approx(42.0, abs=0.3)
    uneven = np.array([0.0, 30.0, 40.0, 55.0, 70.0, 100.0, 150.0])
    for positions in (uneven, uneven[::-1]):
        run = autofocus(measured(bell(42.0, 9.0, ground=1e-9)), positions)
        assert run.focus == pytest.approx(42.0)


def test_neighbors_that_see_nothing_leave_the_middle(measured):
    run = autofocus(measured(lambda z: float(z == POSITIONS[5])), POSITIONS)
    assert run.complete
    assert run.focus == pytest.approx(POSITIONS[5])


@pytest.mark.parametrize(("height", "clear"), [(1.6, True), (1.4, False)])
def test_a_peak_is_two_and_a_half_times_the_least(measured, height, clear):
    scope = measured(bell(50.0, 20.0, height))
    run = autofocus(scope, POSITIONS)
    assert run.complete == clear
    if not clear:
        assert run.frames == len(POSITIONS)
        assert run.reason == "no position is clearly sharper than the others"
        assert scope.z == 50.0  # the best there is


@pytest.mark.parametrize("center", [-5.0, 195.0])
def test_an_end_is_not_taken_for_the_sharpest(measured, center):
    scope = measured(bell(center, 30.0))
    run = autofocus(scope, POSITIONS)
    assert run.reason == "the sharpest position is an end of those given"
    assert not run.complete
    assert run.still
    assert scope.z == POSITIONS[0 if center < 0 else -1]


def test_a_region_is_columns_and_rows():
    """Half of the picture is sharp at 60 µm, the other at 140 µm."""
    scope = Scope(lambda z: np.where(np.arange(24) < 12, bell(60, 15)(z), bell(140, 15)(z)) / 11)
    for region, sharpest in (((0, 2, 12, 9), 60.0), ((12, 2, 12, 9), 140.0)):
        assert abs(autofocus(scope, POSITIONS, region=region).focus - sharpest) < 5
    for wrong in ((1, 2, 7, 9), (1, 2, 9, 7), (-1, 0, 9, 9), (0, -1, 9, 9), (0, 0, 9), 3):
        with pytest.raises(ValueError, match="region"):
            autofocus(scope, POSITIONS, region=wrong)
    for outside in ((17, 0, 8, 8), (0, 17, 8, 8)):
        run = autofocus(Scope(lambda z: 1.0), POSITIONS, region=outside)
        assert run.reason.startswith("ValueError: region must lie in the image of 24×24 px, got")
        assert not run.complete
        assert run.frames == 1


@pytest.mark.parametrize(("off", "fine"), [(0.9, True), (-0.9, True), (1.1, False), (-1.1, False)])
def test_the_drive_may_stand_half_of_the_least_spacing_beside(off, fine):
    scope = Scope(lambda z: 1.0)
    scope.off = off
    run = acquire_depth(scope, [0.0, 5.0, 7.0, 12.0])
    assert run.complete == fine
    assert fine or "stands 1.1 µm from where it was sent" in run.reason


def test_a_coarse_look_takes_the_others_only_around_what_it_saw():
    scope = Scope(lambda z: 1.0 if 85 < z < 95 else 0.02)
    run = acquire_depth(scope, POSITIONS, coarse=3)
    assert run.complete
    assert run.reason == "a look at every 3 positions found nothing beyond those taken"
    # Seen at number 9; a coarse step and three frames to either side, and nothing is taken twice.
    np.testing.assert_array_equal(run.positions, POSITIONS[3:16])
    assert sorted(set(scope.visited)) == sorted(scope.visited)
    assert run.frames == len(scope.visited) == 7 + 13 - 5
    assert run.result is not None
    for sharp, near in ((lambda z: z < 5, slice(7)), (lambda z: z > 175, slice(12, None))):
        run = acquire_depth(Scope(lambda z, sharp=sharp: max(0.02, sharp(z))), POSITIONS, coarse=3)
        np.testing.assert_array_equal(run.positions, POSITIONS[near])
    grey = acquire_depth(Scope(lambda z: 0.0), POSITIONS, coarse=3)
    assert grey.reason == "nothing comes into focus in the coarse frames"
    assert not grey.complete
    assert grey.frames == 7
    assert grey.result is None
    for wrong in (1, 21):
        with pytest.raises(ValueError, match="coarse must"):
            acquire_depth(scope, POSITIONS, coarse=wrong)


def same_pictures(run, scope):
    """Return whether the run holds what the camera took, where it took it, in order."""
    assert len(run.images) == len(run.positions)
    for image, z in zip(run.images, run.positions, strict=True):
        np.testing.assert_array_equal(image, scope.pictures[z])
    return True


def test_what_was_taken_comes_back_whatever_fails_later():
    """A region that is too large, the user's measure, a broken drive, and a stop by the user."""
    calls = []

    def fails(image):
        calls.append(1)
        if len(calls) > 9:
            raise RuntimeError("no more")
        return np.abs(image).astype(np.float32)

    scope = Scope(lambda z: max(0.02, 1 - abs(z - 92) / 40))
    run = acquire_depth(scope, POSITIONS[::-1], measure=fails)
    assert run.reason == "all positions were visited; RuntimeError: no more"
    assert isinstance(run.error, RuntimeError)
    assert (run.complete, run.still, run.result) == (False, True, None)
    np.testing.assert_array_equal(run.positions, POSITIONS[::-1])
    assert same_pictures(run, scope)
    # They make the depth that a whole run would have made.
    whole = acquire_depth(scope, POSITIONS[::-1])
    again = depth_from_focus(run.images, run.positions)
    np.testing.assert_array_equal(again.depth, whole.result.depth)
    assert same_pictures(whole, scope)
    for options in ({}, {"coarse": 3}):
        run = acquire_depth(scope, POSITIONS, region=(1, 2, 23, 23), **options)
        assert run.reason.startswith("ValueError: region must lie in the image of 24×24 px, got")
        assert (run.frames, run.positions.tolist(), run.complete) == (1, [0.0], False)
        assert same_pictures(run, scope)


@pytest.mark.parametrize("after", [4, 9])
def test_a_coarse_look_that_fails_gives_what_it_took(after):
    """Before it has an end, and while the positions between are taken."""
    scope = Scope(lambda z: 1.0 if 85 < z < 95 else 0.02)
    move = scope.focus.move_to

    def stuck(place):
        if len(scope.visited) == after:
            raise OSError("no power")
        move(place)

    scope.focus.move_to = stuck
    run = acquire_depth(scope, POSITIONS, coarse=3)
    assert "no power" in run.reason
    assert run.frames == after
    assert run.positions.tolist() == sorted(scope.visited)
    assert same_pictures(run, scope)


def test_ctrl_c_while_the_depth_is_found_keeps_the_pictures():
    def stopped(image):
        stopped.calls += 1
        if stopped.calls > 4:
            raise KeyboardInterrupt
        return np.abs(image).astype(np.float32)

    stopped.calls = 0
    scope = Scope(lambda z: 1.0)
    with pytest.raises(KeyboardInterrupt) as error:
        acquire_depth(scope, POSITIONS[:4], measure=stopped)
    np.testing.assert_array_equal(error.value.run.positions, POSITIONS[:4])
    assert same_pictures(error.value.run, scope)


def test_a_drive_that_does_not_stop_or_say_where_it_is():
    scope = Scope(lambda z: 1.0)

    def broken(*_):
        raise OSError("no power")

    scope.focus.stop = broken
    run = acquire_depth(scope, POSITIONS[:4])
    assert "all positions were visited; the focus drive may not stand still: " in run.reason
    assert not run.still
    assert not run.complete
    assert run.focus == 30.0
    assert run.result is not None
    scope = Scope(lambda z: 1.0)
    scope.focus.position = broken
    assert np.isnan(acquire_depth(scope, POSITIONS[:4]).focus)


def pushed(*sharp, farthest=None, step=10.0):
    live = LiveDepth(farthest=farthest)
    for k, share in enumerate(sharp):
        live.push(np.clip(128 + share * TEXTURE, 0, 255).astype(np.uint8), step * k)
    return live


def test_the_end_of_a_scan_is_known_from_the_farthest_on():
    assert pushed(0.0, farthest=5.0).reason == "too few frames"
    assert LiveDepth(farthest=5.0).reason == "no frame yet"
    assert pushed(1.0, 0.1).reason == UNKNOWN
    for step in (10.0, -10.0):
        far = np.sign(step) * 40.0
        live = pushed(0.1, 1.0, 0.1, 0.05, farthest=far, step=step)
        assert live.reason == f"farthest, {far:g} µm, is not reached"
        assert not live.done
        # At the farthest itself, and with the peak three frames back.
        live = pushed(0.1, 1.0, 0.1, 0.05, 0.05, farthest=far, step=step)
        assert live.done, live.reason
        assert live.reason.endswith(f"none lies beyond {far:g} µm")
        live = pushed(0.1, 0.1, 1.0, 0.05, 0.05, farthest=far, step=step)
        assert not live.done
        assert "pixels with texture have not had their peak" in live.reason
    grey = pushed(0.0, 0.0, 0.0, 0.0, 0.0, farthest=10.0)
    assert not grey.done


def test_a_peak_has_passed_at_half_of_the_way_to_the_ground():
    # The measure is as the contrast: half of 1 and the ground at 0.1 is 0.55.
    for low, passed in ((0.5, True), (0.6, False)):
        live = pushed(0.1, 1.0, low, 0.9, 0.9, farthest=10.0)
        assert live.done == passed, live.reason


def test_the_quick_look_is_the_vertex_through_the_best_and_its_neighbors():
    rng = np.random.default_rng(2)
    frames = rng.integers(0, 255, (9, 30, 20)).astype(np.uint8)
    frames[:, :, :10] //= 25  # nothing to be seen there
    positions = np.cumsum(rng.uniform(5.0, 9.0, 9))
    peaks = Peaks(frames[0].shape)
    for frame in frames:
        peaks.push(frame)
    every = np.stack([sum_modified_laplacian(frame, window=7) for frame in frames])
    index = every.argmax(axis=0)
    around = np.pad(every, [(1, 1), (0, 0), (0, 0)])
    window = np.stack([np.take_along_axis(around, (index + k)[None], 0)[0] for k in range(3)])
    known = every.max(axis=0) > 2.5 * np.median(every.min(axis=0))
    assert 0.1 < known.mean() < 0.9
    expected = three_point_peak(window.astype(np.float32), index.astype(np.uint16), positions)
    np.testing.assert_allclose(peaks.depth(positions), np.where(known, expected, np.nan), rtol=1e-5)
