"""Visual servoing of a stage: one loop for a simulated and a real microscope."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, FlatResult, as_array, as_instance, as_scalar
from microlib.servoing._control import full_rank, of_two_axes
from microlib.servoing._devices import EndRun, InterruptGate, check_devices, stop_stage
from microlib.servoing._loop import USABLE_TRAVEL, Loop, LoopOptions, add_event, new_row, put

if TYPE_CHECKING:
    import pandas as pd

#: Time after Ctrl-C in which another one is ignored, s: the key may be pressed twice.
_DEBOUNCE = 0.3


@dataclass(frozen=True, eq=False, repr=False)
class ServoRun(FlatResult):
    """Result of `servo`.

    Attributes
    ----------
    log : pandas.DataFrame
        One row a frame, and a last one after the stage was stopped; the columns are in the notes of
        `servo`.
    reached : ndarray of bool, shape (N,)
        Which targets were reached.
    reason : str
        Why the run ended early; empty if it did not.
    still : bool
        Whether the stage reported, after the stop, that it does not move.
    jacobian : ndarray, shape (2, 2)
        px/µm that the run used: given, or calibrated; NaN if it never came to that.
    jacobian_covariance : ndarray, shape (4, 4)
        Of its elements row by row, px²/µm²; NaN if it was given.
    drift : ndarray, shape (2,)
        px/s by which the feature moves without the stage, fitted with J during calibration; NaN if
        there was none. The loop does not compensate it.
    reduced_chi2 : float
        χ² per degree of freedom of the calibration. Above 1 the tracks scatter more than their
        covariances state, and `jacobian_covariance` is enlarged by it; NaN if there was none.
    error : Exception or None
        The exception behind `reason`, if there is one.
    """

    _parts = (("jacobian", ("x", "y"), ("x", "y")),)

    log: pd.DataFrame
    reached: NDArray[np.bool_]
    reason: str
    still: bool
    jacobian: Array
    jacobian_covariance: Array
    drift: Array
    reduced_chi2: float
    error: BaseException | None

    _large = ("reached", "log", "jacobian_covariance")


class RunInterrupt(KeyboardInterrupt):
    """Ctrl-C, raised when the stage was stopped; `run` is the result until then."""

    def __init__(self, run: ServoRun) -> None:
        super().__init__(run.reason)
        self.run = run


def servo(
    workstation: Any,
    tracker: Any,
    targets: ArrayLike,
    *,
    travel: ArrayLike,
    jacobian: ArrayLike | None = None,
    test_move: float | None = None,
    tolerance: float = 0.05,
    longest_move: float | None = None,
    timeout: float = 10.0,
    progress: Callable[[dict[str, Any]], object] | None = None,
) -> ServoRun:
    """Bring a tracked feature to targets by moving the stage under the camera.

    Without a Jacobian, the stage first makes small test moves in ±x and ±y, and J and a drift are
    fitted to the measured features. Then the loop takes a frame, measures the feature f, and moves
    the stage by J⁻¹ (target − f), until every target is reached. This is the only control law of
    `servo`; other controllers are compared with `simulate`. Each frame is taken while the stage
    stands, so that delays do not matter. At the end (all targets reached, a limit, a lost feature,
    a device that raises an error, or Ctrl-C), the stage is stopped and is asked whether it stands
    still.

    Parameters
    ----------
    workstation : object with ``camera``, ``stage`` and ``clock``
        `SimulatedWorkstation`, `MicroManager`, or anything with their methods.
    tracker : object with a method ``track(frame)``
        Started on a frame of this camera, such as `microlib.tracking.ESMTracker`. What ``track``
        returns has ``center``, (x, y) px, ``lost`` and ``covariance``, 2×2 px².
    targets : array_like, shape (N, 2) or (2,)
        Where the feature is to go, one after the other: (x, y) in px of the image.
    travel : float or array_like, shape (2,)
        How far either axis may go from where it is at the start, ± µm. There is no default, since
        only the user knows where parts would collide. A hundredth of it is left for the overshoot
        of the drive; a target beyond the travel ends the run before any move to a target.
    jacobian : array_like, shape (2, 2), optional
        px/µm, for example of a run before; calibrated by default.
    test_move : float, optional
        Length of the test moves in µm; a tenth of the smaller travel by default. About 10 px in the
        image are good: the standard deviation of J is that of the tracker divided by the move.
    tolerance : float, optional
        A target is reached within this distance, px.
    longest_move : float, optional
        Length of the longest move between two frames, µm; the travel alone limits it by default.
    timeout : float, optional
        Longest time that a move may take, s.
    progress : callable, optional
        Called with each row of the log, a dict, as it is complete. The last row, which is added
        after the stop, is not sent. If the run ends early, the row of its last frame may be
        missing, too. The log of the result contains both.

    Returns
    -------
    ServoRun
        The log, which targets were reached, why the run ended early if it did, and the calibrated
        Jacobian. A fault of a device or a lost feature raises nothing: look at ``reached`` before
        you go on.

    Raises
    ------
    ValueError
        Before anything moves, if an argument is out of range.
    KeyboardInterrupt
        After Ctrl-C, once the stage was stopped, so that a script does not go on to its next move;
        its attribute ``run`` is the `ServoRun`.

    Notes
    -----
    A calibration is rejected if three standard deviations of J in its worst direction exceed
    half of its least singular value: a move computed from such a J could remove less than half of
    the error. The run also ends if the motion in the image deviates from the commanded motion by
    more than half of it, three times in a row. The cause may be a wrong Jacobian, a stuck or
    reversed axis, or a frozen frame. One or two such deviations may be a wrong track and its
    correction.

    A call to a device that does not return blocks the run until Ctrl-C; set the timeouts of the
    device itself. The stage then goes at most to its last command, which is within the travel.

    The columns of the log are ``time_s`` from the first exposure; ``phase`` (start, calibration,
    servo, end); ``target``, its number, or −1; ``reference``, ``measured`` in px; ``lost``;
    ``stage``, the encoder before the frame, and ``command``, where it is sent after it, µm;
    ``latency_s`` from the exposure until the tracker has answered; ``event``. The last row holds
    where the stage stopped, and why.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.servoing import CameraTiming, SimulatedWorkstation, StageModel, servo
    >>> from microlib.synthetic import gripper_scene
    >>> from microlib.tracking import ESMTracker
    >>> rng = np.random.default_rng(0)
    >>> scene = gripper_scene(rng, pixel_size=6.23)
    >>> workstation = SimulatedWorkstation(
    ...     lambda feature: scene.frame(feature - scene.home, rng), home=scene.home,
    ...     jacobian=[[0.0, 0.16], [0.16, 0.0]], stage=StageModel(saturation=400.0),
    ...     camera=CameraTiming(interval=0.03, latency=0.02), rng=rng)
    >>> frame, _ = workstation.camera.snap()
    >>> tracker = ESMTracker(frame, scene.box(50), "translation")
    >>> run = servo(workstation, tracker, scene.home + (30, -20), travel=500.0)
    >>> print(run.reached, run.still, (workstation.feature - scene.home).round())
    [ True] True [ 30. -20.]
    """
    check_devices(workstation)
    if not callable(getattr(tracker, "track", None)):
        raise ValueError(f"tracker must have a method track, got {type(tracker).__name__}")
    limits = of_two_axes("travel", travel)
    shortest = float(limits.min())
    longest = USABLE_TRAVEL * shortest
    if longest_move is not None:
        longest = min(longest, as_scalar("longest_move", longest_move, above=0))
    move = min(shortest / 10, longest) if test_move is None else test_move
    options = LoopOptions(
        targets=as_array("targets", np.atleast_2d(as_array("targets", targets)), shape=(None, 2)),
        travel=limits,
        test_move=as_scalar("test_move", move, above=0, most=longest),
        tolerance=as_scalar("tolerance", tolerance, above=0),
        longest_move=longest_move,
        timeout=as_scalar("timeout", timeout, above=0),
        progress=progress or (lambda row: None),
    )
    as_instance("progress", options.progress, Callable)
    given = None if jacobian is None else full_rank(jacobian, (2, 2))
    loop = Loop(workstation, tracker, options)
    reason = ""
    error: BaseException | None = None
    with InterruptGate() as gate:
        try:
            try:
                gate.is_open = True
                loop.run(given)
            finally:
                gate.is_open = False
        except EndRun as end:
            reason = str(end)
        except BaseException as fault:  # of a device, a tracker, `progress` or by Ctrl-C
            gate.is_open = False  # Ctrl-C can precede the same line above.
            pressed = isinstance(fault, KeyboardInterrupt)
            reason = "interrupted by the user" if pressed else f"{type(fault).__name__}: {fault}"
            error = fault
        trouble = stop_stage(workstation, options.timeout)
        reason = "; ".join(filter(None, (reason, trouble)))
        run = _result(loop, reason, not trouble, error)
        if isinstance(error, KeyboardInterrupt):
            time.sleep(_DEBOUNCE)
    if isinstance(error, KeyboardInterrupt):
        raise RunInterrupt(run) from None
    if error is not None and not isinstance(error, Exception):
        raise error  # such as SystemExit, now that the stage was stopped
    return run


def _result(loop: Loop, reason: str, still: bool, error: BaseException | None) -> ServoRun:
    import pandas as pd  # here, as it takes long to import

    last = new_row(loop.now(), "end", -1)
    with suppress(Exception):  # the reason states already what failed
        put(last, "stage", loop.workstation.stage.position(), "um")
    add_event(last, reason or "done")
    return ServoRun(
        log=pd.DataFrame([*loop.rows, last]),
        reached=loop.reached,
        reason=reason,
        still=still,
        jacobian=loop.motion.jacobian,
        jacobian_covariance=loop.motion.covariance,
        drift=loop.motion.drift,
        reduced_chi2=loop.motion.reduced_chi2,
        error=error,
    )
