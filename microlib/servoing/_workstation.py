"""A simulated microassembly workstation: stage, camera and the visual loop closed over them.

The stage runs at the commanded velocity, up to its saturation, so that the loop's time step
is the camera's and no integration error enters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, FlatResult, as_array, as_generator, as_instance, as_scalar
from microlib.servoing._control import full_rank

#: The control law of `simulate`: from the number k of the sample, the measured feature (px, NaN if
#: lost) and all references, shape (K, 2), to a velocity in µm/s. With N runs at once, feature and
#: velocity have the shape (N, 2). It is called once for each sample, in order. A run begins with
#: k = 0, at which a controller that keeps a state must forget the run before.
Controller = Callable[[int, Array, Array], Array]

#: Given the true feature (px), returns the measured one; NaN if it is lost.
Observer = Callable[[Array], Array]


@dataclass(frozen=True)
class StageModel:
    """Parameters of a simulated two-axis stage, which has its own position loop.

    Attributes
    ----------
    saturation : float
        Largest speed of an axis, µm/s.
    increment : float
        Distance between two positions that the drive can take, µm (0.05 for the stages of §5.1).
    travel : float
        Range of an axis, ± µm around the start (15 mm in all for the stages of §5.1). `simulate`
        checks the reference against it, and does not stop the stage there.
    """

    saturation: float
    increment: float = 0.05
    travel: float = 7500.0

    def __post_init__(self) -> None:
        for name in ("saturation", "travel"):
            object.__setattr__(self, name, as_scalar(name, getattr(self, name), above=0))
        object.__setattr__(self, "increment", as_scalar("increment", self.increment, least=0))

    def rounded(self, position: Array) -> Array:
        """Return the position rounded to the increments of the drive, µm."""
        position = as_array("position", position)
        if self.increment == 0:
            return position
        return np.rint(position / self.increment) * self.increment


@dataclass(frozen=True)
class CameraTiming:
    """Frame times and image noise of a simulated camera.

    Attributes
    ----------
    interval : float
        Time between exposures, s; in `SimulatedWorkstation` the shortest time.
    latency : float
        In `simulate`, time from an exposure until the command computed from it takes effect, s. In
        `SimulatedWorkstation`, time from an exposure until ``snap`` returns, s.
    jitter : float
        Standard deviation in px of a shake of the whole image, along either axis and anew in each
        frame.
    """

    interval: float
    latency: float = 0.0
    jitter: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "interval", as_scalar("interval", self.interval, above=0))
        for name in ("latency", "jitter"):
            object.__setattr__(self, name, as_scalar(name, getattr(self, name), least=0))


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(FlatResult):
    """Result of `simulate`: arrays with one row per frame, and a first axis for several runs.

    Attributes
    ----------
    time : ndarray, shape (K,)
        Of the exposures, s.
    reference, feature, measured : ndarray, shape (K, 2)
        Wanted, true and measured feature in px; a lost measurement is NaN.
    position : ndarray, shape (K, 2)
        Of the stage, µm from the start.
    command : ndarray, shape (K, 2)
        Velocity computed from each frame and clipped to the saturation, µm/s. It acts `latency`
        after the exposure.
    saturated : ndarray of bool, shape (K,)
        Where more was asked for than the stage can do.
    """

    _large = ("time", "reference", "feature", "measured", "position", "command", "saturated")

    time: Array
    reference: Array
    feature: Array
    measured: Array
    position: Array
    command: Array
    saturated: NDArray[np.bool_]


def simulate(
    controller: Controller,
    reference: ArrayLike,
    *,
    jacobian: ArrayLike,
    stage: StageModel,
    camera: CameraTiming,
    rng: np.random.Generator | int | Sequence[np.random.Generator],
    start: ArrayLike | None = None,
    observer: Observer | None = None,
) -> Simulation:
    """Simulate the control loop of figure 2.3 frame by frame.

    Parameters
    ----------
    controller : callable
        The control law, called as ``controller(k, measured, reference)`` once for each sample, in
        order, for example an `OptimalController`. It returns the velocity in µm/s. ``k`` is the
        number of the sample; a run begins with 0, at which a controller that keeps a state must
        forget the run before. ``measured`` is the feature in px, NaN if it is lost, and
        ``reference`` contains all K references. With N runs, the measured feature and the velocity
        have the shape (N, 2). It may change its copy of ``measured``; ``reference`` is read-only.
    reference : array_like, shape (K, 2)
        Wanted feature at each exposure, px.
    jacobian : array_like, shape (2, 2) or (N, 2, 2)
        The true px/µm of the two axes, which may differ from those of the controller. With N
        Jacobians, N runs are simulated at once.
    stage : StageModel
        Largest speed, increment and travel of the stage.
    camera : CameraTiming
        Interval, latency and jitter of the frames.
    rng : numpy.random.Generator or int, or list of N generators
        Source of the jitter, or its seed; a list has one for each of N runs.
    start : array_like, shape (2,) or (N, 2), optional
        First feature, px; the first reference by default.
    observer : callable, optional
        Given the true feature with its jitter, (x, y) in px, returns the measured one, for example
        by rendering a frame and tracking it; NaN where it is lost. By default the feature is
        measured as it is given. With N runs, both have the shape (N, 2).

    Returns
    -------
    Simulation
        Features, positions and commands, one row a frame. With N runs, all but ``time`` and
        ``reference`` have N as their first axis.

    Raises
    ------
    ValueError
        If a shape does not fit, the Jacobian is singular, or the reference lies beyond the stage's
        travel. A reference that moves faster than the stage is followed as far as it goes and
        ``saturated`` is True there.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.servoing import CameraTiming, StageModel, simulate
    >>> def proportional(k, measured, reference):
    ...     return 10.0 * (reference[k] - measured)
    >>> run = simulate(proportional, np.full((80, 2), 5.0), jacobian=np.eye(2), start=(0, 0),
    ...                stage=StageModel(saturation=100.0), camera=CameraTiming(interval=0.02),
    ...                rng=0)
    >>> run.feature[-1].round(1)
    array([5., 5.])
    """
    as_instance("controller", controller, Callable)
    as_instance("stage", stage, StageModel)
    as_instance("camera", camera, CameraTiming)
    references = as_array("reference", reference, shape=(None, 2)).copy()
    references.flags.writeable = False  # a controller sees it
    matrix = as_array("jacobian", jacobian)
    runs = matrix.shape[:-2]
    matrix = full_rank(matrix, (*runs, 2, 2))
    origin = references[0] if start is None else as_array("start", start)
    origin = as_array("start", origin, shape=(2,) if origin.ndim < 2 else (*runs, 2))
    displacements = np.swapaxes(references - origin[..., None, :], -1, -2)
    needed = np.abs(np.linalg.solve(matrix, displacements)).max()
    if needed > stage.travel:
        raise ValueError(
            f"reference must lie within ±{stage.travel:g} µm of the start, got {needed:.0f} µm"
        )
    count = len(references)
    if isinstance(rng, (list, tuple)):
        noise = np.array([as_generator("rng", each).standard_normal((count, 2)) for each in rng])
    else:
        noise = as_generator("rng", rng).standard_normal((*runs, count, 2))
    jitter = as_array("rng", camera.jitter * noise, shape=(*runs, count, 2))
    samples, part = divmod(camera.latency / camera.interval, 1.0)
    first = int(samples) + 1
    # commands[k + first] is computed at exposure k
    commands = np.zeros((count + first, *runs, 2))
    feature, measured, positions = np.empty((3, count, *runs, 2))
    saturated = np.zeros((count, *runs), bool)
    position = np.zeros((*runs, 2))
    for k in range(count):
        positions[k] = stage.rounded(position)
        feature[k] = origin + (matrix @ positions[k][..., None])[..., 0]
        shaken = feature[k] + jitter[..., k, :]
        measured[k] = shaken if observer is None else observer(shaken)
        command = as_array(
            "command", controller(k, measured[k].copy(), references), shape=(*runs, 2)
        )
        saturated[k] = (np.abs(command) > stage.saturation).any(axis=-1)
        commands[k + first] = np.clip(command, -stage.saturation, stage.saturation)
        position = position + camera.interval * (part * commands[k] + (1 - part) * commands[k + 1])
    return Simulation(
        time=camera.interval * np.arange(count),
        reference=references,
        feature=np.moveaxis(feature, 0, -2),
        measured=np.moveaxis(measured, 0, -2),
        position=np.moveaxis(positions, 0, -2),
        command=np.moveaxis(commands[first:], 0, -2),
        saturated=np.moveaxis(saturated, 0, -1),
    )
