"""The loop over a microscope: the targets it reaches, the limits it keeps, and how it ends."""

import itertools
import os
import re
import signal
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from microlib.servoing import StageModel, servo
from tests.checks import hold_record, hold_same
from tests.scenes.microscope import demo_scope, simulated_scope, turned

JACOBIAN = turned(0.7, 0.25, mirrored=True)
AWAY = np.array([30.0, -25.0])


def scope_of(seed=0, **options):
    return simulated_scope(seed, **{"jacobian": JACOBIAN} | options)


def steer(scope, targets, **options):
    """Steer from home by `targets` in px."""
    settings = {"travel": 400.0, "test_move": 40.0} | options
    return servo(scope.workstation, scope.tracker(), scope.home + targets, **settings)


@pytest.mark.parametrize("camera", ["turned and mirrored", 100, 101, "demo of the engine"])
def test_targets_are_reached_and_every_frame_is_logged(camera):
    if camera == "demo of the engine":
        pytest.importorskip("pymmcore_plus", reason="pymmcore-plus is not installed")
        scope = demo_scope()
    else:  # by a number it is turned, mirrored and scaled by chance
        scope = scope_of() if isinstance(camera, str) else simulated_scope(camera)
    rows = []
    progress = lambda row: (rows.append(dict(row)), row.clear())  # its rows are copies  # noqa: E731
    run = steer(scope, AWAY, test_move=10.0, progress=progress)
    assert run.reached.all()
    assert run.still
    assert run.reason == ""
    moved = scope.jacobian @ scope.workstation.stage.position()
    np.testing.assert_allclose(moved, AWAY, atol=0.12)
    hold_record(run)
    assert run.to_dict()["jacobian_x_y"] == run.jacobian[0, 1]  # of x by the second axis
    log = run.log
    hold_same(log[:-1].to_dict("records"), rows)
    stopped = log[["stage_x_um", "stage_y_um"]].iloc[-1]
    np.testing.assert_allclose(stopped, scope.workstation.stage.position())
    assert (log["phase"] == "servo").sum() <= 4  # three moves
    others = log.drop(columns=["phase", "event"]).dtypes.astype(str).to_dict()
    assert (others.pop("target"), others.pop("lost")) == ("int64", "bool")
    assert set(others.values()) == {"float64"}
    assert (np.diff(log["time_s"]) > 0).all()
    assert list(log["phase"].unique()) == ["start", "calibration", "servo", "end"]
    assert log["event"].iloc[-2:].tolist() == ["reached", "done"]
    seen = log[log["phase"] != "end"]
    assert np.isfinite(seen[["measured_x_px", "stage_x_um", "latency_s"]]).all(axis=None)
    # Both ways along both axes, so that a drift can be distinguished from the Jacobian.
    tried = log.loc[log["phase"] == "calibration", ["stage_x_um", "stage_y_um"]]
    np.testing.assert_allclose([tried.min(), tried.max()], [[-10.0] * 2, [10.0] * 2], atol=0.05)
    # The next frame shows the stage at the commanded position, to an increment of its drive.
    sent = seen[["command_x_um", "command_y_um"]].to_numpy()[:-1]
    stood = seen[["stage_x_um", "stage_y_um"]].to_numpy()[1:]
    np.testing.assert_allclose(stood[:8], sent[:8], atol=0.05)


def test_second_run_with_the_jacobian_of_the_first_needs_no_calibration():
    scope = scope_of(drift=(1.5, -0.5))
    run = steer(scope, AWAY)
    # Tracking to 0.02 px during half a second gives the drift to about 0.1 px/s.
    np.testing.assert_allclose(run.drift, (1.5, -0.5), atol=0.25)
    again = steer(scope, AWAY, jacobian=run.jacobian)
    assert again.reached.all()
    assert not np.shares_memory(again.jacobian, run.jacobian)
    assert "calibration" not in again.log["phase"].to_numpy()
    for unknown in (again.jacobian_covariance, again.drift, again.reduced_chi2):
        assert np.isnan(unknown).all()


def test_moves_stay_within_step_and_travel():
    run = steer(scope_of(), AWAY, longest_move=20.0, test_move=20.0, travel=170.0)
    assert run.reached.all()
    way = np.hypot(*np.diff(run.log[["stage_x_um", "stage_y_um"]].to_numpy(), axis=0).T)
    assert way.max() == pytest.approx(20.0, abs=0.5)  # rounding of times, and two increments
    assert run.log["event"].str.contains("limit").sum() >= 5  # the way of 39 px is 156 µm
    # A Jacobian that is too small moves the stage too far: by 312 µm from one target to the other.
    near = 0.7 * np.array(AWAY)
    run = steer(scope_of(), [near, -near], travel=[300.0, 170.0], jacobian=0.7 * JACOBIAN)
    assert run.reached.all()
    assert run.log["event"].str.contains("travel").any()
    farthest = run.log[["stage_x_um", "stage_y_um"]].abs().max().max()
    assert farthest == pytest.approx(0.99 * 170.0, abs=1.0)


@pytest.mark.parametrize(("longest", "move"), [(None, 5.0), (3.0, 3.0)])
def test_default_test_move_is_a_tenth_of_the_shorter_travel_or_the_longest_move(longest, move):
    scope = scope_of(stage=StageModel(saturation=2.0))  # its moves take up to 6 s
    given = {"travel": [600.0, 50.0], "test_move": None, "longest_move": longest}
    run = steer(scope, [3.0, 0.0], **given)
    assert run.reason == ""
    tried = run.log.loc[run.log["phase"] == "calibration", ["stage_x_um", "stage_y_um"]]
    np.testing.assert_allclose(tried.abs().max(), move, atol=0.05)


def test_a_target_beyond_the_travel_ends_the_run_before_any_move():
    scope = scope_of()
    run = steer(scope, [[10.0, 0.0], JACOBIAN @ (150.0, 250.0)], travel=[600.0, 200.0])
    assert run.reason.startswith("target 1 is beyond the travel of ±")
    numbers = [float(number) for number in re.findall(r"\d+\.\d*", run.reason)]
    # To the 0.1 px of a track in the first frame.
    assert numbers == pytest.approx([594.0, 198.0, 150.0, 250.0], abs=1.0)
    assert not run.reached.any()
    assert run.still
    np.testing.assert_array_equal(scope.workstation.stage.position(), 0.0)


@pytest.mark.usefixtures("interruptible")
def test_servo_runs_outside_the_main_thread():
    runs = []
    thread = threading.Thread(target=lambda: runs.append(steer(scope_of(), AWAY)))
    thread.start()
    thread.join(timeout=20.0)
    assert runs[0].reached.all()


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("between", [0.02, 0.1, 0.2])
def test_second_interrupt_keeps_the_run_and_the_stage_is_stopped(between):
    scope = scope_of(stage=StageModel(saturation=100.0))
    stage, calls = scope.workstation.stage, []
    second = threading.Timer(between, os.kill, (os.getpid(), signal.SIGINT))
    for name in ("move_to", "stop"):
        call = getattr(stage, name)
        setattr(stage, name, lambda *to, name=name, call=call: (calls.append(name), call(*to)))

    def press(row):
        if row["target"] == 0 and "pressed" not in calls:
            calls.append("pressed")
            second.start()  # before the first press, which raises here at once
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt) as caught:
        steer(scope, AWAY, longest_move=20.0, test_move=20.0, progress=press)
    sent = second.finished.is_set()
    second.cancel()  # it would interrupt pytest
    assert sent
    run = caught.value.run
    assert (run.reason, run.still) == ("interrupted by the user", True)
    assert len(run.log) > 8
    assert calls[calls.index("pressed") :] == ["pressed", "stop"]
    where = stage.position()
    scope.workstation.clock.sleep(1.0)
    np.testing.assert_array_equal(stage.position(), where)


def run_at_once(first=-1, second=0):
    """Return what one run does if Ctrl-C is pressed when a line of the code of `servoing` begins.

    It is pressed again when `second` functions of it were called or left after that, if it still
    runs. Returns whether it was interrupted, how many lines ran, whether the stage was told to stop
    after the last move, and the handler of Ctrl-C afterwards.
    """
    calls, lines, after = [], itertools.count(), itertools.count(1)
    position = np.zeros(2)

    def move_to(target):
        calls.append("move_to")
        position[:] = target

    device = SimpleNamespace(
        snap=lambda: (np.zeros((3, 3)), 0.0), position=position.copy, move_to=move_to,
        moving=lambda: False, stop=lambda: calls.append("stop"), now=float, sleep=abs,
    )  # fmt: skip
    workstation = SimpleNamespace(camera=device, stage=device, clock=device)

    def trace(frame, event, argument):
        if not frame.f_globals["__name__"].startswith("microlib.servoing"):
            return None
        if event == "line" and next(lines) == first:
            sys.setprofile(profile)
            signal.raise_signal(signal.SIGINT)
        return trace

    def profile(frame, *_):  # an exception ends the calls of `trace`, but not those of `profile`
        inside = frame.f_globals["__name__"].startswith("microlib.servoing")
        if inside and next(after) == second:
            signal.raise_signal(signal.SIGINT)

    sys.settrace(trace)
    try:
        given = {"travel": 20.0, "jacobian": np.eye(2)}
        servo(workstation, seeing(position.copy), (3.0, 4.0), **given)
        interrupted = False
    except KeyboardInterrupt:
        interrupted = True
    finally:
        sys.settrace(None)
        sys.setprofile(None)
    stopped = "move_to" not in calls or calls[-1] == "stop"
    return interrupted, next(lines), stopped, signal.getsignal(signal.SIGINT)


@pytest.mark.usefixtures("interruptible")
def test_stage_is_stopped_and_handler_restored_wherever_ctrl_c_is_pressed(monkeypatch):
    monkeypatch.setattr("microlib.servoing._servo._DEBOUNCE", 0.0)
    before = signal.getsignal(signal.SIGINT)
    interrupted, count, stopped, after = run_at_once()
    assert (interrupted, stopped, after) == (False, True, before)
    results = [run_at_once(n, second) for n in range(count) for second in (0, 1, 4)]
    assert all(stopped for *_, stopped, _ in results)
    assert all(after is before for *_, after in results)
    assert sum(interrupted for interrupted, *_ in results) > len(results) / 2


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("handler", [signal.SIG_IGN, signal.SIG_DFL, None])
def test_handler_of_ctrl_c_set_by_the_user_is_called_during_the_run_and_kept(handler):
    pressed = []
    own = (lambda *_: pressed.append(1)) if handler is None else handler
    signal.signal(signal.SIGINT, own)
    scope = scope_of()

    def press(row):
        if handler is not signal.SIG_DFL:  # which would end Python
            signal.raise_signal(signal.SIGINT)

    run = steer(scope, AWAY, progress=press)
    assert run.reached.all()  # since this handler raises nothing
    assert len(pressed) == (handler is None) * (len(run.log) - 1)
    assert signal.getsignal(signal.SIGINT) is own


def test_exit_of_python_during_the_run_stops_the_stage_first():
    scope = scope_of(stage=StageModel(saturation=100.0))
    stopped, stop = [], scope.workstation.stage.stop
    scope.workstation.stage.stop = lambda: (stopped.append(1), stop())
    with pytest.raises(SystemExit, match="enough"):
        steer(scope, AWAY, progress=lambda row: sys.exit("enough"))
    assert stopped


# --- How a run ends, and the reason that it states ----------------------------------------------


def seeing(center, **more):
    """Return a tracker that finds the feature where `center()` says."""
    return SimpleNamespace(track=lambda frame: SimpleNamespace(center=center(), lost=False, **more))


def test_run_ends_after_three_moves_that_the_image_does_not_follow():
    scope = scope_of()
    away = AWAY / 3  # three such moves stay in the picture
    given = {"travel": 800.0, "jacobian": JACOBIAN, "tolerance": 0.2}
    behind = lambda: 0.6 * scope.home + 0.4 * scope.workstation.feature  # noqa: E731
    run = servo(scope.workstation, seeing(behind), scope.home + away, **given)
    assert run.reason.startswith(
        "the image does not follow the stage: 3 comparisons in a row were off"
    )
    # Each move leaves six tenths of the way, and the next one is planned over these.
    numbers = [float(number) for number in re.findall(r"-?\d+\.\d*", run.reason)]
    assert numbers == pytest.approx([*0.6**2 * 0.4 * away, *0.6**2 * away], abs=0.03)
    assert run.log["phase"].tolist() == ["start"] + ["servo"] * 4 + ["end"]


def test_two_wrong_tracks_do_not_end_the_run():
    scope = scope_of()
    bad, feature = iter([0, 0, 1, 1, 0, 1, 1] + [0] * 20), lambda: scope.workstation.feature
    tracker = seeing(lambda: feature() + 60.0 * next(bad))
    given = {"travel": 500.0, "jacobian": JACOBIAN, "longest_move": 60.0}
    run = servo(scope.workstation, tracker, scope.home + AWAY, **given)
    assert run.reached.all()
    assert run.reason == ""


def test_tracker_needs_neither_reason_nor_covariance():
    scope = scope_of()
    tracker = seeing(lambda: scope.workstation.feature)
    run = servo(scope.workstation, tracker, scope.home + AWAY, travel=400.0)
    assert run.reached.all()
    # This tracker makes no error, and the test moves are whole increments of the drive.
    np.testing.assert_allclose(run.jacobian, JACOBIAN, atol=1e-9)
    wrong = {"center": (1.0, 2.0), "covariance": -np.eye(2)}
    tracker.track = lambda frame: SimpleNamespace(lost=False, **wrong)
    reason = servo(scope.workstation, tracker, scope.home, travel=400.0).reason
    assert reason.startswith("ArgumentError: covariance must be positive semidefinite, got the")
    tracker.track = lambda frame: SimpleNamespace(lost=True)
    run = servo(scope.workstation, tracker, scope.home, travel=400.0)
    assert run.reason == "lost in the first frame"


def test_error_names_a_missing_device_method():
    names = {"stage": ("position", "move_to", "moving", "stop"), "clock": ("now", "sleep")}
    names["camera"] = ("snap",)
    for part, missing in ((name, one) for name in names for one in names[name]):
        parts = {name: SimpleNamespace(**dict.fromkeys(has, print)) for name, has in names.items()}
        delattr(parts[part], missing)
        with pytest.raises(ValueError, match=rf"must have {part}\.{missing}\(\), got Simple"):
            servo(SimpleNamespace(**parts), seeing(lambda: (0, 0)), (0, 0), travel=1.0)
    with pytest.raises(ValueError, match="tracker must have a method track, got int"):
        servo(scope_of().workstation, 3, (0, 0), travel=1.0)
