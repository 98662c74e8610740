"""The laws of every public name of `microlib.servoing`."""

from types import SimpleNamespace

import numpy as np
import pytest

from microlib import servoing
from tests.laws import GOES_ON, NUMBER, SAME, VIEWS, Row, TestedBy, Units, laws_of, px, s, um
from tests.servoing import test_micromanager

#: px/µm of a camera that is turned and mirrored and whose pixels are not square.
J = np.array([[0.08, -0.31], [-0.24, -0.11]])
Q, L = np.array([[0.9, 0.2], [0.2, 1.4]]), np.array([[3e-6, -1e-6], [-1e-6, 8e-6]])
#: A step of 30 px right and 20 px up, and a response to it that overshoots.
STEP = np.array([30.0, -20.0])
ANSWER = 1 - np.exp(-np.arange(25.0) / 4) * np.cos(np.arange(25.0) / 2)
PATH = np.cumsum(np.random.default_rng(3).normal([1.0, -0.6], 0.8, (30, 2)), axis=0)


def weighted(u) -> dict:
    """Return the arguments of a controller; L has the unit that its docstring says."""
    return {
        "jacobian": J * u.px / u.um,
        "interval": 0.03 * u.s,
        "feature_weight": Q,
        "control_weight": L * (u.px * u.s / u.um) ** 2,
    }


def sample(u) -> dict:
    origin = np.array([u.x0, u.y0])
    return {"k": 2, "measured": origin + STEP * u.px, "reference": origin + PATH * u.px}


def stage(u) -> servoing.StageModel:
    return servoing.StageModel(400.0 * u.um / u.s, increment=0.07 * u.um, travel=900.0 * u.um)


def camera(u) -> servoing.CameraTiming:
    return servoing.CameraTiming(0.03 * u.s, latency=0.04 * u.s, jitter=0.2 * u.px)


def begun(u) -> servoing.SimulatedWorkstation:
    """Return a workstation with the clock and the stage not at zero."""
    drift = np.array([0.7, -0.4]) * u.px / u.s
    away = J @ [u.x0_um, u.y0_um] * u.px / u.um
    found = servoing.SimulatedWorkstation(
        lambda feature: np.zeros((9, 9)),
        jacobian=J * u.px / u.um,
        stage=servoing.StageModel(400.0 * u.um / u.s, increment=0.0, travel=9000.0 * u.um),
        camera=servoing.CameraTiming(0.03 * u.s, latency=0.01 * u.s),
        rng=0,
        home=np.array([u.x0, u.y0]) - away - drift * u.t0,
        drift=drift,
    )
    found.clock.sleep(u.t0)
    found.stage.move_to(np.array([u.x0_um, u.y0_um]))
    found.clock.sleep(100.0 * u.s)  # until it is there
    found._now = u.t0
    return found


def driven(u, workstation) -> tuple:
    """Return what a workstation reports during a move."""
    stage, clock = workstation.stage, workstation.clock
    stage.move_to(stage.position() + np.array([50.0, -20.0]) * u.um)
    clock.sleep(0.1 * u.s)
    exposed = [workstation.camera.snap()[1] for _ in range(3)]
    return stage.position(), clock.now(), exposed, workstation.feature


def seeing(workstation, lost=()) -> SimpleNamespace:
    """Return a tracker that finds the feature to 0.02 px, except in the frames `lost`."""
    rng, frames = np.random.default_rng(1), iter(range(999))
    noise = rng.normal(0.0, 0.02, (999, 2))

    def track(frame):
        number = next(frames)
        workstation.clock.sleep(0.004 * (number % 5 == 0))  # now and then it takes longer
        center = workstation.feature + noise[number]
        return SimpleNamespace(center=center, lost=number in lost, covariance=4e-4 * np.eye(2))

    return SimpleNamespace(track=track)


def steered(u) -> dict:
    workstation = begun(u)
    return {
        "workstation": workstation,
        "tracker": seeing(workstation),
        "targets": np.array([u.x0, u.y0]) + np.array([STEP, -STEP]),
        "travel": np.array([400.0, 500.0]) * u.um,
        "test_move": 41.0 * u.um,  # its time is no multiple of the 2 ms between two polls
        "longest_move": 70.0 * u.um,
        "tolerance": 0.1,
    }


XY = px.counted_from("x0", "y0")
LOG = {
    **dict.fromkeys(("phase", "target", "lost", "event"), SAME),
    **{f"{n}_{a}_px": px.counted_from(f"{a}0") for n in ("reference", "measured") for a in "xy"},
    **{f"{n}_{a}_um": um.counted_from(f"{a}0_um") for n in ("stage", "command") for a in "xy"},
    **dict.fromkeys(("time_s", "latency_s"), s),
}
METRICS = {"accuracy": px, "precision": px}

LAWS = {
    "servoing.CameraTiming": Row(lambda u: {"interval": 0.03 * u.s, "latency": 0.05 * u.s,
        "jitter": 0.1 * u.px}, {"interval": s, "latency": s, "jitter": px}),
    "servoing.StageModel": Row(lambda u: vars(stage(u)), {"saturation": um / s, "increment": um,
        "travel": um}),
    "servoing.StageModel.rounded": Row(lambda u: {"self": stage(u),
        "position": np.array([1.23, -45.6]) * u.um}, um),
    "servoing.MicroManager": TestedBy(
        test_micromanager.test_stage_of_micromanager_is_the_xy_stage_of_the_core,
        test_micromanager.test_time_of_a_frame_is_the_middle_of_its_exposure,
    ),
    "servoing.OptimalController": Row(weighted, {"gain": um / s / px}),
    "servoing.OptimalController.__call__": Row(
        lambda u: {"self": servoing.OptimalController(**weighted(u)), **sample(u)}, um / s),
    "servoing.SimulatedWorkstation": Row(lambda u: {"u": u, "workstation": begun(u)},
        (um.counted_from("x0_um", "y0_um"), s.counted_from("t0"), s.counted_from("t0"), XY),
        laws=GOES_ON, call=driven),
    "servoing.ibvs_control": Row(lambda u: {"jacobian": J * u.px / u.um, "error": STEP * u.px,
        "gain": 0.5 / u.s, "drift": np.array([0.7, -0.4]) * u.px / u.s}, um / s),
    "servoing.loop_poles": Row(lambda u: {"gain": 0.4, "delay": 1.3 * u.s / u.s}, NUMBER),
    "servoing.optimal_control": Row(lambda u: {**weighted(u), "feature": np.array([u.x0, u.y0]),
        "target": np.array([u.x0, u.y0]) + STEP * u.px}, um / s),
    "servoing.path_metrics":
        Row(lambda u: {"position": np.array([u.x0, u.y0]) + (PATH + 0.1 * PATH[::-1]) * u.px,
        "reference": np.array([u.x0, u.y0]) + PATH * u.px}, METRICS | {"largest": px}),
    "servoing.point_jacobian": Row(lambda u: {"points": PATH[:3] * u.px,
        "depth": np.array([300.0, 350.0, 280.0]) * u.um, "magnification": 6.4,
        "pixel_pitch": np.array([9.9, 8.3]) * u.um / u.px},
        [px / um, px / um, px / um, px, px, px]),
    "servoing.servo": Row(steered,
        {**dict.fromkeys(("reached", "reason", "still", "error"), SAME), "log": LOG,
        **LOG, "jacobian": px / um, "jacobian_covariance": px**2 / um**2, "drift": px / s,
        # px and s are fixed by the frames and by the interval at which devices are polled
        "reduced_chi2": NUMBER}, laws=GOES_ON, fixed=("px", "s")),
    "servoing.simulate": Row(lambda u: {"controller": servoing.OptimalController(**weighted(u)),
        "reference": np.array([u.x0, u.y0]) + PATH * u.px, "jacobian": 1.1 * J * u.px / u.um,
        "stage": stage(u), "camera": camera(u), "rng": 0,
        "start": np.array([u.x0, u.y0]) - STEP * u.px},
        {**dict.fromkeys(("reference", "feature", "measured"), XY), "time": s, "position": um,
        "command": um / s, "saturated": SAME}),
    "servoing.step_metrics": Row(lambda u: {"time": u.t0 + np.arange(25.0) ** 1.1 * u.s,
        "position": np.array([u.x0, u.y0]) + ANSWER[:, None] * STEP * u.px,
        "target": np.array([u.x0, u.y0]) + STEP * u.px, "band": 0.04},
        METRICS | {"settling_time": s, "overshoot": NUMBER}),
}  # fmt: skip


@pytest.mark.parametrize(("law", "name"), laws_of(LAWS))
def test_law_holds(law, name):
    law(name, LAWS[name])


@pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.name)
def test_stage_motion_follows_rotation_of_camera(view):
    turn = view.matrix
    plain = {"interval": 0.03, "control_weight": L}
    control = servoing.OptimalController(J, feature_weight=Q, **plain)
    other = servoing.OptimalController(turn @ J, feature_weight=view.covariance(Q), **plain)
    np.testing.assert_allclose(other.gain @ turn, control.gain, rtol=1e-9)
    loop = {
        "stage": servoing.StageModel(400.0),
        "camera": servoing.CameraTiming(0.03, latency=0.04),
        "rng": 0,
    }
    runs = [
        servoing.simulate(c, m @ STEP + PATH @ m.T, jacobian=m @ J, start=m @ [12.0, -5.0], **loop)
        for c, m in ((control, np.eye(2)), (other, turn))
    ]
    np.testing.assert_allclose(runs[1].feature, view.vectors(runs[0].feature), atol=1e-9)
    np.testing.assert_allclose(runs[1].position, runs[0].position, atol=1e-9)


@pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.name)
def test_step_metrics_follow_rotation_of_axes(view):
    given = LAWS["servoing.step_metrics"].arguments(Units())
    given["position"] += np.exp(-np.arange(25.0) / 4)[:, None] * [5.0, 2.0]  # off the line
    turned = {name: view.vectors(given[name]) for name in ("position", "target")}
    plain = vars(servoing.step_metrics(**given))
    assert 0 < plain["settling_time"] < given["time"][-1] - given["time"][0]
    assert vars(servoing.step_metrics(**given | turned)) == pytest.approx(plain)


@pytest.mark.parametrize("seed", range(6))
def test_run_ends_after_three_lost_frames_in_a_row(seed):
    """The run goes on after one or two lost frames, wherever they are."""
    lost = np.random.default_rng(seed).random(200) < 0.45
    lost[0] = False  # the first frame precedes the phase "servo"
    workstation = begun(Units())
    tracker = seeing(workstation, np.flatnonzero(lost))
    given = {"jacobian": J, "travel": 400.0, "longest_move": 6.0}
    run = servoing.servo(workstation, tracker, workstation.feature + STEP, **given, tolerance=0.2)
    seen = run.log.loc[run.log["phase"] == "servo", "lost"].to_numpy()
    end = len(seen)
    np.testing.assert_array_equal(seen, lost[1 : end + 1])
    ends = np.flatnonzero(np.convolve(seen, np.ones(3))[:end] == 3)
    assert ends.tolist() in ([], [end - 1])
    assert run.reached.all() == (run.reason == "") == (len(ends) == 0)
    rows = run.log[run.log["lost"]]
    assert len(rows) == seen.sum()
    assert rows[["command_x_um", "measured_x_px"]].isna().all(axis=None)
    assert np.ptp(run.log["latency_s"].dropna()) > 0.003


def test_relative_error_of_the_jacobian_remains_after_a_move():
    workstation = begun(Units())
    targets = workstation.feature + STEP
    given = {"jacobian": 1.25 * J, "travel": 400.0, "tolerance": 0.5}
    log = servoing.servo(workstation, seeing(workstation), targets, **given).log
    seen = log.loc[log["phase"] == "servo", ["measured_x_px", "measured_y_px"]].to_numpy()
    left = np.linalg.norm(targets - seen, axis=1)
    assert left[1] / left[0] == pytest.approx(1 - 1 / 1.25, abs=0.06)  # drift and noise
