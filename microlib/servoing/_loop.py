"""The loop behind `servo`: look, measure, move, and end when something is not as it should be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, EndRun, Guard, VelocityMover, Workstation
from microlib.servoing._control import PredictiveController
from microlib.servoing._log import add_event, median_latency, new_row, put
from microlib.servoing._motion import LARGEST_SHARE, StageMotion, fit_motion, visits
from microlib.servoing._workstation import Controller, Tracker

#: Moves in a row that the image may fail to follow: one can be a bad track, and a second its
#: correction; a wrong Jacobian, a stuck axis or a frozen frame fails every one.
_MOST_STRAYS = 3

#: Moves shorter than this many tolerances say nothing of how the image follows: half of one is
#: then five times what the user wants to tell apart.
_TELLING = 10.0

#: Share of the error that a velocity takes away in a sample, if nothing is late; on a path the
#: feature stays a ninth of a sample behind. From 0.5 to 0.99 all loops settle with a sample of
#: latency more than was measured, or a Jacobian wrong by half (benchmark "microscope", "Loop
#: gain").
LOOP_GAIN = 0.9

#: Share of the travel that is used: the rest is for what a drive overshoots, and whatever is beyond
#: the travel all the same ends the run.
USED = 0.99

#: How far, in intervals or slowest frames, a velocity may reach: one until the next command and one
#: until a late frame has the stage stopped.
_HORIZON = 2.0


@dataclass(frozen=True)
class Settings:
    """The arguments of `servo`, checked."""

    targets: Array
    travel: Array
    unit: str
    path: bool
    drive: str
    test_move: float
    controller: Controller | None
    tolerance: float
    step: float | None
    speed: float | None
    interval: float
    rest: float
    most_frames: int
    most_lost: int
    timeout: float
    progress: Callable[[dict[str, Any]], object] | None
    keep_frames: bool


@dataclass(frozen=True)
class Look:
    """What one frame shows; `measured` is NaN if the feature is lost."""

    row: dict[str, Any]
    exposed: float
    position: Array
    measured: Array
    covariance: Array


class Follower:
    """Compares where the image goes with where the commands should have brought it."""

    def __init__(self, telling: float) -> None:
        self._telling = telling
        self._origin: Array | None = None
        self._planned: Array = np.zeros(2)
        self._strays = 0

    def plan(self, motion: Array) -> None:
        """Note by how much the image should move, px."""
        self._planned = self._planned + motion

    def see(self, measured: Array) -> None:
        """Compare with what is seen, and end the run when it strays too often."""
        if self._origin is None:
            self._origin = measured
        size = float(np.linalg.norm(self._planned))
        if size < self._telling:
            return
        apart = float(np.linalg.norm(measured - self._origin - self._planned))
        self._strays = self._strays + 1 if apart > 0.5 * size else 0
        if self._strays == _MOST_STRAYS:
            moved = np.round(measured - self._origin, 2) + 0.0
            wanted = np.round(self._planned, 2) + 0.0
            raise EndRun(
                f"the image does not follow the stage: {_MOST_STRAYS} moves in a row were off by "
                f"more than half, the last {moved} px instead of {wanted} px"
            )
        self._origin, self._planned = measured, np.zeros(2)


class Loop:
    """One run; what it saw and did is in `rows`, `frames`, `motion` and `reached`."""

    def __init__(
        self, workstation: Workstation, tracker: Tracker, guard: Guard, settings: Settings
    ) -> None:
        self.workstation, self.guard = workstation, guard
        self.rows: list[dict[str, Any]] = []
        self.frames: list[NDArray[Any]] = []
        self.motion: StageMotion | None = None
        self.reached = np.zeros(len(settings.targets), dtype=bool)
        self._tracker, self._settings = tracker, settings
        self._origin: float | None = None
        self._start: Array = np.zeros(2)
        self._lost = 0
        self._slowest = 0.0
        self._follower = Follower(_TELLING * settings.tolerance)
        # Of a velocity stage: what it does now, since when, and the exposure before.
        self._velocity: Array = np.zeros(2)
        self._since = self._seen = 0.0

    def now(self) -> float:
        """Return the time from the first exposure, s."""
        return 0.0 if self._origin is None else self.workstation.clock.now() - self._origin

    def run(self, jacobian: Array | None) -> None:
        """Look, calibrate if nothing is known, and go to the targets."""
        first = self._look("start", -1)
        self._start = first.position
        if not np.isfinite(first.measured).all():
            raise EndRun(f"lost: {first.row['event']} in the first frame")
        if jacobian is None:
            self._calibrate(first)
        else:
            self._finish(first)
            unknown = np.full((4, 4), np.nan)
            self.motion = StageMotion(jacobian, unknown, np.full(2, np.nan), float("nan"))
        references = self._references(first.measured)
        if self._settings.path:
            self._follow(references)
        else:
            for number, reference in enumerate(references):
                self._reach(number, reference)

    @property
    def _jacobian(self) -> Array:
        assert self.motion is not None  # `run` sets it before anything is steered
        return self.motion.jacobian

    def _references(self, feature: Array) -> Array:
        """Return the targets in px, all within the travel."""
        targets, travel = self._settings.targets, USED * self._settings.travel
        if self._settings.unit == "um":
            targets = feature + targets @ self._jacobian.T
        needed = np.linalg.solve(self._jacobian, (targets - feature).T).T
        beyond = (np.abs(needed) > travel).any(axis=1)
        if beyond.any():
            number = int(beyond.argmax())
            raise EndRun(
                f"target {number} is beyond the travel of ±{travel} µm: "
                f"{np.round(needed[number], 1)} µm from the start"
            )
        return targets

    def _look(self, phase: str, target: int, reference: Array | None = None) -> Look:
        """Take a frame and measure; three lost ones in a row end the run."""
        guard, clock = self.guard, self.workstation.clock
        position = np.asarray(guard.call(self.workstation.stage.position), dtype=float)
        began = clock.now()
        frame, exposed = guard.call(self.workstation.camera.snap, waiting=self._watch)
        self._slowest = max(self._slowest, clock.now() - began)
        if self._origin is None:
            self._origin = exposed
        row = new_row(exposed - self._origin, phase, target)
        self.rows.append(row)
        put(row, "stage", position, "um")
        if reference is not None:
            put(row, "reference", reference, "px")
        if self._settings.keep_frames:
            self.frames.append(np.array(frame))
        track = self._tracker.track(frame)
        row["latency_s"] = clock.now() - exposed
        if track.lost:
            row["lost"] = True
            add_event(row, getattr(track, "reason", "") or "lost")
            return Look(row, exposed, position, np.full(2, np.nan), np.full((2, 2), np.nan))
        measured = np.asarray(track.center, dtype=float)
        put(row, "measured", measured, "px")
        covariance = np.asarray(getattr(track, "covariance", np.zeros((2, 2))), dtype=float)
        return Look(row, exposed, position, measured, covariance)

    def _finish(self, look: Look) -> None:
        if self._settings.progress is not None:
            self._settings.progress(dict(look.row))

    def _watch(self) -> None:
        """Stop a stage under way when the frame is late: nobody sees where it goes."""
        late = self.workstation.clock.now() - self._since
        if self._velocity.any() and late > _HORIZON * self._period():
            self._stand()

    def _period(self) -> float:
        return max(self._settings.interval, self._slowest)

    def _calibrate(self, first: Look) -> None:
        looks = [first]
        for visit in visits(self._settings.test_move):
            self._go(looks[-1].row, self._start + visit)
            self._finish(looks[-1])
            look = self._look("calibration", -1)
            if not np.isfinite(look.measured).all():
                raise EndRun(
                    f"lost: {look.row['event']} at a test move of {self._settings.test_move:g} µm"
                )
            looks.append(look)
        self._finish(looks[-1])
        self.motion = fit_motion(
            np.array([look.exposed for look in looks]),
            np.array([look.position for look in looks]) - self._start,
            np.array([look.measured for look in looks]),
            np.array([look.covariance for look in looks]),
        )
        if not self.motion.share <= LARGEST_SHARE:  # NaN is no calibration
            raise EndRun(
                "calibration refused: the test moves leave the Jacobian open by "
                f"{self.motion.share:.2g} of what it does, at most {LARGEST_SHARE:g} is allowed"
            )

    def _reach(self, number: int, reference: Array) -> None:
        """Bring the feature within the tolerance of one target."""
        goals = np.stack([reference, reference])
        controller = self._controller()
        standing = True
        for _ in range(self._settings.most_frames):
            look = self._look("servo", number, reference)
            if not self._is_seen(look):
                standing, controller = True, self._controller()
                continue
            self._account(look)
            near = np.linalg.norm(reference - look.measured) <= self._settings.tolerance
            if near and standing:
                self.reached[number] = True
                add_event(look.row, "reached")
                self._finish(look)
                return
            if near:  # in passing; look again once it stands
                self._stand()
                standing, controller = True, self._controller()
            else:
                self._command(look, 0, goals, controller)
                standing = self._settings.drive == "position"
            self._finish(look)
        raise EndRun(f"target {number} was not reached in {self._settings.most_frames} frames")

    def _follow(self, references: Array) -> None:
        """Lead the feature along a path, a point a frame."""
        controller = self._controller()
        for k, reference in enumerate(references):
            look = self._look("servo", k, reference)
            if not self._is_seen(look):
                continue
            self._account(look)
            self.reached[k] = True
            if k + 1 < len(references):
                self._command(look, k, references, controller)
            self._finish(look)

    def _is_seen(self, look: Look) -> bool:
        """Let the stage stand while the feature is lost, and end the run if it stays so."""
        if np.isfinite(look.measured).all():
            self._lost = 0
            return True
        self._stand()
        self._finish(look)
        self._lost += 1
        if self._lost == self._settings.most_lost:
            raise EndRun(f"lost: {look.row['event']} in {self._lost} frames in a row")
        return False

    def _account(self, look: Look) -> None:
        """Hold what is seen against what the stage was told until this exposure."""
        self._follower.plan(self._jacobian @ self._velocity * (look.exposed - self._since))
        self._since = look.exposed
        self._follower.see(look.measured)

    def _controller(self) -> Controller:
        settings, jacobian = self._settings, self._jacobian
        if settings.controller is not None:
            return settings.controller
        interval = settings.interval
        if settings.drive == "position":
            inverse = np.linalg.inv(jacobian)
            return lambda k, measured, goals: (
                inverse @ (goals[min(k + 1, len(goals) - 1)] - measured) / interval
            )
        # The weight of the velocities that leaves (2.28) the wanted share of the error a sample.
        weight = interval**2 * jacobian.T @ jacobian * (1 - LOOP_GAIN) / LOOP_GAIN
        return PredictiveController(
            jacobian,
            interval=interval,
            feature_weight=np.ones(2),
            control_weight=(weight + weight.T) / 2,
            delay=median_latency(self.rows),
            saturation=cast(float, settings.speed),
        )

    def _command(self, look: Look, k: int, goals: Array, controller: Controller) -> None:
        """Ask the controller, keep to the limits, and move."""
        settings = self._settings
        velocity = np.asarray(controller(k, look.measured, goals), dtype=float)
        if velocity.shape != (2,) or not np.isfinite(velocity).all():
            raise EndRun(f"the controller must give two finite velocities, got {velocity}")
        longest = np.inf if settings.step is None else settings.step
        if settings.drive == "velocity":
            longest = min(longest, cast(float, settings.speed) * settings.interval)
        way = velocity * settings.interval
        if (length := float(np.linalg.norm(way))) > longest:
            way = way * (longest / length)
            add_event(look.row, "limit")
        if settings.drive == "velocity":
            self._drive(look.row, way / settings.interval)
            return
        room = USED * settings.travel
        target = np.clip(look.position + way, self._start - room, self._start + room)
        if not np.array_equal(target, look.position + way):
            add_event(look.row, "travel")
        self._go(look.row, target)
        self._follower.plan(self._jacobian @ (target - look.position))

    def _go(self, row: dict[str, Any], target: Array) -> None:
        """Send a position stage, in legs if there is a speed to keep, and wait until it stands."""
        guard, stage, settings = self.guard, self.workstation.stage, self._settings
        put(row, "command", target, "um")
        here = np.asarray(guard.call(stage.position), dtype=float)
        legs = 1
        if settings.speed is not None:
            length = float(np.linalg.norm(target - here))
            if length > settings.speed * settings.timeout:
                raise EndRun(
                    f"a move of {length:.3g} µm at {settings.speed:.3g} µm/s takes longer than "
                    f"{settings.timeout:g} s"
                )
            legs = max(1, int(np.ceil(length / (settings.speed * settings.interval))))
        for leg in range(1, legs + 1):
            end = self.workstation.clock.now() + (settings.interval if settings.speed else 0.0)
            guard.call(stage.move_to, here + (target - here) * (leg / legs))
            guard.settle(self._watch_travel)
            guard.pause(end - self.workstation.clock.now())
        arrived = self._watch_travel()
        self._check_arrival(here, target, arrived)
        guard.pause(settings.rest)

    def _check_arrival(self, here: Array, target: Array, arrived: Array) -> None:
        """End the run if the encoder says that a move went less than half the way, or elsewhere."""
        way, left = float(np.linalg.norm(target - here)), float(np.linalg.norm(target - arrived))
        if self.motion is not None:
            # Below that a move may be less than an increment of the drive.
            pixels = float(np.linalg.norm(self._jacobian @ (target - here)))
            if pixels < _TELLING * self._settings.tolerance:
                return
        if left > 0.5 * way:
            raise EndRun(
                f"the stage did not go where it was sent: it stands at {np.round(arrived, 2)} µm "
                f"instead of {np.round(target, 2)} µm"
            )

    def _watch_travel(self) -> Array:
        """Return where the stage is, and end the run if that is beyond the travel."""
        position = np.asarray(self.guard.call(self.workstation.stage.position), dtype=float)
        if (np.abs(position - self._start) > self._settings.travel).any():
            raise EndRun(
                f"the stage is beyond the travel of ±{self._settings.travel} µm, at "
                f"{np.round(position - self._start, 2)} µm from the start"
            )
        return position

    def _drive(self, row: dict[str, Any], velocity: Array) -> None:
        """Give a velocity stage a velocity that cannot reach the end of the travel unseen."""
        settings, clock = self._settings, self.workstation.clock
        stage = cast(VelocityMover, self.workstation.stage)
        position = self._watch_travel()
        horizon = _HORIZON * self._period()
        room = USED * settings.travel
        low = np.minimum(0.0, (self._start - room - position) / horizon)
        high = np.maximum(0.0, (self._start + room - position) / horizon)
        kept = np.clip(velocity, low, high)
        if not np.array_equal(kept, velocity):
            add_event(row, "travel")
        put(row, "velocity", kept, "um_s")
        began = clock.now()
        self.guard.call(stage.move_at, kept)
        self._change(kept, began)
        self.guard.pause(settings.interval - (clock.now() - began) - row["latency_s"])

    def _stand(self) -> None:
        """Stop a velocity stage; one that goes to positions stands already."""
        if self._velocity.any():
            began = self.workstation.clock.now()
            self.guard.call(self.workstation.stage.stop)
            self._change(np.zeros(2), began)

    def _change(self, velocity: Array, when: float) -> None:
        """Note since when the stage has another velocity."""
        self._follower.plan(self._jacobian @ self._velocity * (when - self._since))
        self._velocity, self._since = velocity, when
