"""The loop of `servo`: take a frame, measure, move, and end the run at a fault or a limit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from microlib._common import Array, as_symmetric
from microlib.servoing._devices import EndRun, wait_until_still
from microlib.servoing._motion import (
    MOST_RELATIVE_ERROR,
    NOT_CALIBRATED,
    calibration_moves,
    fit_motion,
)

#: Comparisons in a row that end the run if the motion in the image deviates in each of them: one
#: can be a bad track, and a second its correction; a wrong Jacobian, a stuck axis or a frozen frame
#: makes every comparison deviate.
_MISMATCHES = 3

#: Shorter moves are summed until they are as long as this many tolerances, and then compared: half
#: of the sum is five tolerances.
_LEAST_CHECKED = 10.0

#: Share of the travel that is used: the rest is for the overshoot of a drive. A position beyond the
#: travel ends the run.
USABLE_TRAVEL = 0.99

#: Frames after which a target counts as not reachable.
_MOST_FRAMES = 50

#: Frames in a row without the feature that end the run; the stage stands from the first.
_MOST_LOST = 3


@dataclass(frozen=True)
class LoopOptions:
    """The arguments of `servo`, checked."""

    targets: Array
    travel: Array
    test_move: float
    tolerance: float
    longest_move: float | None
    timeout: float
    progress: Callable[[dict[str, Any]], object]


#: The columns of the log, the same whatever was steered.
_COLUMNS = (
    *("time_s", "phase", "target", "reference_x_px", "reference_y_px", "measured_x_px"),
    *("measured_y_px", "lost", "stage_x_um", "stage_y_um", "command_x_um", "command_y_um"),
    *("latency_s", "event"),
)


def new_row(time: float, phase: str, target: int) -> dict[str, Any]:
    """Return a row of the log without measurements."""
    given = {"time_s": time, "phase": phase, "target": target, "lost": False, "event": ""}
    return dict.fromkeys(_COLUMNS, np.nan) | given


def put(row: dict[str, Any], name: str, value: Array, unit: str) -> None:
    """Enter both axes of a quantity."""
    row[f"{name}_x_{unit}"], row[f"{name}_y_{unit}"] = map(float, value)


def lost_text(event: str) -> str:
    """Return the event of a row without the feature as the beginning of a reason to end the run."""
    return event if event == "lost" else f"lost: {event}"


def add_event(row: dict[str, Any], event: str) -> None:
    """Add an event to those of the row."""
    row["event"] = "; ".join(filter(None, (row["event"], event)))


@dataclass(frozen=True)
class Observation:
    """One frame and its measurement; `measured` is NaN if the feature is lost."""

    row: dict[str, Any]
    position: Array
    measured: Array
    covariance: Array


class MotionCheck:
    """Compares the motion in the image with the motion that J predicts of the commands."""

    def __init__(self, least_checked: float) -> None:
        self._least_checked = least_checked
        self._seen_at: Array | None = None
        self._planned: Array = np.zeros(2)
        self._mismatches = 0

    def predict(self, motion: Array) -> None:
        """Add a motion that J predicts, px."""
        self._planned = self._planned + motion

    def update(self, measured: Array) -> None:
        """Compare with the measured feature, and end the run after too many mismatches in a row."""
        if self._seen_at is None:
            self._seen_at = measured
        size = float(np.linalg.norm(self._planned))
        if size < self._least_checked:
            return
        deviation = float(np.linalg.norm(measured - self._seen_at - self._planned))
        self._mismatches = self._mismatches + 1 if deviation > 0.5 * size else 0
        if self._mismatches == _MISMATCHES:
            moved = np.round(measured - self._seen_at, 2) + 0.0
            wanted = np.round(self._planned, 2) + 0.0
            raise EndRun(
                f"the image does not follow the stage: {_MISMATCHES} comparisons in a row were "
                f"off by more than half, the last {moved} px instead of {wanted} px"
            )
        self._seen_at, self._planned = measured, np.zeros(2)


class Loop:
    """One run; its results are in `rows`, `motion` and `reached`."""

    def __init__(self, workstation: Any, tracker: Any, options: LoopOptions) -> None:
        self.workstation = workstation
        self.rows: list[dict[str, Any]] = []
        self.motion = NOT_CALIBRATED
        self.reached = np.zeros(len(options.targets), dtype=bool)
        self._tracker, self._options = tracker, options
        self._first_exposure: float | None = None
        self._start: Array = np.zeros(2)
        self._lost = 0
        self._motion_check = MotionCheck(_LEAST_CHECKED * options.tolerance)

    def now(self) -> float:
        """Return the time from the first exposure, s."""
        if self._first_exposure is None:
            return 0.0
        return float(self.workstation.clock.now()) - self._first_exposure

    def run(self, jacobian: Array | None) -> None:
        """Observe, calibrate if there is no Jacobian, and go to the targets."""
        first = self._observe("start", -1)
        self._start = first.position
        if not np.isfinite(first.measured).all():
            raise EndRun(f"{lost_text(first.row['event'])} in the first frame")
        if jacobian is None:
            self._calibrate(first)
        else:
            self._report(first)
            self.motion = replace(NOT_CALIBRATED, jacobian=jacobian)
        self._check_targets(first.measured)
        for number, reference in enumerate(self._options.targets):
            self._servo_to(number, reference)

    def _check_targets(self, feature: Array) -> None:
        """End the run if a target is beyond the travel."""
        travel = USABLE_TRAVEL * self._options.travel
        needed = np.linalg.solve(self.motion.jacobian, (self._options.targets - feature).T).T
        beyond = (np.abs(needed) > travel).any(axis=1)
        if beyond.any():
            number = int(beyond.argmax())
            raise EndRun(
                f"target {number} is beyond the travel of ±{travel} µm: "
                f"{np.round(needed[number], 1)} µm from the start"
            )

    def _observe(self, phase: str, target: int, reference: Array | None = None) -> Observation:
        """Take a frame and measure the feature."""
        position = np.asarray(self.workstation.stage.position(), dtype=float)
        frame, exposed = self.workstation.camera.snap()
        if self._first_exposure is None:
            self._first_exposure = exposed
        row = new_row(exposed - self._first_exposure, phase, target)
        self.rows.append(row)
        put(row, "stage", position, "um")
        if reference is not None:
            put(row, "reference", reference, "px")
        track = self._tracker.track(frame)
        row["latency_s"] = self.workstation.clock.now() - exposed
        if track.lost:
            row["lost"] = True
            add_event(row, getattr(track, "reason", "") or "lost")
            return Observation(row, position, np.full(2, np.nan), np.full((2, 2), np.nan))
        measured = np.asarray(track.center, dtype=float)
        put(row, "measured", measured, "px")
        covariance = as_symmetric("covariance", getattr(track, "covariance", np.zeros((2, 2))), 2)
        return Observation(row, position, measured, covariance)

    def _report(self, observation: Observation) -> None:
        self._options.progress(dict(observation.row))

    def _calibrate(self, first: Observation) -> None:
        observed = [first]
        for offset in calibration_moves(self._options.test_move):
            self._go(observed[-1].row, self._start + offset)
            self._report(observed[-1])
            observation = self._observe("calibration", -1)
            if not np.isfinite(observation.measured).all():
                event, size = observation.row["event"], self._options.test_move
                raise EndRun(f"{lost_text(event)} at a test move of {size:g} µm")
            observed.append(observation)
        self._report(observed[-1])
        self.motion = fit_motion(
            np.array([each.row["time_s"] for each in observed]),
            np.array([each.position for each in observed]) - self._start,
            np.array([each.measured for each in observed]),
            np.array([each.covariance for each in observed]),
        )
        if not self.motion.relative_error <= MOST_RELATIVE_ERROR:  # NaN is no calibration
            raise EndRun(
                "calibration rejected: the test moves leave a relative error of the Jacobian "
                f"of {self.motion.relative_error:.2g}, at most {MOST_RELATIVE_ERROR:g} is allowed"
            )

    def _servo_to(self, number: int, reference: Array) -> None:
        """Bring the feature within the tolerance of one target."""
        for _ in range(_MOST_FRAMES):
            observation = self._observe("servo", number, reference)
            if not self._accept(observation):
                continue
            if np.linalg.norm(reference - observation.measured) <= self._options.tolerance:
                self.reached[number] = True
                add_event(observation.row, "reached")
                self._report(observation)
                return
            self._move(observation, reference)
            self._report(observation)
        raise EndRun(f"target {number} was not reached in {_MOST_FRAMES} frames")

    def _accept(self, observation: Observation) -> bool:
        """Compare the measured feature with the commands, or count and report a lost one.

        Returns whether the feature is measured. Ends the run after too many frames without it, or
        if the image does not follow the stage.
        """
        if np.isfinite(observation.measured).all():
            self._lost = 0
            self._motion_check.update(observation.measured)
            return True
        self._report(observation)
        self._lost += 1
        if self._lost == _MOST_LOST:
            event = observation.row["event"]
            raise EndRun(f"{lost_text(event)} in {self._lost} frames in a row")
        return False

    def _move(self, observation: Observation, goal: Array) -> None:
        """Move to where the goal is by J, within the limits."""
        options = self._options
        move = np.linalg.solve(self.motion.jacobian, goal - observation.measured)
        length = float(np.linalg.norm(move))
        if options.longest_move is not None and length > options.longest_move:
            move = move * (options.longest_move / length)
            add_event(observation.row, "limit")
        travel = USABLE_TRAVEL * options.travel
        target = np.clip(observation.position + move, self._start - travel, self._start + travel)
        if (target != observation.position + move).any():
            add_event(observation.row, "travel")
        self._go(observation.row, target)
        self._motion_check.predict(self.motion.jacobian @ (target - observation.position))

    def _go(self, row: dict[str, Any], target: Array) -> None:
        """Send the stage and wait until it stands there."""
        put(row, "command", target, "um")
        self.workstation.stage.move_to(target)
        wait_until_still(self.workstation, self._options.timeout, self._check_travel)
        self._check_travel()

    def _check_travel(self) -> None:
        """End the run if the stage is beyond the travel."""
        position = np.asarray(self.workstation.stage.position(), dtype=float)
        if (np.abs(position - self._start) > self._options.travel).any():
            raise EndRun(
                f"the stage is beyond the travel of ±{self._options.travel} µm, at "
                f"{np.round(position - self._start, 2)} µm from the start"
            )
