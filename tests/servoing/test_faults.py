"""Whatever fails, the run ends with the stage standing within its travel, and says why."""

import os
import re
import signal
from types import SimpleNamespace

import numpy as np
import pytest

from microlib.servoing import StageModel, servo
from tests.scenes.microscope import SHAPE, simulated_scope


def fail(*_):
    raise OSError("busy")


def press_ctrl_c(call, *arguments):
    os.kill(os.getpid(), signal.SIGINT)
    return call(*arguments)


NOISE = np.random.default_rng(0).integers(0, 255, SHAPE, dtype=np.uint8)
AT_HOME, _ = simulated_scope(0).workstation.camera.snap()
BROKEN = r"^OSError: busy$"
OFF = r"^(calibration rejected|the image does not follow|lost|the stage is beyond)"
#: The method that fails, its replacement, which is called with the method and its arguments, and
#: the reason that the run states.
FAULTS = {
    "snap error": ("camera.snap", fail, BROKEN), "move error": ("stage.move_to", fail, BROKEN),
    "position error": ("stage.position", fail, BROKEN),
    "track error": ("tracker.track", fail, BROKEN),
    "progress error": ("progress.call", fail, BROKEN),
    "black": ("tracker.track", lambda track, frame: track(0 * frame), "^lost: "),
    "noise": ("tracker.track", lambda track, frame: track(NOISE), "^lost: "),
    "other size": ("tracker.track", lambda track, frame: track(frame[:-2]), "^ValueError: "),
    "frozen": ("tracker.track", lambda track, frame: track(AT_HOME), OFF),
    "stuck": ("stage.move_to", lambda *_: None, OFF),
    "reversed": ("stage.move_to", lambda move, to: move(2 * move.__self__.position() - to), OFF),
    "overshoot": (
        "stage.move_to", lambda move, to: move(100 * to), "^the stage is beyond the travel",
    ),
    "never arrives": (
        "stage.moving", lambda call: True, "^the stage still moves after 1 s; the st",
    ),
    "Ctrl-C during snap": ("camera.snap", press_ctrl_c, "^interrupted by the user$"),
    "Ctrl-C during moving": ("stage.moving", press_ctrl_c, "^interrupted by the user$"),
    "Ctrl-C during track": ("tracker.track", press_ctrl_c, "^interrupted by the user$"),
}  # fmt: skip


def run_with(method, instead, first):
    """Go to a target, with a method that is replaced from frame `first` on.

    Returns the run, the microscope, and the largest distance of the stage relative to the travel.
    """
    # The stage is slow, so that an interrupt can arrive during a move.
    scope = simulated_scope(0, stage=StageModel(saturation=1000.0))
    tracker, stage, camera = scope.tracker(), scope.workstation.stage, scope.workstation.camera
    progress = SimpleNamespace(call=lambda row: None)
    parts = {"tracker": tracker, "stage": stage, "camera": camera, "progress": progress}
    owner, name = parts[method.split(".")[0]], method.split(".")[1]
    travel, frames, ways, position = 60.0 / scope.scale, [], [0.0], stage.position
    call = getattr(owner, name)

    def spoiled(*arguments):
        return instead(call, *arguments) if len(frames) >= first else call(*arguments)

    setattr(owner, name, spoiled)
    snap, moving = camera.snap, stage.moving
    camera.snap = lambda: (frames.append(1), snap())[1]
    stage.moving = lambda: (ways.extend(np.abs(position())), moving())[1]
    step = 10.0 / scope.scale  # short, so that faults occur before the target is reached
    given = {"travel": travel, "test_move": step, "longest_move": step, "timeout": 1.0}
    targets = scope.home + np.array([-35.0, 30.0])
    try:
        run = servo(
            scope.workstation, tracker, targets, **given, progress=lambda row: progress.call(row)
        )
    except KeyboardInterrupt as interrupt:
        run = interrupt.run
    else:  # Ctrl-C must reach the caller
        assert instead is not press_ctrl_c
    setattr(owner, name, call)
    return run, scope, max(ways) / travel


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("first", [3, 11])  # within the calibration, and on the way to the target
@pytest.mark.parametrize("fault", FAULTS)
def test_fault_ends_the_run_and_stops_the_stage(fault, first):
    method, instead, reason = FAULTS[fault]
    run, scope, farthest = run_with(method, instead, first)
    assert re.search(reason, run.reason), run.reason
    assert not run.reached.any()
    assert run.log["event"].iloc[-1] == run.reason
    assert run.still == (fault != "never arrives")
    assert (run.error is None) == reason.startswith(("^lost", "^the stage", OFF))
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert farthest <= 1.02  # 1000 µm/s over the 2 ms between two polls of the stage
    before = scope.workstation.feature
    scope.workstation.clock.sleep(1.0)
    np.testing.assert_array_equal(scope.workstation.feature, before)


@pytest.mark.parametrize("failures", [2, 3])
def test_stop_is_tried_three_times(failures):
    calls = []

    def stop(call):
        calls.append(1)
        return fail() if len(calls) <= failures else call()

    run, _, _ = run_with("stage.stop", stop, 0)
    assert run.still == (failures < 3)
    assert run.reason == ("" if run.still else "the stage may not stand still: busy")
    assert len(calls) == 3
