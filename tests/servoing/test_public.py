"""The calls of every public function of servoing: their units, their axes and what they refuse."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from microlib import servoing
from microlib.servoing import CameraTiming, OptimalController, SimulatedWorkstation, StageModel
from tests.checks import (
    NEGATIVE,
    NOT_POSITIVE,
    Wrong,
    each_view,
    hold_call,
    hold_refused,
    hold_scaled,
    no_array,
    not_finite,
    not_real,
)

#: px/µm of a camera that is turned and mirrored and whose pixels are not square.
J = np.array([[0.08, -0.31], [-0.24, -0.11]])
Q, L = np.array([[0.9, 0.2], [0.2, 1.4]]), np.array([[3e-6, -1e-6], [-1e-6, 8e-6]])
#: A step of 30 px right and 20 px up, and a response to it that overshoots.
STEP = np.array([30.0, -20.0])
ANSWER = 1 - np.exp(-np.arange(25.0) / 4) * np.cos(np.arange(25.0) / 2)
PATH = np.cumsum(np.random.default_rng(3).normal([1.0, -0.6], 0.8, (30, 2)), axis=0)
#: Origins of pixels, of the stage and of time.
PLACE, STAND, T0 = np.array([12.0, -5.0]), np.array([310.0, -140.0]), 3.7


def weighted(um: float = 1.0, px: float = 1.0, s: float = 1.0) -> dict:
    """Return the arguments of a controller; L has the unit that its docstring says."""
    return {
        "jacobian": J * px / um,
        "interval": 0.03 * s,
        "feature_weight": Q.copy(),
        "control_weight": L * (px * s / um) ** 2,
    }


def stage(um: float = 1.0, s: float = 1.0) -> StageModel:
    return StageModel(400.0 * um / s, increment=0.07 * um, travel=900.0 * um)


def begun(
    um: float = 1.0, *, place: np.ndarray = PLACE, stand: np.ndarray = STAND, t0: float = T0
) -> SimulatedWorkstation:
    """Return a workstation with the clock and the stage not at zero."""
    drift = np.array([0.7, -0.4])
    found = SimulatedWorkstation(
        lambda feature: np.zeros((9, 9)), jacobian=J / um, drift=drift, rng=0,
        stage=StageModel(400.0 * um, increment=0.0, travel=9000.0 * um),
        camera=CameraTiming(0.03, latency=0.01), home=place - J @ stand - drift * t0,
    )  # fmt: skip
    found.stage.move_to(stand * um)
    found.clock.sleep(100.0)  # until it is there
    found._now = t0
    return found


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


def steered(
    um: float = 1.0, *, place: np.ndarray = PLACE, stand: np.ndarray = STAND, t0: float = T0
) -> dict:
    workstation = begun(um, place=place, stand=stand, t0=t0)
    return {
        "workstation": workstation,
        "tracker": seeing(workstation),
        "targets": place + np.array([STEP, -STEP]),
        "travel": np.array([400.0, 500.0]) * um,
        "test_move": 41.0 * um,  # its time is no multiple of the 2 ms between two polls
        "longest_move": 70.0 * um,
        "tolerance": 0.1,
    }


#: A valid call of each function, in any units.
CALLS = {
    CameraTiming: lambda um=1.0, px=1.0, s=1.0: {
        "interval": 0.03 * s, "latency": 0.05 * s, "jitter": 0.1 * px,
    },
    StageModel: lambda um=1.0, px=1.0, s=1.0: vars(stage(um, s)),
    StageModel.rounded: lambda um=1.0, px=1.0, s=1.0: {
        "self": stage(um, s), "position": np.array([1.23, -45.6]) * um,
    },
    OptimalController: weighted,
    OptimalController.__call__: lambda um=1.0, px=1.0, s=1.0: {
        "self": OptimalController(**weighted(um, px, s)), "k": 2, "measured": (PLACE + STEP) * px,
        "reference": (PLACE + PATH) * px,
    },
    servoing.ibvs_control: lambda um=1.0, px=1.0, s=1.0: {
        "jacobian": J * px / um, "error": STEP * px, "gain": 0.5 / s,
        "drift": np.array([0.7, -0.4]) * px / s,
    },
    servoing.loop_poles: lambda um=1.0, px=1.0, s=1.0: {"gain": 0.4, "delay": 1.3},
    servoing.optimal_control: lambda um=1.0, px=1.0, s=1.0: {
        **weighted(um, px, s), "feature": PLACE * px, "target": (PLACE + STEP) * px,
    },
    servoing.path_metrics: lambda um=1.0, px=1.0, s=1.0: {
        "position": (PLACE + PATH + 0.1 * PATH[::-1]) * px, "reference": (PLACE + PATH) * px,
    },
    servoing.point_jacobian: lambda um=1.0, px=1.0, s=1.0: {
        "points": PATH[:3] * px, "depth": np.array([300.0, 350.0, 280.0]) * um,
        "magnification": 6.4, "pixel_pitch": np.array([9.9, 8.3]) * um / px,
    },
    servoing.simulate: lambda um=1.0, px=1.0, s=1.0: {
        "controller": OptimalController(**weighted(um, px, s)), "reference": (PLACE + PATH) * px,
        "jacobian": 1.1 * J * px / um, "stage": stage(um, s),
        "camera": CameraTiming(0.03 * s, latency=0.04 * s, jitter=0.2 * px), "rng": 0,
        "start": (PLACE - STEP) * px,
    },
    servoing.step_metrics: lambda um=1.0, px=1.0, s=1.0: {
        "time": (T0 + np.arange(25.0) ** 1.1) * s,
        "position": (PLACE + ANSWER[:, None] * STEP) * px, "target": (PLACE + STEP) * px,
        "band": 0.04,
    },
}  # fmt: skip
each_call = pytest.mark.parametrize("function", CALLS, ids=lambda f: f.__qualname__)
#: Other units, in which most numbers are below 1, and those of the results in them.
UM, PX, S = 0.0007, 0.006, 0.9
METRICS = {"accuracy": PX, "precision": PX}
FACTORS = {
    CameraTiming: {"interval": S, "latency": S, "jitter": PX},
    StageModel: {"saturation": UM / S, "increment": UM, "travel": UM},
    servoing.path_metrics: METRICS | {"largest": PX},
    servoing.simulate: {
        **dict.fromkeys(("reference", "feature", "measured"), PX),
        **{"time": S, "position": UM, "command": UM / S},
    },
    servoing.step_metrics: METRICS | {"settling_time": S},
    servoing.point_jacobian: {"factor": np.array([PX / UM] * 3 + [PX] * 3)},
    servoing.loop_poles: {}, StageModel.rounded: {"factor": UM},
}  # fmt: skip
OTHER = [None, 5]  # of another type
SINGULAR = [[[1.0, 2.0], [2.0, 4.0]], np.zeros((2, 2))]


def no_jacobian(valid):
    return [*no_array(valid), *SINGULAR]


def no_weight(valid):
    return [*no_array(valid), (0.9, 0.0), [[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.2], [0.1, 1.0]]]


#: What is refused in place of each argument.
REFUSED = {
    CameraTiming: {"latency": NEGATIVE, "jitter": NEGATIVE}, StageModel: {"increment": NEGATIVE},
    StageModel.rounded: {"position": not_finite},
    OptimalController: {
        "jacobian": no_jacobian, "feature_weight": no_weight, "control_weight": no_weight,
    },
    OptimalController.__call__: {
        "k": [*NEGATIVE, 1.5], "measured": lambda valid: [*not_real(valid), Wrong(3.0)],
    },
    servoing.ibvs_control: {"jacobian": no_jacobian}, servoing.loop_poles: {"delay": NEGATIVE},
    servoing.optimal_control: {"feature_weight": no_weight, "control_weight": no_weight},
    servoing.path_metrics: {"position": lambda valid: [*no_array(valid), np.zeros((1, 2))]},
    servoing.point_jacobian: {
        "depth": not_finite, "pixel_pitch": lambda valid: [*not_finite(valid), 0.0, -valid],
    },
    servoing.simulate: {
        "reference": lambda valid: [*no_array(valid), np.full((3, 2), 9e4)], "rng": NEGATIVE,
        "jacobian": lambda valid: [*not_finite(valid), np.array([valid, 0 * valid])],
        "controller": OTHER, "stage": OTHER, "camera": OTHER,
    },
    servoing.step_metrics: {
        "time": lambda valid: [*no_array(valid), np.maximum(valid, valid[1]), valid[:-1]],
        "target": lambda valid: [*no_array(valid), PLACE], "band": [*NOT_POSITIVE, 1.0],
    },
}  # fmt: skip


@each_call
def test_call_gives_the_same_for_the_same_numbers(function):
    hold_call(function, CALLS[function])


@pytest.mark.parametrize("function", [f for f in CALLS if f is not OptimalController])
def test_results_follow_units_of_length_pixel_and_time(function):
    found, plain = function(**CALLS[function](UM, PX, S)), function(**CALLS[function]())
    hold_scaled(found, plain, **FACTORS.get(function, {"factor": UM / S}))  # a velocity


@each_call
def test_wrong_arguments_are_refused_by_name(function):
    hold_refused(function, CALLS[function](), REFUSED.get(function, {}))


def test_wrong_arguments_of_a_run_are_refused_by_name():
    wrong = {
        "jacobian": no_jacobian,
        "targets": no_array,
        "travel": lambda valid: [*not_finite(valid), np.zeros(2), -valid],
        # Beyond the travel, and beyond the longest move.
        "test_move": [*NOT_POSITIVE, 500.0, 80.0],
        **dict.fromkeys(("tolerance", "longest_move", "timeout"), NOT_POSITIVE),
        "progress": [5, "text"],
    }
    hold_refused(servoing.servo, {"jacobian": J.copy(), **steered()}, wrong)
    rendered = {"render": lambda feature: np.zeros((9, 9)), "jacobian": J.copy(), "rng": 0}
    rendered |= {"stage": stage(), "camera": CameraTiming(0.03), "drift": np.ones(2)}
    wrong = {"jacobian": no_jacobian, "drift": no_array, "home": no_array, "rng": NEGATIVE}
    wrong |= {"render": OTHER, "stage": OTHER, "camera": OTHER}
    hold_refused(SimulatedWorkstation, rendered | {"home": np.ones(2)}, wrong)


def test_step_and_path_metrics_and_control_do_not_depend_on_origins():
    def moved(function, *names, by):
        given = CALLS[function]()
        return function(**given | {name: given[name] + by for name in names})

    away = np.array([31.0, 17.0])
    for function, names in (
        (servoing.step_metrics, ("position", "target")),
        (servoing.path_metrics, ("position", "reference")),
        (servoing.optimal_control, ("feature", "target")),
        (OptimalController.__call__, ("measured", "reference")),
    ):
        hold_scaled(moved(function, *names, by=away), function(**CALLS[function]()))
    later = moved(servoing.step_metrics, "time", by=11.9)
    hold_scaled(later, servoing.step_metrics(**CALLS[servoing.step_metrics]()))
    run = moved(servoing.simulate, "reference", "start", by=away)
    by = dict.fromkeys(("reference", "feature", "measured"), lambda seen: seen + away)
    hold_scaled(run, servoing.simulate(**CALLS[servoing.simulate]()), **by)


MOVED = {
    "place": PLACE + np.array([31.0, 17.0]),
    "stand": STAND + np.array([-72.0, 95.0]),
    "t0": T0 + 11.9,
}


@pytest.mark.parametrize("um", [1.0, 0.01])
def test_run_follows_unit_of_stage_and_origins(um):
    """Frames fix the pixels, and the interval at which devices are polled fixes the seconds."""
    origins = MOVED if um == 1 else {}
    found, plain = servoing.servo(**steered(um, **origins)), servoing.servo(**steered())
    away = {
        name: origins.get(name, old) - old for name, old in (("place", PLACE), ("stand", STAND))
    }
    log = {}
    for k, axis in enumerate("xy"):
        for name in ("stage", "command"):
            log[f"{name}_{axis}_um"] = lambda x, k=k: um * x + away["stand"][k]
        for name in ("reference", "measured"):
            log[f"{name}_{axis}_px"] = lambda x, k=k: x + away["place"][k]
    by = {"jacobian": 1 / um, "jacobian_covariance": 1 / um**2}
    hold_scaled(found, plain, log=log, **by)


@each_view
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


@each_view
def test_step_metrics_follow_rotation_of_axes(view):
    given = CALLS[servoing.step_metrics]()
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
    workstation = begun()
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
    assert set(run.log["latency_s"].dropna().round(6)) == {0.01, 0.014}  # camera, and tracker


def test_reason_states_positions_from_the_start():
    workstation = begun()
    move = workstation.stage.move_to
    workstation.stage.move_to = lambda to: move(np.add(to, (0.0, 700.0)))
    run = servoing.servo(workstation, seeing(workstation), PLACE, travel=(500.0, 400.0))
    assert run.reason.startswith("the stage is beyond the travel")
    numbers = [float(number) for number in re.findall(r"[\d.]+", run.reason)]
    assert numbers == pytest.approx([500.0, 400.0, 40.0, 400.0], abs=1.0)
