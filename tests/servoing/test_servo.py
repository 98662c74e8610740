"""The loop over a microscope: what it reaches, what it keeps to, and how it ends."""

import os
import signal
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from compendium.experiments.microscope import make_scope, turned
from microlib.servoing import Camera, Stage, servo

JACOBIAN = turned(0.7, 0.25, mirrored=True)
AWAY = np.array([30.0, -25.0])


def scope_of(seed=0, **options):
    return make_scope(seed, **{"jacobian": JACOBIAN} | options)


def steer(scope, targets, **options):
    """Steer from home by `targets` in px."""
    settings = {"travel": 400.0, "test_move": 40.0} | options
    return servo(scope.workstation, scope.tracker(), scope.home + targets, **settings)


@pytest.mark.parametrize("kind", ["simulated", "demo of the engine"])
def test_targets_are_reached_and_every_frame_is_logged(kind):
    if kind != "simulated":
        pytest.importorskip("pymmcore_plus", reason="pymmcore-plus is not installed")
    scope = scope_of() if kind == "simulated" else make_scope(None)
    run = steer(scope, AWAY, test_move=10.0)
    assert run.reached.all()
    assert run.still
    assert run.reason == ""
    np.testing.assert_allclose(scope.moved(), AWAY, atol=0.12)
    log = run.log
    others = {"phase": object, "target": np.int64, "lost": bool, "event": object}
    assert all(kind == others.get(name, np.float64) for name, kind in log.dtypes.items())
    assert (np.diff(log["time_s"]) > 0).all()
    assert list(log["phase"].unique()) == ["start", "calibration", "servo", "end"]
    assert log["event"].iloc[-2:].tolist() == ["reached", "done"]
    seen = log[log["phase"] != "end"]
    assert np.isfinite(seen[["measured_x_px", "stage_x_um", "latency_s"]]).all(axis=None)
    # Both ways along both axes, so that a drift is told apart.
    tried = log.loc[log["phase"] == "calibration", ["stage_x_um", "stage_y_um"]]
    np.testing.assert_allclose([tried.min(), tried.max()], [[-10.0] * 2, [10.0] * 2], atol=0.05)
    # What was commanded is where the stage is seen next, to an increment of its drive.
    sent = seen[["command_x_um", "command_y_um"]].to_numpy()[:-1]
    stood = seen[["stage_x_um", "stage_y_um"]].to_numpy()[1:]
    np.testing.assert_allclose(stood[:8], sent[:8], atol=0.05)


def test_calibrated_jacobian_and_drift_agree_with_truth_within_uncertainty():
    for seed in range(5):
        scope = scope_of(seed=seed, drift=(1.5, -0.5) if seed == 4 else (0, 0))
        run = steer(scope, AWAY)
        error = (run.jacobian - JACOBIAN).ravel()
        # χ² of 4 degrees of freedom is under 18.5 in 999 of 1000.
        assert error @ np.linalg.solve(run.jacobian_covariance, error) < 18.5
        np.testing.assert_allclose(run.jacobian, JACOBIAN, atol=0.005)
    # Over half a second of calibration 0.02 px of tracking know 0.1 px/s.
    np.testing.assert_allclose(run.drift, (1.5, -0.5), atol=0.25)
    again = steer(scope, AWAY, jacobian=run.jacobian)
    assert again.reached.all()
    assert "calibration" not in again.log["phase"].to_numpy()
    for unknown in (again.jacobian_covariance, again.drift, again.misfit):
        assert np.isnan(unknown).all()


def test_an_uncertain_calibration_is_rejected():
    run = steer(scope_of(camera=Camera(interval=0.005, jitter=1.5)), AWAY, test_move=8.0)  # 2 px
    assert "calibration rejected" in run.reason
    assert "servo" not in run.log["phase"].to_numpy()
    assert run.jacobian_covariance.max() > 0


def test_moves_stay_within_step_and_travel():
    run = steer(scope_of(), AWAY, step=20.0, test_move=20.0, travel=170.0)
    assert run.reached.all()
    way = np.hypot(*np.diff(run.log[["stage_x_um", "stage_y_um"]].to_numpy(), axis=0).T)
    assert way.max() < 20.0 * 1.02 + 0.1  # rounding of times, and two increments
    assert run.log["event"].str.contains("limit").sum() >= 5  # 39 px are 156 µm
    # A Jacobian that is too small moves the stage too far: by 312 µm from one target to the other.
    near = 0.7 * np.array(AWAY)
    run = steer(scope_of(), [near, -near], travel=170.0, jacobian=0.7 * JACOBIAN)
    assert run.reached.all()
    assert run.log["event"].str.contains("travel").any()
    farthest = run.log[["stage_x_um", "stage_y_um"]].abs().max().max()
    assert farthest == pytest.approx(0.99 * 170.0, abs=1.0)


def test_stage_beyond_the_travel_is_stopped():
    scope = scope_of(stage=Stage(saturation=1000.0))
    stage = scope.workstation.stage
    move_to = stage.move_to
    stage.move_to = lambda position: move_to(100.0 * position)
    run = steer(scope, AWAY, travel=300.0)
    assert "the stage is beyond the travel" in run.reason
    # 1000 µm/s over the 2 ms between two questions.
    assert 300.0 < np.abs(stage.position()).max() < 303.0
    assert run.still


def test_a_target_beyond_the_travel_ends_the_run_before_any_move():
    scope = scope_of()
    run = steer(scope, [[10.0, 0.0], [200.0, 0.0]], travel=300.0)
    assert "target 1 is beyond the travel" in run.reason
    assert not run.reached.any()
    assert run.still
    np.testing.assert_array_equal(scope.workstation.stage.position(), 0.0)


def test_servo_runs_outside_the_main_thread():
    runs = []
    thread = threading.Thread(target=lambda: runs.append(steer(scope_of(), AWAY)))
    thread.start()
    thread.join(timeout=20.0)
    assert runs[0].reached.all()


@pytest.mark.parametrize("between", [0.02, 0.1, 0.2])
def test_second_interrupt_keeps_the_run_and_the_stage_is_stopped(between):
    scope = scope_of(stage=Stage(saturation=100.0))
    calls = {"stop": 0, "move_to": 0}
    stage = scope.workstation.stage

    def counted(name, call):
        def counting(*arguments):
            calls[name] += 1
            return call(*arguments)

        return counting

    for name in calls:
        setattr(stage, name, counted(name, getattr(stage, name)))
    moves = []

    def press(row):
        if row["target"] == 0 and not moves:
            moves.append(calls["move_to"])
            os.kill(os.getpid(), signal.SIGINT)
            again = threading.Timer(between, os.kill, (os.getpid(), signal.SIGINT))
            again.start()

    with pytest.raises(KeyboardInterrupt) as caught:
        steer(scope, AWAY, step=20.0, test_move=20.0, progress=press)
    assert caught.value.run.reason == "interrupted by the user"
    assert caught.value.run.still
    assert len(caught.value.run.log) > 8
    assert calls["stop"] >= 1
    assert calls["move_to"] == moves[0]
    where = stage.position()
    scope.workstation.clock.sleep(1.0)
    np.testing.assert_array_equal(stage.position(), where)


# --- How a run ends, and that it says why -------------------------------------------------------


class Still:
    """A tracker that always answers alike, as on a frozen picture."""

    def __init__(self, center, **more):
        self.answer = {"center": np.asarray(center, float), "lost": False, **more}

    def track(self, frame):
        return type("Track", (), self.answer)()


def test_run_ends_after_three_moves_that_the_image_does_not_follow():
    scope = scope_of()
    away = AWAY / 3  # three such moves stay in the picture
    given = {"travel": 800.0, "jacobian": JACOBIAN, "tolerance": 0.2}
    run = servo(scope.workstation, Still(scope.home), scope.home + away, **given)
    assert run.reason.startswith("the image does not follow the stage: 3 moves in a row were off")
    # Three moves by what J says that is missing.
    assert "the last [0. 0.] px instead of [10.   -8.33] px" in run.reason
    assert run.log["phase"].tolist() == ["start"] + ["servo"] * 4 + ["end"]


def test_two_wrong_tracks_do_not_end_the_run():
    scope = scope_of()
    tracker, bad = scope.tracker(), iter([0, 0, 1, 1, 0, 1, 1] + [0] * 20)

    class Wrong:
        def track(self, frame):
            track = tracker.track(frame)
            return Still(track.center + 60.0).track(frame) if next(bad) else track

    run = servo(
        scope.workstation, Wrong(), scope.home + AWAY, travel=500.0, jacobian=JACOBIAN, step=60.0
    )
    assert run.reached.all()
    assert run.reason == ""


def test_tracker_needs_neither_reason_nor_covariance():
    scope = scope_of()
    answer = {"lost": False, "center": property(lambda _: scope.workstation.feature)}
    plain = type("Plain", (), {"track": lambda self, frame: type("Track", (), answer)()})()
    run = servo(scope.workstation, plain, scope.home + AWAY, travel=400.0)
    assert run.reached.all()
    # Exact but for the focus and the increments of the drive.
    np.testing.assert_allclose(run.jacobian, JACOBIAN, atol=0.005)
    answer["lost"] = True
    run = servo(scope.workstation, plain, scope.home, travel=400.0)
    assert run.reason == "lost: lost in the first frame"


def test_error_names_a_missing_device_method():
    names = {"stage": ("position", "move_to", "moving", "stop"), "clock": ("now", "sleep")}
    names["camera"] = ("snap",)
    for part, missing in ((name, one) for name in names for one in names[name]):
        parts = {name: SimpleNamespace(**dict.fromkeys(has, print)) for name, has in names.items()}
        delattr(parts[part], missing)
        with pytest.raises(ValueError, match=rf"must have {part}\.{missing}\(\), got Simple"):
            servo(SimpleNamespace(**parts), Still((0, 0)), (0, 0), travel=1.0)
    with pytest.raises(ValueError, match="tracker must have a method track, got int"):
        servo(scope_of().workstation, 3, (0, 0), travel=1.0)


def test_invalid_arguments_raise_before_any_move():
    scope = scope_of()
    for options, message in (
        ({"test_move": 500.0}, "test_move must be at most 396, got 500"),
        ({"test_move": 50.0, "step": 20.0}, "test_move must be at most 20, got 50"),
        ({"jacobian": np.ones((2, 2))}, "jacobian must have full rank"),
    ):
        given = {"targets": (0, 0), "travel": 400.0} | options
        with pytest.raises(ValueError, match=message):
            servo(scope.workstation, Still((0, 0)), **given)
    assert not scope.workstation.stage.position().any()
