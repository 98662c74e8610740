"""A workstation with its own virtual time that is steered by the same calls as a real one."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, as_array, as_generator, as_instance
from microlib.servoing._control import full_rank
from microlib.servoing._workstation import CameraTiming, StageModel

#: Given where the feature is, (x, y) in px, the frame.
Render = Callable[[Array], ArrayLike]


class SimulatedWorkstation:
    """Simulated camera and stage with simulated time, with the interface that `servo` needs.

    `simulate` contains the loop. This class contains only the devices; `servo` is the loop. The
    devices have the calls of a real microscope. The stage starts at zero.

    Parameters
    ----------
    render : callable
        Given the feature (x, y) in px, returns the grey frame of that moment.
    jacobian : array_like, shape (2, 2)
        The true px/µm of the stage's axes, turned and mirrored as the camera is mounted.
    stage : StageModel
        The model of the stage. Each axis runs at its saturation and none leaves the travel.
    camera : CameraTiming
        The times and the jitter of the camera.
    rng : numpy.random.Generator or int
        Source of the jitter, or its seed.
    home : array_like, shape (2,), optional
        The feature at the start, px.
    drift : array_like, shape (2,), optional
        How the feature moves while the stage stands, px/s.

    Attributes
    ----------
    camera : object with ``snap()``
        Returns the frame and the time of its exposure.
    stage : object with ``position()``, ``move_to(position)``, ``moving()``, ``stop()``
        The two axes of the stage, µm.
    clock : object with ``now()``, ``sleep(seconds)``
        The virtual time; sleeping moves the stage on.
    feature : ndarray, shape (2,)
        Where the feature truly is now, px.

    Raises
    ------
    ValueError
        If a shape does not fit or the Jacobian is singular.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.servoing import CameraTiming, SimulatedWorkstation, StageModel
    >>> workstation = SimulatedWorkstation(
    ...     lambda feature: np.zeros((9, 9)), jacobian=np.eye(2), home=(4, 4),
    ...     stage=StageModel(saturation=100.0), camera=CameraTiming(0.03, latency=0.01), rng=0)
    >>> workstation.stage.move_to(np.array([2.0, -1.0]))
    >>> workstation.clock.sleep(0.01)
    >>> workstation.feature, workstation.stage.moving()
    (array([5., 3.]), True)
    """

    def __init__(
        self,
        render: Render,
        *,
        jacobian: ArrayLike,
        stage: StageModel,
        camera: CameraTiming,
        rng: np.random.Generator | int,
        home: ArrayLike = (0.0, 0.0),
        drift: ArrayLike = (0.0, 0.0),
    ) -> None:
        as_instance("render", render, Callable)
        as_instance("camera", camera, CameraTiming)
        self._jacobian = full_rank(jacobian, (2, 2))
        self._home = as_array("home", home, shape=(2,))
        self._drift = as_array("drift", drift, shape=(2,))
        self.stage = _SimulatedStage(as_instance("stage", stage, StageModel))
        self._now = 0.0
        self.clock = SimpleNamespace(now=lambda: self._now, sleep=self._sleep)
        self.camera = SimpleNamespace(snap=self._snap)
        self._render, self._model, self._rng = render, camera, as_generator("rng", rng)
        self._next = -np.inf  # time of the earliest next exposure

    @property
    def feature(self) -> Array:
        """Where the feature truly is now, (x, y) in px."""
        moved = self._jacobian @ self.stage.position()
        return self._home + moved + self._drift * self.clock.now()

    def _sleep(self, seconds: float) -> None:
        self._now += seconds
        self.stage.advance(seconds)

    def _snap(self) -> tuple[NDArray[Any], float]:
        self.clock.sleep(max(0.0, self._next - self.clock.now()))
        exposed = self.clock.now()
        self._next = exposed + self._model.interval
        shake = self._model.jitter * self._rng.standard_normal(2)
        frame = np.asarray(self._render(self.feature + shake))
        self.clock.sleep(self._model.latency)
        return frame, exposed


class _SimulatedStage:
    """Two axes that go to a position while the clock moves them on."""

    def __init__(self, model: StageModel) -> None:
        self._model = model
        self._position: Array = np.zeros(2)
        self._target: Array = np.zeros(2)

    def position(self) -> Array:
        return self._model.rounded(self._position)

    def moving(self) -> bool:
        return bool((self._position != self._target).any())

    def move_to(self, position: Array) -> None:
        target = as_array("position", position, shape=(2,))
        self._target = np.clip(target, -self._model.travel, self._model.travel)

    def stop(self) -> None:
        self._target = self._position

    def advance(self, duration: float) -> None:
        """Move on by `duration` s."""
        reach = self._model.saturation * duration
        remaining = self._target - self._position
        moved = self._position + np.sign(remaining) * reach
        self._position = np.where(np.abs(remaining) <= reach, self._target, moved)
