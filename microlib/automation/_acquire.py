"""Drive the focus through a stack, and reconstruct or focus while the frames come."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import (
    Array,
    Ending,
    EndRun,
    Guard,
    Image,
    Region,
    RunInterrupt,
    Tidy,
    as_array,
    as_region,
    check_callable,
    check_devices,
    scalar,
    whole,
)
from microlib.automation._live import BACK, STANDS_OUT, LiveDepth, coarse_range
from microlib.focus import FocusResult, check_options, sum_modified_laplacian

#: Side of a region whose sharpness is measured, px.
_LEAST_SIDE = 8


@dataclass(frozen=True, eq=False, repr=False)
class Acquisition(Tidy, Ending):
    """What a drive of the focus brought.

    Attributes
    ----------
    positions : ndarray, shape (n,)
        Where frames were taken for the depth, µm, in order; of a scan that ended before its time
        also those of the coarse look.
    images : tuple of ndarray, shape (rows, cols)
        The frames at `positions`.
    frames : int
        Pictures that were taken in all, the coarse ones included.
    result : FocusResult or None
        The depth, as `microlib.focus.depth_from_focus` makes it of the frames that were taken for
        it; None if they are fewer than three, if it failed, or from `autofocus`.
    focus : float
        Where the drive stands at the end, µm; from `autofocus` the sharpest position. NaN if the
        drive does not say.
    reason : str
        Why it ended: what an early end rests on, that all positions were visited, or what failed.
    complete : bool
        Whether it ended as it should.
    still : bool
        Whether the drive said, after the stop, that it does not move.
    error : Exception or None
        The exception behind `reason`, if there is one.
    """

    positions: Array
    images: tuple[Image, ...]
    frames: int
    result: FocusResult | None
    focus: float
    _large = ("positions", "images", "result")


def acquire_depth(
    workstation: Any,
    positions: ArrayLike,
    *,
    farthest: float | None = None,
    coarse: int | None = None,
    timeout: float = 10.0,
    progress: Callable[[LiveDepth], object] | None = None,
    **options: Any,
) -> Acquisition:
    """Take a focal stack with the focus drive, and end as soon as every part has been seen.

    Parameters
    ----------
    workstation : object with ``camera``, ``focus`` and ``clock``
        `microlib.servoing.SimulatedWorkstation`, `microlib.servoing.MicroManager`, or anything with
        their methods.
    positions : array_like, shape (n,)
        Of the focus drive, µm, rising or falling, at least three: those of the whole stack.
    farthest : float, optional
        Last position along the scan at which any part can be in focus, µm, see `LiveDepth`. Without
        it and without `coarse` the whole stack is taken.
    coarse : int, optional
        Look at every so many positions first, and take the others only where something came into
        focus. At least 2, and no more than what keeps these looks within the depth of field.
    timeout : float, optional
        Longest time that a device may take to answer, and a move to end, s.
    progress : callable, optional
        Called with the `LiveDepth` after each frame.
    **options
        Of `microlib.focus.depth_from_focus`.

    Returns
    -------
    Acquisition
        ``positions``, ``images``, ``frames``, ``result``, ``focus``, ``reason``, ``complete``,
        ``still`` and ``error``. A fault of a device, of `progress` or of the depth raises nothing
        and loses no picture: look at ``complete``.

    Raises
    ------
    ValueError
        Before anything moves, if an argument is out of range.
    KeyboardInterrupt
        After Ctrl-C, once the drive was stopped; its attribute ``run`` is the `Acquisition`.

    Notes
    -----
    A coarse look sees what comes into focus between two of its frames if that is blurred by about a
    pixel at most half-way. Further apart it misses small parts: of twelve that were 12 px wide it
    found all where half-way meant 1 px, and eight or nine where it meant 1.5 to 1.8. What has no
    texture is not found by any look.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib import synthetic
    >>> from microlib.automation import acquire_depth
    >>> from microlib.servoing import Camera, SimulatedWorkstation, Stage
    >>> texture = synthetic.mixed_texture((48, 48), np.random.default_rng(0))
    >>> flat = np.full((48, 48), 42.0)
    >>> workstation = SimulatedWorkstation(
    ...     lambda feature, z: synthetic.focal_stack(texture, flat, [z], blur_rate=0.1)[0],
    ...     jacobian=np.eye(2), stage=Stage(100.0), camera=Camera(0.01), rng=0,
    ...     focus_drive=Stage(500.0))
    >>> run = acquire_depth(workstation, np.arange(0.0, 200.0, 10.0), farthest=50.0)
    >>> run.frames, run.complete, round(float(run.result.depth[24, 24]))
    (8, True, 42)
    """
    check_devices(workstation, "focus")
    z = _scan(positions)
    every = None if coarse is None else whole("coarse", coarse, least=2, most=len(z))
    check_callable("progress", progress, optional=True)
    drive, needs = _Drive(workstation, z, timeout), check_options(**options)
    live = LiveDepth(farthest=farthest, **options)
    waiting: dict[float, Image] = {}

    def work() -> str:
        def taken(k: int) -> Image:
            if z[k] not in waiting:
                waiting[z[k]] = drive.frame(k)
                if drive.frames == 1:
                    needs.check_frame(waiting[z[k]])
            return waiting[z[k]]

        first, last, said = 0, len(z) - 1, "all positions were visited"
        if every is not None:
            looks = [taken(k) for k in range(0, len(z), every)]
            found = coarse_range(looks, every, len(z))
            if found is None:
                raise EndRun("nothing comes into focus in the coarse frames")
            first, last = found
            said = f"a look at every {every} positions found nothing beyond those taken"
            # Backwards from where the coarse look ended is as good, and nothing is visited twice.
        for k in range(first, last + 1):
            live.push(taken(k), z[k])
            del waiting[z[k]]
            if progress is not None:
                progress(live)
            if live.done:
                said = live.reason
                break
        waiting.clear()
        return said

    return _finish(drive, work, live, waiting)


def autofocus(
    workstation: Any,
    positions: ArrayLike,
    *,
    region: Region | None = None,
    timeout: float = 10.0,
) -> Acquisition:
    """Bring the focus drive to where the image is sharpest.

    Parameters
    ----------
    workstation : object with ``camera``, ``focus`` and ``clock``
        As for `acquire_depth`.
    positions : array_like, shape (n,)
        Of the focus drive, µm, rising or falling, at least three, to look at.
    region : tuple of int, optional
        Part of the image that counts, (x, y, width, height) in px; all of it by default.
    timeout : float, optional
        Longest time that a device may take to answer, and a move to end, s.

    Returns
    -------
    Acquisition
        ``focus`` is where the drive was brought, the vertex of the measure's Gaussian through the
        best position and its neighbors. If the best is the first or the last, or nothing stands
        out, ``complete`` is False and the drive stands at the best position.

    Raises
    ------
    ValueError
        Before anything moves, if an argument is out of range.
    KeyboardInterrupt
        After Ctrl-C, once the drive was stopped; its attribute ``run`` is the `Acquisition`.

    Notes
    -----
    The measure is the mean sum-modified-Laplacian (3.10)–(3.12). The scan turns round once the best
    lies three frames back, stands out by a factor of 2.5 and has fallen to half.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib import synthetic
    >>> from microlib.automation import autofocus
    >>> from microlib.servoing import Camera, SimulatedWorkstation, Stage
    >>> texture = synthetic.mixed_texture((48, 48), np.random.default_rng(0))
    >>> flat = np.full((48, 48), 42.0)
    >>> workstation = SimulatedWorkstation(
    ...     lambda feature, z: synthetic.focal_stack(texture, flat, [z], blur_rate=0.1)[0],
    ...     jacobian=np.eye(2), stage=Stage(100.0), camera=Camera(0.01), rng=0,
    ...     focus_drive=Stage(500.0))
    >>> run = autofocus(workstation, np.arange(0.0, 200.0, 10.0))
    >>> run.complete, run.frames < 20, abs(run.focus - 42) < 2
    (True, True, True)
    """
    check_devices(workstation, "focus")
    z = _scan(positions)
    part = None if region is None else as_region("region", region, least=_LEAST_SIDE)
    drive = _Drive(workstation, z, timeout)

    def work() -> str:
        measures: list[float] = []
        for k in range(len(z)):
            measures.append(_sharpness(drive.frame(k), part))
            best = int(np.argmax(measures))
            clear = measures[best] > STANDS_OUT * min(measures)
            if clear and k - best >= BACK and measures[-1] < measures[best] / 2:
                break
        if not clear or best in (0, len(z) - 1):
            drive.go(z[best])
            end = "the sharpest position is an end of those given"
            raise EndRun(end if clear else "no position is clearly sharper than the others")
        drive.go(_vertex(z[best - 1 : best + 2], np.array(measures[best - 1 : best + 2])))
        return "the sharpest position was passed and gone back to"

    return _finish(drive, work, None, {})


class _Drive:
    """The focus drive and the camera, each call watched."""

    def __init__(self, workstation: Any, positions: Array, timeout: float) -> None:
        limit = scalar("timeout", timeout, above=0, most=1e9)
        self.guard = Guard(workstation.clock, workstation.focus, limit, "focus drive")
        self.frames = 0
        self.positions, self._workstation = positions, workstation
        # From half of the least spacing on, it stands at another position.
        self._room = float(np.abs(np.diff(positions)).min()) / 2

    def go(self, z: float) -> None:
        """Bring the drive to a position, µm, and wait."""
        self.guard.call(self._workstation.focus.move_to, np.array([z]))
        self.guard.settle()
        missed = abs(self.where() - z)
        if missed > self._room:
            raise EndRun(f"the focus drive stands {missed:.3g} µm from where it was sent")

    def where(self) -> float:
        place = self.guard.call(self._workstation.focus.position)
        return float(np.asarray(place, dtype=float)[0])

    def frame(self, k: int) -> Image:
        """Take the picture at position number `k`."""
        self.go(float(self.positions[k]))
        frame, _ = self.guard.call(self._workstation.camera.snap)
        self.frames += 1
        return np.array(frame)


def _finish(
    drive: _Drive, work: Callable[[], str], live: LiveDepth | None, waiting: dict[float, Image]
) -> Acquisition:
    """Do the work, stop the drive however it ended, and say what happened.

    `waiting` has the pictures, by their positions, that `live` was not given.
    """
    end = drive.guard.run(work)
    pictures, result = waiting, None
    if live is not None:
        pictures |= zip(live.positions, live.images, strict=True)
        try:
            result = live.result() if live.frames >= 3 else None
        except (Exception, KeyboardInterrupt) as fault:  # of the user's measure, for one
            if isinstance(fault, KeyboardInterrupt):
                drive.guard.interrupted.set()
            reason = f"{end.reason}; {type(fault).__name__}: {fault}"
            end = Ending(reason, False, end.still, end.error or fault)
    try:
        focus = drive.where()
    except EndRun:
        focus = float("nan")  # the reason says already what failed
    places = [z for z in drive.positions.tolist() if z in pictures]
    run = Acquisition(
        **vars(end),
        positions=np.array(places),
        images=tuple(pictures[z] for z in places),
        frames=drive.frames,
        result=result,
        focus=focus,
    )
    if drive.guard.interrupted.is_set():
        raise RunInterrupt(run)
    return run


def _scan(positions: ArrayLike) -> Array:
    z = as_array("positions", positions, shape=(None,))
    gaps = np.diff(z)
    if len(z) < 3 or not ((gaps > 0).all() or (gaps < 0).all()):
        raise ValueError(
            f"positions must be at least three that rise or fall strictly, got {len(z)}"
        )
    return z


def _sharpness(frame: Image, part: Region | None) -> float:
    whole_frame = (0, 0, *frame.shape[::-1])
    x, y, width, height = as_region("region", part or whole_frame, frame.shape, least=_LEAST_SIDE)
    return float(sum_modified_laplacian(frame[y : y + height, x : x + width]).mean())


def _vertex(z: Array, measures: Array) -> float:
    """Return the vertex of the Gaussian through three measures, between the outer positions."""
    # One that sees nothing at all has a logarithm, too.
    seen = np.maximum(measures, 1e-6 * measures.max())
    curve = np.polyfit(z - z[1], np.log(seen), 2)
    return float(np.clip(z[1] - curve[1] / (2 * curve[0]), z.min(), z.max()))
