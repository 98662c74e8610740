"""Depth while acquiring: the same as afterwards, no part missed, faults of the drive."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from compendium.experiments.live_depth import (
    COARSE,
    PART,
    POSITIONS,
    SCENES,
    SHAPE,
    frames_of,
    microscope,
)
from microlib.automation import LiveDepth, acquire_depth
from microlib.focus import depth_from_focus, sum_modified_laplacian
from microlib.servoing import MicroManager
from tests.servoing.engine import rendered_core

SEED = 20


def agree(first, second):
    """Return whether two results have the same depth: a hundredth of the spacing, and the NaN."""
    np.testing.assert_array_equal(np.isnan(first.depth), np.isnan(second.depth))
    return np.nanmax(np.abs(first.depth - second.depth)) < 0.12


def _fail(*_):
    raise OSError("no light")


@pytest.fixture(scope="module")
def cone():
    return frames_of("cone", SEED)


@pytest.mark.parametrize("options", [{}, {"measure": "tenengrad"}])
def test_every_prefix_is_what_the_whole_would_be(cone, options):
    live, buffer = LiveDepth(**options), np.empty(SHAPE, np.uint8)
    for k, (frame, z) in enumerate(zip(cone[:17], POSITIONS, strict=False)):
        buffer[:] = frame  # as a camera may, over the one before
        live.push(buffer, z)
        if k + 1 in (3, 17):
            whole = depth_from_focus(cone[: k + 1], POSITIONS[: k + 1], **options)
            assert agree(live.result(), whole)


@pytest.mark.parametrize("name", ["cone", "step"])
@pytest.mark.parametrize("falling", [False, True])
def test_a_quarter_of_the_frames_is_saved_and_the_depth_the_agree(name, falling):
    stack, height = frames_of(name, SEED), SCENES[name]()
    order = slice(None, None, -1 if falling else 1)
    far = float(height.min() if falling else height.max())
    for options in ({"farthest": far}, {"coarse": COARSE}):
        run = acquire_depth(microscope(stack), POSITIONS[order], **options)
        assert run.complete
        assert run.still
        if not falling:  # the stack reaches five times further beyond the top than below the ground
            assert "beyond" in run.reason
            assert run.frames <= 0.75 * len(POSITIONS)
        taken = [int(np.flatnonzero(z == POSITIONS)[0]) for z in run.positions]
        assert agree(run.result, depth_from_focus(stack[taken], run.positions))
        error = run.result.depth - height
        # The error of the whole stack, 1 to 4 µm: the step's edge is most of it.
        assert np.sqrt(np.nanmean(error**2)) < 5


def test_a_part_of_twelve_pixels_is_not_missed():
    stack, height = frames_of("small part", SEED), SCENES["small part"]()
    part = height == height.max()
    assert part.sum() == PART**2
    for options in ({"farthest": float(height.max())}, {"coarse": COARSE}):
        run = acquire_depth(microscope(stack), POSITIONS, **options)
        assert run.positions[-1] > height.max() + 24


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda s: setattr(s.camera, "snap", _fail), "failed: OSError: no light"),
        (lambda s: setattr(s.focus, "move_to", _fail), "failed: OSError: no light"),
        (lambda s: setattr(s.focus, "move_to", lambda z: None), "the focus drive stands"),
        (lambda s: setattr(s.focus, "moving", lambda: True), "still moves after"),
    ],
)
def test_a_fault_ends_with_the_drive_stopped_and_what_was_seen(cone, spoil, reason):
    scope, stops = microscope(cone), []
    stop = scope.focus.stop
    scope.focus.stop = lambda: stops.append(1) or stop()

    def late(live):
        if live.frames == 5:
            spoil(scope)

    run = acquire_depth(scope, POSITIONS, progress=late, timeout=2.0)
    assert reason in run.reason
    assert not run.complete
    assert stops
    assert len(run.positions) == 5
    assert agree(run.result, depth_from_focus(cone[:5], POSITIONS[:5]))


def test_the_engines_acquisition_gives_the_same_and_ends_early(cone):
    reason = "pymmcore-plus is not installed"
    pytest.importorskip("pymmcore_plus", reason=reason)
    from useq import MDAEvent

    # The adapter switches off the shutter that there is none of.
    core = MicroManager(rendered_core(microscope(cone), SHAPE)).core
    live = LiveDepth(farthest=float(SCENES["cone"]().max()))
    core.mda.events.frameReady.connect(lambda frame, event: live.push(frame, event.z_pos))
    core.mda.run(MDAEvent(z_pos=float(z)) for z in POSITIONS if not live.done)
    assert live.done
    assert live.frames < 0.75 * len(POSITIONS)
    count = live.frames
    assert agree(live.result(), depth_from_focus(cone[:count], POSITIONS[:count]))


def test_wrong_frames_and_places_are_refused():
    live = LiveDepth()
    live.push(np.zeros((16, 16)), 1.0)
    live.push(np.zeros((16, 16)), 0.0)
    with pytest.raises(ValueError, match="z must go on from 0 µm"):
        live.push(np.zeros((16, 16)), 0.5)
    with pytest.raises(ValueError, match=r"frame must be \(16, 16\) float64"):
        live.push(np.zeros((16, 17)), -1.0)
    with pytest.raises(
        ValueError, match=r"frame must be at least 2 px on each side, got \(1, 16\)"
    ):
        LiveDepth().push(np.zeros((1, 16)), 0.0)
    for ask in (lambda: live.depth, live.result):
        with pytest.raises(ValueError, match="at least three"):
            ask()
    assert live.frames == 2
    with pytest.raises(ValueError, match="positions must be at least three"):
        acquire_depth(microscope(np.zeros((44, 16, 16), np.uint8)), [0.0, 2.0, 1.0])


def test_options_are_checked_without_frames_and_sizes_at_the_first_one():
    for options, words in (
        ({"register": True}, "frames must be at least 32 px on each side"),
        ({"reduce": 64}, "must have sides of at least the 64 px of a block"),
        ({"measure": partial(sum_modified_laplacian, step=40)}, "step must be below the image's"),
        ({"region": (3, 5, 9, 90)}, "region must lie in the image of 30×24 px"),
    ):
        live = LiveDepth(**options)
        with pytest.raises(ValueError, match=words):
            live.push(np.zeros((24, 30), np.uint8), 0.0)
        live = LiveDepth(**options)
        live.push(np.zeros((192, 194), np.uint8), 0.0)
        assert live.frames == 1
    for wrong in (
        {"window": 5}, {"window": 4}, {"measure": "variance", "window": 2}, {"region": (0, 0, 4)},
        {"measure": "none"}, {"farthest": [1.0]},
    ):  # fmt: skip
        with pytest.raises(ValueError, match="|".join(wrong)):
            LiveDepth(**wrong)
