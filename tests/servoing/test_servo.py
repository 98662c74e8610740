"""The loop over a microscope: what it reaches, what it keeps to, and how it ends."""

import signal
import threading

import numpy as np
import pytest

from compendium.experiments.microscope import make_scope, turned
from microlib.servoing import Camera, OptimalController, Stage, path_metrics, servo
from microlib.servoing._log import COLUMNS
from tests.servoing.faults import engine_scope

JACOBIAN = turned(0.7, 0.25, mirrored=True)
AWAY = np.array([30.0, -25.0])
MISSING = "pymmcore-plus is not installed"


def scope_of(kind="simulated", seed=0, **options):
    if kind != "simulated":
        pytest.importorskip("pymmcore_plus", reason=MISSING)
    if kind == "demo":
        return make_scope(None)
    options = {"jacobian": JACOBIAN} | options
    return (engine_scope if kind == "engine" else make_scope)(seed, **options)


def steer(scope, targets, **options):
    """Steer from home by `targets` in px."""
    settings = {"travel": 400.0, "test_move": 40.0} | options
    return servo(scope.workstation, scope.tracker(), scope.home + targets, **settings)


@pytest.mark.parametrize("kind", ["simulated", "engine", "demo"])
def test_a_target_is_reached_and_every_frame_logged(kind):
    scope = scope_of(kind)
    run = steer(scope, AWAY, test_move=10.0)
    assert run.reached.all()
    assert run.still
    assert run.reason == ""
    np.testing.assert_allclose(scope.moved(), AWAY, atol=0.12)
    log = run.log
    assert {name: str(kind) for name, kind in log.dtypes.items()} == COLUMNS
    assert (np.diff(log["time_s"]) > 0).all()
    assert list(log["phase"].unique()) == ["start", "calibration", "servo", "end"]
    assert log["event"].iloc[-2:].tolist() == ["reached", "done"]
    seen = log[log["phase"] != "end"]
    assert np.isfinite(seen[["measured_x_px", "stage_x_um", "latency_s"]]).all(axis=None)
    # What was commanded is where the stage is seen next, to an increment of its drive.
    sent = seen[["command_x_um", "command_y_um"]].to_numpy()[:-1]
    stood = seen[["stage_x_um", "stage_y_um"]].to_numpy()[1:]
    np.testing.assert_allclose(stood[:8], sent[:8], atol=0.05)


def test_the_jacobian_is_the_true_one_within_its_uncertainty():
    for seed in range(5):
        scope = scope_of(seed=seed)
        run = steer(scope, AWAY)
        error = (run.jacobian - JACOBIAN).ravel()
        # χ² of 4 degrees of freedom is under 18.5 in 999 of 1000.
        assert error @ np.linalg.solve(run.jacobian_covariance, error) < 18.5
        np.testing.assert_allclose(run.jacobian, JACOBIAN, atol=0.005)


def test_drift_is_told_apart_from_the_stage():
    scope = scope_of(drift=(1.5, -0.5))
    run = steer(scope, AWAY)
    assert run.reached.all()
    np.testing.assert_allclose(run.jacobian, JACOBIAN, atol=0.005)
    # Over half a second of calibration 0.02 px of tracking know 0.1 px/s.
    np.testing.assert_allclose(run.drift, (1.5, -0.5), atol=0.25)


def test_a_path_is_followed():
    angle = np.linspace(0, 2 * np.pi, 60)
    circle = 20 * np.column_stack([np.cos(angle) - 1, np.sin(angle)])
    scope = scope_of(camera=Camera(interval=0.02, latency=0.015))
    run = steer(
        scope,
        circle,
        path=True,
    )
    assert run.reached.all()
    assert run.still
    log = run.log.query("phase == 'servo'")
    measured, wanted = (
        log[[f"{name}_x_px", f"{name}_y_px"]].to_numpy() for name in ("measured", "reference")
    )
    found = path_metrics(measured[5:], wanted[5:])
    assert found.accuracy < 0.1  # the tracker's, and that of the Jacobian over a step of 2.1 px


def test_a_controller_of_ones_own_moves_a_position_stage():
    scope = scope_of()
    law = OptimalController(
        JACOBIAN, interval=0.1, feature_weight=(1.0, 1.0), control_weight=(1e-4, 1e-4)
    )
    run = steer(scope, AWAY, jacobian=JACOBIAN, controller=law, interval=0.1)
    assert run.reached.all()
    assert np.isnan(run.jacobian_covariance).all()
    assert np.isnan(run.misfit)
    assert len(run.log) > 5  # it takes less than all of the error away in a step


def test_steps_and_travel_are_kept_to():
    scope = scope_of()
    run = steer(
        scope,
        AWAY,
        step=20.0,
        test_move=20.0,
        travel=170.0,
    )
    assert run.reached.all()
    way = np.hypot(*np.diff(run.log[["stage_x_um", "stage_y_um"]].to_numpy(), axis=0).T)
    assert way.max() < 20.0 * 1.02 + 0.1  # rounding of times, and two increments
    assert run.log["event"].str.contains("limit").sum() >= 5  # 39 px are 156 µm


def test_the_speed_of_a_position_stage_is_kept_to():
    scope = scope_of(stage=Stage(saturation=4000.0))
    run = steer(scope, AWAY, speed=100.0, interval=0.05)
    assert run.reached.all()
    log = run.log[run.log["phase"] != "end"]
    way = np.hypot(*np.diff(log[["stage_x_um", "stage_y_um"]].to_numpy(), axis=0).T)
    assert (way / np.diff(log["time_s"])).max() < 100.0 * 1.01


def test_a_controller_cannot_leave_the_travel():
    scope = scope_of(camera=Camera(interval=0.02, latency=0.015))
    run = steer(
        scope,
        AWAY,
        jacobian=JACOBIAN,
        interval=0.02,
        travel=170.0,
        controller=lambda k, measured, goals: np.array([-280.0, 90.0]),
    )
    assert "was not reached in 50 frames" in run.reason
    assert run.log["event"].str.contains("travel").any()
    farthest = run.log[["stage_x_um", "stage_y_um"]].abs().max()
    assert farthest.max() == pytest.approx(0.99 * 170.0, abs=1.0)
    assert farthest.max() < 170.0


def test_a_stage_that_runs_away_is_stopped_at_the_travel():
    scope = scope_of(stage=Stage(saturation=1000.0))
    stage = scope.workstation.stage
    move_to = stage.move_to
    stage.move_to = lambda position: move_to(100.0 * position)
    run = steer(scope, AWAY, travel=300.0)
    assert "the stage is beyond the travel" in run.reason
    # 1000 µm/s over the 2 ms between two questions.
    assert 300.0 < np.abs(stage.position()).max() < 303.0
    assert run.still


def test_a_target_beyond_the_travel_is_not_gone_to():
    scope = scope_of()
    run = steer(scope, [[10.0, 0.0], [200.0, 0.0]], travel=300.0)
    assert "target 1 is beyond the travel" in run.reason
    assert not run.reached.any()
    assert run.still
    np.testing.assert_array_equal(scope.workstation.stage.position(), 0.0)


def test_a_calibration_that_knows_too_little_is_refused():
    scope = scope_of(camera=Camera(interval=0.005, jitter=1.5))
    run = steer(scope, AWAY, test_move=8.0)  # 2 px
    assert "calibration refused" in run.reason
    assert "servo" not in run.log["phase"].to_numpy()
    assert run.jacobian_covariance.max() > 0


def test_a_second_run_can_take_over_the_jacobian():
    scope = scope_of()
    first = steer(scope, AWAY)
    second = servo(
        scope.workstation, scope.tracker(), scope.home, travel=400.0, jacobian=first.jacobian
    )
    assert "calibration" not in second.log["phase"].to_numpy()


def test_ctrl_c_is_raised_after_the_stop_and_python_has_its_handler_back():
    scope = scope_of()
    before = signal.getsignal(signal.SIGINT)

    def press(row):
        if row["phase"] == "servo":
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt) as caught:
        steer(scope, [[20.0, 0.0], [-20.0, 0.0]], progress=press)
    run = caught.value.run
    assert run.reason == "interrupted by the user" == run.log["event"].iloc[-1]
    assert run.still
    assert not run.reached.all()
    assert signal.getsignal(signal.SIGINT) is before


def test_it_runs_in_a_thread_that_no_signal_reaches():
    runs = []
    thread = threading.Thread(target=lambda: runs.append(steer(scope_of(), AWAY)))
    thread.start()
    thread.join(timeout=20.0)
    assert runs[0].reached.all()


def test_a_feature_lost_for_a_frame_is_waited_for():
    scope = scope_of()
    tracker, camera, count = scope.tracker(), scope.workstation.camera, []

    class Blinking:
        def snap(self):
            frame, exposed = camera.snap()
            count.append(exposed)
            return (0 * frame if len(count) in (10, 11) else frame), exposed

    scope.workstation.camera = Blinking()
    run = servo(scope.workstation, tracker, scope.home + AWAY, travel=400.0, test_move=40.0)
    assert run.reached.all()
    lost = run.log[run.log["lost"]]
    assert len(lost) == 2
    assert lost[["command_x_um", "measured_x_px"]].isna().all(axis=None)
    assert lost["event"].str.len().min() > 0


def test_a_feature_lost_for_good_ends_the_run_after_three_frames():
    scope = scope_of()
    tracker, snap = scope.tracker(), scope.workstation.camera.snap
    scope.workstation.camera.snap = lambda: (np.zeros((240, 320)), snap()[1])
    run = servo(scope.workstation, tracker, scope.home, travel=400.0, jacobian=JACOBIAN)
    assert run.reason.startswith("lost: ")
    assert run.reason.endswith("in the first frame")
    assert run.log["phase"].tolist() == ["start", "end"]

    class Covered:
        frames = 0

        def track(self, frame):
            self.frames += 1
            return tracker.track(frame if self.frames == 1 else 0 * frame)

    scope.workstation.camera.snap = snap
    run = servo(scope.workstation, Covered(), scope.home + AWAY, travel=400.0, jacobian=JACOBIAN)
    assert run.log["lost"].sum() == 3
    assert run.reason.endswith("in 3 frames in a row")


def test_targets_must_be_points():
    with pytest.raises(ValueError, match="targets must have shape"):
        servo(scope_of().workstation, Still((0, 0)), np.zeros((2, 3)), travel=400.0)


# --- How a run ends, and that it says why -------------------------------------------------------


class Still:
    """A tracker that always answers alike, as on a frozen picture."""

    def __init__(self, center, **more):
        self.answer = {"center": np.asarray(center, float), "lost": False, **more}

    def track(self, frame):
        return type("Track", (), self.answer)()


def test_an_image_that_does_not_follow_ends_the_run():
    scope = scope_of()
    away = AWAY / 3  # three such moves stay in the picture
    run = servo(
        scope.workstation, Still(scope.home), scope.home + away, travel=800.0, jacobian=JACOBIAN,
        tolerance=0.2,
    )  # fmt: skip
    assert run.reason.startswith("the image does not follow the stage: 3 moves in a row were off")
    assert "the last [0. 0.] px instead of [" in run.reason
    assert run.still
    assert not run.reached.any()
    # Three moves by what J says that is missing.
    assert "instead of [10.   -8.33] px" in run.reason
    assert run.log["phase"].tolist() == ["start"] + ["servo"] * 4 + ["end"]


def test_two_bad_tracks_are_no_image_that_does_not_follow():
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


def test_a_stage_that_stays_where_it_is_ends_the_run():
    scope = scope_of()
    scope.workstation.stage.move_to = lambda position: None
    run = steer(scope, AWAY)
    assert run.reason == (
        "the stage did not go where it was sent: it stands at [0. 0.] µm instead of [40.  0.] µm"
    )
    assert run.log["phase"].tolist() == ["start", "end"]
    assert np.isnan(run.jacobian).all()
    assert np.isnan(run.drift).all()


def test_a_move_that_lasts_longer_than_the_time_out_is_not_begun():
    scope = scope_of()
    run = steer(scope, AWAY, speed=1.0, timeout=10.0)
    assert run.reason == "a move of 40 µm at 1 µm/s takes longer than 10 s"
    np.testing.assert_array_equal(scope.workstation.stage.position(), 0.0)


@pytest.mark.parametrize("answer", [[1.0], [np.nan, 0.0], [1.0, 2.0, 3.0], [[0.0, 0.0]]])
def test_a_controller_must_give_two_velocities(answer):
    run = steer(scope_of(), AWAY, jacobian=JACOBIAN, controller=lambda *_: np.array(answer))
    assert run.reason.startswith("the controller must give two finite velocities, got [")
    assert run.still


def test_what_the_tracker_raises_is_the_reason_and_kept():
    scope = scope_of()

    class Broken:
        def track(self, frame):
            raise ZeroDivisionError("no gradient")

    run = servo(scope.workstation, Broken(), scope.home, travel=400.0)
    assert run.reason == "ZeroDivisionError: no gradient"
    assert isinstance(run.error, ZeroDivisionError)
    assert run.still
    assert run.log["event"].iloc[-1] == run.reason


def test_a_tracker_without_reason_or_covariance_will_do():
    scope = scope_of()

    class Plain:
        def track(self, frame):
            feature = scope.workstation.feature
            return type("Track", (), {"center": feature, "lost": False})()

    run = servo(scope.workstation, Plain(), scope.home + AWAY, travel=400.0)
    assert run.reached.all()
    # Exact but for the focus and the increments of the drive.
    np.testing.assert_allclose(run.jacobian, JACOBIAN, atol=0.005)

    class Blind:
        def track(self, frame):
            return type("Track", (), {"center": None, "lost": True})()

    run = servo(scope.workstation, Blind(), scope.home, travel=400.0)
    assert run.reason == "lost: lost in the first frame"


def test_a_jacobian_that_is_given_leaves_the_rest_unknown():
    run = steer(scope_of(), AWAY, jacobian=JACOBIAN)
    np.testing.assert_array_equal(run.jacobian, JACOBIAN)
    assert run.jacobian_covariance.shape == (4, 4)
    assert run.drift.shape == (2,)
    assert np.isnan(run.jacobian_covariance).all()
    assert np.isnan(run.drift).all()
    assert np.isnan(run.misfit)


@pytest.mark.parametrize(
    "missing", ["snap", "position", "move_to", "moving", "stop", "now", "sleep"]
)
def test_a_method_that_is_missing_is_named(missing):
    methods = {
        "camera": ("snap",),
        "stage": ("position", "move_to", "moving", "stop"),
        "clock": ("now", "sleep"),
    }
    parts = {
        part: type(part, (), {name: lambda self: None for name in names if name != missing})()
        for part, names in methods.items()
    }
    part = next(part for part, names in methods.items() if missing in names)
    broken = type("Broken", (), parts)()
    with pytest.raises(ValueError, match=rf"must have {part}\.{missing}\(\), got Broken"):
        servo(broken, Still((0, 0)), (0, 0), travel=1.0)
    with pytest.raises(ValueError, match="tracker must have a method track, got int"):
        servo(scope_of().workstation, 3, (0, 0), travel=1.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"travel": (1.0, 2.0, 3.0)}, "travel must have shape"),
        ({"test_move": 500.0}, "test_move must lie within travel and step, 396 µm, got 500"),
        ({"test_move": 50.0, "step": 20.0}, "test_move must lie within travel and step, 20 µm"),
        ({"jacobian": np.ones((2, 2))}, "jacobian must have full rank"),
        ({"interval": 1e9}, "interval must be at most"),
        ({"most_frames": 0}, "most_frames must be a whole number"),
    ],
)
def test_wrong_arguments_are_refused_before_anything_moves(options, message):
    scope = scope_of()
    with pytest.raises(ValueError, match=message):
        steer(scope, AWAY, **options)
    assert not scope.workstation.stage.position().any()
