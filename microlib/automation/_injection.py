"""Bring a pipette onto an egg and press it to a force or a depth, by sight alone."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from microlib._common import (
    Array,
    EndRun,
    Guard,
    Tidy,
    Workstation,
    as_array,
    check_callable,
    check_devices,
    flag,
    interrupts,
    one_of,
    positive,
    scalar,
    whole,
)
from microlib.automation._press import COLUMNS, Plan, Press

#: What a stage must answer to.
_MOVES = ("position", "move_to", "moving", "stop")
#: Edges of an image that a pipette may come from.
_DIRECTIONS = ("auto", "top", "bottom", "left", "right")
#: Of any length, force or modulus: beyond, products leave the range of numbers.
_MOST = 1e9


@dataclass(frozen=True)
class InjectionRun(Tidy):
    """What `inject` did.

    Attributes
    ----------
    log : pandas.DataFrame
        One row a frame, and a last one after the stage was stopped; the columns are in the notes of
        `inject`.
    reached : bool
        Whether the target was reached.
    reason : str
        Why the run ended early; empty if it did not.
    still : bool
        Whether the stage said, after the stop, that it does not move.
    contact : ndarray, shape (2,)
        Of the stage where the egg was first seen to yield, µm; NaN if it never came to that.
    depth : float
        Of the dimple where the target was reached, µm; NaN if it was not.
    force, force_std : float
        Force there and its standard deviation from the outline alone, µN; NaN without a modulus.
    jacobian : ndarray, shape (2, 2)
        px/µm that the run used, in the image turned so that the pipette comes from above.
    error : Exception or None
        The exception behind `reason`, if there is one.
    frames : tuple of ndarray
        The pictures, if they were to be kept.
    """

    log: pd.DataFrame
    reached: bool
    reason: str
    still: bool
    contact: Array
    depth: float
    force: float
    force_std: float
    jacobian: Array
    error: BaseException | None
    frames: tuple[NDArray[Any], ...]

    _large = ("log", "frames")

    def to_frame(self) -> pd.DataFrame:
        """Return `log`.

        Returns
        -------
        pandas.DataFrame
            One row a frame.
        """
        return self.log


class InjectionInterrupt(KeyboardInterrupt):
    """Ctrl-C, after the stage was stopped; `run` is what was done until then."""

    def __init__(self, run: InjectionRun) -> None:
        super().__init__(run.reason)
        self.run = run


def inject(
    workstation: Workstation,
    *,
    pixel_size: float,
    probe_half_width: float,
    thickness: float,
    travel: ArrayLike,
    depth: float | None = None,
    force: float | None = None,
    modulus: float | None = None,
    law: str = "neo-hooke",
    tolerance: float = 0.02,
    approach_step: float = 0.5,
    press_step: float = 10.0,
    hold: float = 0.0,
    jacobian: ArrayLike | None = None,
    direction: str = "auto",
    region: tuple[int, int, int, int] | None = None,
    most_lost: int = 3,
    timeout: float = 10.0,
    progress: Callable[[dict[str, Any]], object] | None = None,
    keep_frames: bool = False,
) -> InjectionRun:
    """Press a pipette on an egg to a force or a depth that the egg's outline tells, and withdraw.

    The stage carries the pipette, the camera stands. Pipette and egg are found in the first frame
    by `microlib.embryo.extract_boundary`; `microlib.servoing.servo` brings the pipette over the
    middle of the egg; it comes down in small steps until the outline sinks, which is the contact;
    it presses until the outline is that of the capsule with the wanted force or depth; and goes
    back. However the run ends (at the target, because pipette or egg are lost, a device fails or
    hangs, or by Ctrl-C), the stage is stopped and asked whether it stands still.

    Parameters
    ----------
    workstation : object with ``camera``, ``stage`` and ``clock``
        `microlib.servoing.SimulatedWorkstation`, `microlib.servoing.MicroManager`, or anything with
        their methods.
    pixel_size : float
        Pixel in the object plane, µm.
    probe_half_width, thickness : float
        Half of the width c of the pipette's flat end and thickness h of the egg's wall free of
        stress, µm.
    travel : float or array_like, shape (2,)
        How far either axis of the stage may go from where it is at the start, ± µm.
    depth : float, optional
        Depth of the dimple to press to, µm. Give this or `force`.
    force : float, optional
        Force to press to, µN, which needs `modulus`.
    modulus : float, optional
        Elastic modulus of the wall, MPa, for example by `microlib.embryo.modulus_from_image` from
        an egg that was pressed with a known force.
    law : {"neo-hooke", "hooke", "mooney-rivlin"}, optional
        Of the wall, incompressible.
    tolerance : float, optional
        Share by which the target may be missed from below.
    approach_step : float, optional
        Of the steps before contact, µm: contact is seen two to three of them late.
    press_step : float, optional
        Longest step after contact, µm. Near the target the steps get shorter.
    hold : float, optional
        For how long the pipette stays at the target, s.
    jacobian : array_like, shape (2, 2), optional
        px/µm of a run before, `InjectionRun.jacobian`; calibrated by default.
    direction : {"auto", "top", "bottom", "left", "right"}, optional
        Edge of the image that the pipette comes from.
    region : tuple of int, optional
        Part of the image to look at, (x, y, width, height) in px.
    most_lost : int, optional
        Frames in a row without pipette or egg that end the run; the stage stands from the first.
    timeout : float, optional
        Longest time that a device may take to answer, and a move to end, s.
    progress : callable, optional
        Called with each row of the log, a dict, as it is complete.
    keep_frames : bool, optional
        Whether to keep the pictures.

    Returns
    -------
    InjectionRun
        ``log`` (a data frame, one row a frame), ``reached``, ``reason`` (why it ended early, or
        empty), ``still``, ``contact`` (of the stage, µm), ``depth`` (µm), ``force`` and
        ``force_std`` (µN), ``jacobian`` (2×2, px/µm), ``error`` and ``frames``. A fault of a device
        or a lost pipette raises nothing: look at ``reached`` before you go on.

    Raises
    ------
    ValueError
        Before anything moves, if an argument is out of range.
    KeyboardInterrupt
        After Ctrl-C, once the stage was stopped; its attribute ``run`` is the `InjectionRun`.

    Notes
    -----
    The pipette must begin at least 23 px above the egg (10 px with a Jacobian), within the travel
    of its middle. The egg has to be a sphere whose outline is seen from its crown down to near its
    widest part: its radius is that of the circle through the untouched outline.

    Contact is where the outline near the pipette lies more than four standard deviations of the
    frames before below the untouched one, twice in a row. An egg that moves earlier than 2 px
    before the place where the pipette's end should touch, or not until 2 px after it, ends the run;
    so do a picture that does not change when the stage moves, a pipette that does not go where the
    commands lead it, a stage that does not arrive, a `pixel_size` that is not the stage's, and an
    outline that springs back under the pipette.

    Force and depth are those of `microlib.membrane.fit_capsule` at the untouched radius. The shape
    knows F/(E h R) and the inflation, so that an error of the modulus is one of the force. What the
    model leaves out, such as bending, a perivitelline space that leaks, or an egg that is no
    sphere, is in neither.

    The columns of the log are ``time_s`` from the first exposure; ``phase`` (start, calibration,
    line up, approach, press, withdraw, end); ``stage``, the encoder before the frame, µm; ``tip``
    of the pipette, px; ``gap_um``, how far it still has to go as first seen; ``sunk_um``, of the
    outline near it; ``approach_um``, its way since contact; ``depth_um``, ``force_uN`` and
    ``force_std_uN`` by the outline; ``lost``; ``event``.

    Examples
    --------
    >>> from microlib.servoing import Camera, SimulatedWorkstation, Stage
    >>> from microlib.synthetic import InjectionScene
    >>> scene = InjectionScene(
    ...     1, modulus=1.0, radius=300.0, strongest=30.0, pixel_size=4.0, shape=(200, 200),
    ...     probe_half_width=20.0)
    >>> jacobian = [[0.25, 0.0], [0.0, 0.25]]
    >>> workstation = SimulatedWorkstation(
    ...     lambda tip, focus: scene.frame(tip), home=scene.home, rng=0, jacobian=jacobian,
    ...     stage=Stage(saturation=400.0), camera=Camera(interval=0.03, latency=0.02))
    >>> run = inject(
    ...     workstation, pixel_size=4.0, probe_half_width=20.0, thickness=3.0, travel=500.0,
    ...     depth=8.0, jacobian=jacobian, approach_step=1.0)
    >>> run.reached, run.still, round(run.depth)
    (True, True, 8)
    """
    check_devices(workstation, camera=("snap",), stage=_MOVES, clock=("now", "sleep"))
    check_callable("progress", progress, optional=True)
    wanted, target = _target(depth, force, modulus)
    plan = Plan(
        pixel_size=scalar("pixel_size", pixel_size, above=0, most=_MOST),
        probe_half_width=scalar("probe_half_width", probe_half_width, above=0, most=_MOST),
        thickness=scalar("thickness", thickness, above=0, most=_MOST),
        modulus=None if modulus is None else scalar("modulus", modulus, above=0, most=_MOST),
        law=one_of("law", law, ("neo-hooke", "hooke", "mooney-rivlin")),
        target=target,
        wanted=wanted,
        tolerance=scalar("tolerance", tolerance, within=(0.0, 1.0)),
        travel=_pair("travel", travel),
        approach_step=scalar("approach_step", approach_step, above=0, most=_MOST),
        press_step=scalar("press_step", press_step, above=0, most=_MOST),
        jacobian=None if jacobian is None else as_array("jacobian", jacobian, shape=(2, 2)),
        direction=one_of("direction", direction, _DIRECTIONS),
        region=_region(region),
        hold=scalar("hold", hold, least=0, most=_MOST),
        most_lost=whole("most_lost", most_lost, least=1),
        timeout=scalar("timeout", timeout, above=0, most=_MOST),
        progress=progress,
        keep_frames=flag("keep_frames", keep_frames),
    )
    if plan.press_step < plan.approach_step:
        raise ValueError(
            f"press_step must be at least approach_step, {plan.approach_step:g} µm, got "
            f"{plan.press_step:g} µm"
        )
    guard = Guard(workstation.clock, workstation.stage, plan.timeout)
    return _run(Press(workstation, guard, plan), workstation)


def _run(press: Press, workstation: Workstation) -> InjectionRun:
    """Run the loop, stop the stage however it ended, and say what happened."""
    guard, reason = press.guard, ""
    error: BaseException | None = None
    with interrupts(guard.interrupted):
        try:
            press.run()
        except EndRun as end:
            reason, error = str(end), end.__cause__
        except Exception as fault:  # of `progress`
            reason, error = f"{type(fault).__name__}: {fault}", fault
        finally:
            trouble = guard.halt()
    if guard.interrupted.is_set() and not reason:
        reason = "interrupted by the user"
    if trouble:
        reason = "; ".join(filter(None, (reason, f"the stage may not stand still: {trouble}")))
    last: dict[str, Any] = {"time_s": press.now(), "phase": "end", "lost": False}
    last["event"] = reason or "done"
    with suppress(EndRun):  # the reason says already what failed
        place = np.asarray(guard.call(workstation.stage.position), dtype=float)
        last["stage_x_um"], last["stage_y_um"] = map(float, place)
    log = pd.DataFrame([*press.rows, last], columns=list(COLUMNS)).astype(COLUMNS)
    run = InjectionRun(
        log=log,
        reached=press.reached,
        reason=reason,
        still=not trouble,
        contact=press.contact,
        depth=press.best["depth_um"],
        force=press.best["force_uN"],
        force_std=press.best["force_std_uN"],
        jacobian=press.jacobian,
        error=error,
        frames=tuple(press.frames),
    )
    if guard.interrupted.is_set():
        raise InjectionInterrupt(run)
    return run


def _target(depth: float | None, force: float | None, modulus: float | None) -> tuple[str, float]:
    """Return what is to be reached, and its value."""
    if (depth is None) == (force is None):
        given = "both" if depth is not None else "none"
        raise ValueError(f"depth or force must be given, and only one of them, got {given}")
    if depth is not None:
        return "depth", scalar("depth", depth, above=0, most=_MOST)
    if modulus is None:
        raise ValueError("modulus must be given for a force, got None")
    return "force", scalar("force", force, above=0, most=_MOST)


def _region(region: tuple[int, int, int, int] | None) -> tuple[int, int, int, int] | None:
    """Return a region of whole numbers; whether the image has it is seen in the first frame."""
    if region is None:
        return None
    if not isinstance(region, (tuple, list)) or len(region) != 4:
        raise ValueError(f"region must be (x, y, width, height), got {region!r}")
    x, y, width, height = (whole("region", value, least=0) for value in region)
    return x, y, width, height


def _pair(name: str, value: ArrayLike) -> Array:
    numbers = positive(name, value)
    return as_array(name, np.broadcast_to(numbers, 2) if numbers.ndim == 0 else numbers, shape=(2,))
