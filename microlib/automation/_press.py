"""The loop behind `inject`: approach, contact, press, withdraw; and end when something is wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, EndRun, Guard, Workstation
from microlib.automation._sight import Sight, TipTracker, see
from microlib.membrane import fit_capsule
from microlib.servoing import servo

#: The pipette is led by sight to so many px over the egg: `extract_boundary` looks for its end in
#: the 8 px below, which are then still ground.
_HOVER = 10.0
#: Length of the calibration's test moves, px, as `servo` advises, and how close the pipette's end
#: has to come to its place over the egg, px: a tenth of what its width is wide in a usual image.
_TEST, _ALIGNED = 10.0, 0.25
#: From this height on the steps are small, px: three times what the place of the pipette's end is
#: off by over an egg instead of ground (half a px; benchmarks/injection.py, "Pipette's end"), and
#: more.
_STANDOFF = 3.0
#: Frames that tell where the untouched outline is and how much it scatters, at least.
_STILL_FRAMES = 5
#: Contact is where the outline lies this many standard deviations below the untouched one, and at
#: least so many px, in two frames in a row: one of 16 000 does by chance, and two never.
_SIGMAS, _LEAST_SINK = 4.0, 0.015
#: What an outline may lie off while nothing can touch it, px: thirty times the scatter of its mean.
_MOVED = 0.3
#: How far from the expected place the contact may be, px: over that the egg moves by itself, and
#: below that it is not there. Four times the error of the expected place.
_PLACE = 2.0
#: Commanded motion after which the image must have followed within half, px: four times the half
#: px by which the pipette's end is seen wrongly when it comes to the egg.
_TELLING = 2.0
#: A pressed outline that comes up again by this share of what it had sunk is not pressed any more.
_SPRINGS = 0.5
#: Share of the way that is left to the target, as the last two values foretell it, that a step
#: takes: the forecast is a power law, good to a tenth over half of the way.
_SHARE = 0.7
#: Share over the target that ends a run: what a forecast, or a first value, may have missed.
_PASSED = 0.1
#: Range of the power with which force or depth rise over the way, and what is supposed before two
#: values are known: 1 for a taut wall, up to 3 for a slack one.
_POWERS, _FIRST_POWER = (1.0, 3.0), 1.5
#: Looks on the way back.
_LOOKS_BACK = 4
#: Depth from which a capsule is fitted to a dimple, px: `extract_boundary` wants 3; at 2 the force
#: is open by 5 % and the search takes twenty times as long (benchmarks/injection.py).
_LEAST_DIMPLE = 4.0
#: Where the first fit of a capsule begins: F/(E h) over the way since contact, and inflation. At
#: dimples of 4 px the first is 0.04 to 0.18 for eggs inflated by 1 to 7 %, and rises with it.
_FIRST_SHAPES = ((0.07, 1.03), (0.14, 1.06))
#: Share by which a fitted dimple may be deeper or less deep than the one that is seen, which is
#: true to some percent. A search that lost its way is off by a factor of ten.
_ASTRAY = 0.5
#: Points of an outline that the capsule is fitted to: neighbors share pixels.
_FIT_POINTS = 160

COLUMNS: dict[str, str] = {
    "time_s": "float64",
    "phase": "object",
    "stage_x_um": "float64",
    "stage_y_um": "float64",
    "tip_x_px": "float64",
    "tip_y_px": "float64",
    "gap_um": "float64",
    "sunk_um": "float64",
    "approach_um": "float64",
    "depth_um": "float64",
    "force_uN": "float64",
    "force_std_uN": "float64",
    "lost": "bool",
    "event": "object",
}


@dataclass(frozen=True)
class Plan:
    """The arguments of `inject`, checked."""

    pixel_size: float
    probe_half_width: float
    thickness: float
    modulus: float | None
    law: str
    target: float
    wanted: str
    tolerance: float
    travel: Array
    approach_step: float
    press_step: float
    jacobian: Array | None
    direction: str
    region: tuple[int, int, int, int] | None
    hold: float
    most_lost: int
    timeout: float
    progress: Callable[[dict[str, Any]], object] | None
    keep_frames: bool


@dataclass(frozen=True)
class Look:
    """One frame: its row of the log, and what it shows."""

    row: dict[str, Any]
    sight: Sight


class Press:
    """One run; what it saw and did is in `rows`, `frames`, `jacobian` and the results below."""

    def __init__(self, workstation: Workstation, guard: Guard, plan: Plan) -> None:
        self.guard = guard
        self.rows: list[dict[str, Any]] = []
        self.frames: list[NDArray[Any]] = []
        self.jacobian: Array = np.full((2, 2), np.nan)
        self.contact: Array = np.full(2, np.nan)
        self.reached = False
        self.best = {"depth_um": np.nan, "force_uN": np.nan, "force_std_uN": np.nan}
        self._workstation, self._plan = workstation, plan
        self._began: float | None = None
        self._direction = plan.direction
        self._last: NDArray[Any] | None = None
        self._moved = False
        self._start: Array = np.zeros(2)
        # Set by `_line_up`: where the approach starts on the stage, and its direction there.
        self._origin: Array = np.zeros(2)
        self._axis: Array = np.zeros(2)
        self._advance = 0.0
        self._followed: tuple[float, Array] | None = None
        self._reference: Sight | None = None
        self._gap = np.nan
        self._touched = np.nan
        self._shape: tuple[float, float] | None = None
        self._unread = 0

    def run(self) -> None:
        """Do all of it, in order."""
        first = self._look("start")
        self._direction = first.sight.direction
        self._start = self._where()
        self._line_up(first)
        self._approach()
        self._press()
        self._withdraw()

    def now(self) -> float:
        """Return the time from the first exposure, s."""
        return 0.0 if self._began is None else self._workstation.clock.now() - self._began

    def _where(self) -> Array:
        place = self.guard.call(self._workstation.stage.position)
        return np.asarray(place, dtype=float)

    def _look(self, phase: str) -> Look:
        """Take frames until one shows pipette and egg; too many without end the run."""
        for _ in range(self._plan.most_lost):
            position = self._where()
            frame, exposed = self.guard.call(self._workstation.camera.snap)
            if self._began is None:
                self._began = exposed
            row: dict[str, Any] = {
                name: np.nan for name, kind in COLUMNS.items() if kind == "float64"
            }
            row |= {"time_s": exposed - self._began, "phase": phase, "lost": False, "event": ""}
            row["stage_x_um"], row["stage_y_um"] = map(float, position)
            self.rows.append(row)
            if self._plan.keep_frames:
                self.frames.append(np.array(frame))
            try:
                sight = self._sight(np.asarray(frame))
            except ValueError as reason:
                row |= {"lost": True, "event": str(reason)}
                self._tell(row)
                continue
            row["tip_x_px"], row["tip_y_px"] = map(float, sight.tip)
            return Look(row, sight)
        raise EndRun(f"lost: {row['event']}, in {self._plan.most_lost} frames in a row")

    def _sight(self, frame: NDArray[Any]) -> Sight:
        """Find pipette and egg, in a picture that is not the one before."""
        before, self._last = self._last, frame.copy()
        if self._moved and before is not None and np.array_equal(before, frame):
            raise ValueError("image must change when the stage moves, got the one before again")
        self._moved = False
        return see(frame, self._direction, self._plan.region)

    def _tell(self, row: dict[str, Any]) -> None:
        if self._plan.progress is not None:
            self._plan.progress(dict(row))

    def _go(self, advance: float) -> None:
        """Bring the pipette forward to `advance` µm from where it was lined up, and wait."""
        target = self._origin + self._axis * advance
        room = self._plan.travel
        if (np.abs(target - self._start) > room).any():
            far = np.round(target - self._start, 1)
            raise EndRun(f"the way leads beyond the travel of ±{room} µm: {far} µm from the start")
        self.guard.call(self._workstation.stage.move_to, target)
        self.guard.settle()
        self._moved = True
        self._advance = advance
        missed = float(np.linalg.norm(self._where() - target))
        if missed > self._plan.approach_step:
            raise EndRun(f"the stage stands {missed:.2g} µm from where it was sent")

    def _follow(self, look: Look) -> None:
        """Hold where the pipette is seen against where the commands have brought it."""
        if self._followed is None:
            self._followed = (self._advance, look.sight.tip)
            return
        advance, tip = self._followed
        way = self._jacobian_way(self._advance - advance)
        size = float(np.linalg.norm(way))
        if size < _TELLING:
            return
        if np.linalg.norm(look.sight.tip - tip - way) > 0.5 * size:
            moved, wanted = np.round(look.sight.tip - tip, 1) + 0.0, np.round(way, 1) + 0.0
            raise EndRun(
                f"the image does not follow the stage: the pipette went {moved} px instead of "
                f"{wanted} px"
            )
        self._followed = (self._advance, look.sight.tip)

    def _jacobian_way(self, advance: float) -> Array:
        return self.jacobian @ self._axis * advance

    def _line_up(self, first: Look) -> None:
        """Learn how the stage moves the pipette, and bring it over the middle of the egg."""
        plan, sight = self._plan, first.sight
        clear = sight.crown - sight.tip[1]
        first.row["gap_um"] = clear * plan.pixel_size
        self._tell(first.row)
        needed = _HOVER + _TEST + _STANDOFF if plan.jacobian is None else _HOVER
        if clear < needed:
            raise EndRun(
                f"the pipette must begin at least {needed:.0f} px above the egg, got {clear:.1f} px"
            )
        target = np.array([sight.center[0], sight.crown - _HOVER])
        try:
            run = servo(
                self._workstation,
                TipTracker(self._direction, plan.region),
                target,
                travel=plan.travel,
                jacobian=plan.jacobian,
                test_move=_TEST * plan.pixel_size,
                tolerance=_ALIGNED,
                most_lost=plan.most_lost,
                timeout=plan.timeout,
                keep_frames=plan.keep_frames,
            )
        except KeyboardInterrupt:
            self.guard.interrupted.set()
            raise EndRun("interrupted by the user") from None
        assert self._began is not None  # of the first look
        self.frames += run.frames
        for row in run.log.to_dict("records")[:-1]:
            self._take_over({str(name): value for name, value in row.items()})
        self.jacobian = run.jacobian
        if run.reason:
            raise EndRun(run.reason) from run.error
        scale = np.linalg.norm(np.linalg.solve(run.jacobian, sight.along))
        if abs(np.log(scale / plan.pixel_size)) > np.log(1.1):
            raise EndRun(
                f"pixel_size is {plan.pixel_size:.3g} µm, but the stage moves {scale:.3g} µm a px"
            )
        self._origin = self._where()
        self._axis = np.linalg.solve(run.jacobian, sight.along) / scale

    def _take_over(self, theirs: dict[str, Any]) -> None:
        """Enter a row of the log of `servo`."""
        row = {name: np.nan for name, kind in COLUMNS.items() if kind == "float64"}
        own = {
            "time_s": self._offset() + theirs["time_s"],
            "phase": "calibration" if theirs["phase"] != "servo" else "line up",
            "stage_x_um": theirs["stage_x_um"],
            "stage_y_um": theirs["stage_y_um"],
            "tip_x_px": theirs["measured_x_px"],
            "tip_y_px": theirs["measured_y_px"],
            "lost": bool(theirs["lost"]),
            "event": theirs["event"],
        }
        self.rows.append(row | own)
        self._tell(self.rows[-1])

    def _offset(self) -> float:
        """Return the time of the last row before `servo`, which counts from its own first frame."""
        return float(next(r["time_s"] for r in self.rows[::-1] if r["phase"] == "start"))

    def _approach(self) -> None:
        """Come down in small steps until the outline sinks."""
        plan = self._plan
        look = self._look("approach")
        self._reference = look.sight
        self._gap = (look.sight.crown - look.sight.tip[1]) * plan.pixel_size
        # The wall's outside is half a thickness above its middle.
        self._gap -= plan.thickness / 2
        look.row["gap_um"] = self._gap
        self._tell(look.row)
        self._follow(look)
        self._go(self._gap - _STANDOFF * plan.pixel_size)
        still: list[float] = []
        sunk_before = False
        while True:
            look = self._look("approach")
            left = self._gap - self._advance
            sunk = look.sight.sunk(self._reference)
            look.row.update({"gap_um": left, "sunk_um": sunk * plan.pixel_size})
            self._follow(look)
            over, least = self._sinking(sunk, still)
            if abs(over) > max(least, _MOVED) and left > _PLACE * plan.pixel_size:
                raise EndRun(f"the egg moves before it is touched: {over:.2f} px")
            sinks = over > least
            if sinks and sunk_before:
                break
            sunk_before = sinks
            if not sunk_before:
                still.append(sunk)
            self._tell(look.row)
            if left < -_PLACE * plan.pixel_size:
                raise EndRun("no contact is seen where the egg should be touched")
            self._go(self._advance + plan.approach_step)
        look.row["event"] = "contact"
        self.contact = self._where()
        self._touched = self._advance
        look.row["approach_um"] = 0.0
        self._tell(look.row)

    @staticmethod
    def _sinking(sunk: float, still: list[float]) -> tuple[float, float]:
        """Return how far the outline lies below the untouched one, and how far is too far, px."""
        if len(still) < _STILL_FRAMES:
            return sunk, _MOVED
        spread = float(np.std(still, ddof=1)) * np.sqrt(1 + 1 / len(still))
        return sunk - float(np.mean(still)), max(_SIGMAS * spread, _LEAST_SINK)

    def _press(self) -> None:
        """Press until the outline tells that the target is reached."""
        plan, deepest = self._plan, 0.0
        known: list[tuple[float, float]] = []
        step = self._next_step(known, 0.0)
        while True:
            self._go(self._advance + step)
            look = self._look("press")
            way = self._advance - self._touched
            assert self._reference is not None
            sunk = look.sight.sunk(self._reference) * plan.pixel_size
            look.row.update({"approach_um": way, "sunk_um": sunk})
            self._follow(look)
            if sunk < (1 - _SPRINGS) * deepest:
                raise EndRun(
                    f"the egg springs back from {deepest:.1f} to {sunk:.1f} µm: its wall gave way, "
                    "or the pipette slid off"
                )
            deepest = max(deepest, sunk)
            look.row.update(self._measured(look.sight, way))
            value = look.row["depth_um" if plan.wanted == "depth" else "force_uN"]
            if np.isfinite(value):
                known.append((way, value))
                if value > (1 + _PASSED) * plan.target:
                    raise EndRun(f"the target was passed: {plan.wanted} {value:.3g}")
                if value >= (1 - plan.tolerance) * plan.target:
                    break
            self._tell(look.row)
            step = self._next_step(known, way)
        look.row["event"] = "reached"
        self.reached = True
        self.best = {name: look.row[name] for name in self.best}
        self._tell(look.row)
        self.guard.pause(plan.hold)

    def _next_step(self, known: list[tuple[float, float]], way: float) -> float:
        """Return how far to go on: part of what a power law leaves to the target."""
        plan = self._plan
        if not known or known[-1][1] <= 0:
            # The dimple grows by less than the way: by a pixel at most until something is known.
            return min(plan.press_step, max(plan.pixel_size, plan.approach_step))
        last, value = known[-1]
        power = _FIRST_POWER
        if len(known) > 1 and 0 < known[-2][1] < value:
            before, other = known[-2]
            power = float(np.clip(np.log(value / other) / np.log(last / before), *_POWERS))
        left = last * (plan.target / value) ** (1 / power) - way
        return float(np.clip(_SHARE * left, plan.approach_step, plan.press_step))

    def _measured(self, sight: Sight, way: float) -> dict[str, float]:
        """Return depth and force by the capsule that has this outline; NaN where none has."""
        plan = self._plan
        assert self._reference is not None
        seen = sight.dimple * plan.pixel_size
        if sight.dimple < _LEAST_DIMPLE:
            return {"depth_um": seen} if seen > 0 else {}
        fit = self._capsule(sight, way)
        if fit is None:
            self._unread += 1
            if plan.wanted == "force" and self._unread >= plan.most_lost:
                raise EndRun(
                    f"lost: no capsule has the outline's dimple of {seen:.1f} µm, "
                    f"in {self._unread} frames in a row"
                )
            return {"depth_um": seen}
        self._unread = 0
        self._shape = (fit.modulus, fit.inflation)
        force = np.nan if plan.modulus is None else plan.modulus / fit.modulus
        return {
            "depth_um": fit.state.depth,
            "force_uN": force,
            "force_std_uN": force * fit.modulus_std / fit.modulus,
        }

    def _capsule(self, sight: Sight, way: float) -> Any:
        """Return the capsule that has this outline and the dimple that is seen, or None."""
        plan = self._plan
        assert self._reference is not None
        outline = sight.outline[:: max(1, len(sight.outline) // _FIT_POINTS)]
        first = ((1 / (soft * plan.thickness * way), grown) for soft, grown in _FIRST_SHAPES)
        # Without a start the outline itself says where to begin, which takes ten times as long.
        for start in (*((self._shape,) if self._shape else first), None):
            try:
                # Of the force that is given the shape knows only F/(E h R).
                fit = fit_capsule(
                    1.0,
                    plan.pixel_size * outline * (1, -1),
                    thickness=plan.thickness,
                    probe_half_width=plan.probe_half_width,
                    radius=self._reference.radius * plan.pixel_size,
                    law=plan.law,
                    start=start,
                )
            except ValueError:
                continue  # no capsule is like it
            if abs(fit.state.depth / (sight.dimple * plan.pixel_size) - 1) < _ASTRAY:
                return fit
        return None

    def _withdraw(self) -> None:
        """Go back to where the pipette hung over the egg."""
        for advance in np.linspace(self._advance, 0.0, _LOOKS_BACK + 1)[1:]:
            self._go(float(advance))
            look = self._look("withdraw")
            self._follow(look)
            look.row["approach_um"] = self._advance - self._touched
            self._tell(look.row)
