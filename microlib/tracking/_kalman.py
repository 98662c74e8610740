"""Where will a point be in the next frame? A Kalman filter with constant velocity."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, as_array, positive

#: Standard deviation (px/s) given to the unknown velocity of the first frame: more than a target
#: moves that stays in view for some frames. From 1 to 10⁴ px/s the benchmark of tracking
#: ("Constants") completes the same sequences.
_UNKNOWN_VELOCITY = 1e3


class KalmanFilter:
    """Constant-velocity Kalman filter of a point in the image (§5.3).

    The state is (x, y, vx, vy). Between frames the velocity performs a random walk driven by a
    white acceleration, and both axes share one covariance because they share one model.

    Parameters
    ----------
    position : array_like, shape (2,)
        First position, (x, y) in px.
    interval : float
        Time between frames in s.
    acceleration : float
        Standard deviation of the acceleration in px/s²: how hard the target may steer.
    noise : float
        Standard deviation of a measured coordinate in px.

    Raises
    ------
    ValueError
        If a position is not two finite numbers, or an interval or standard deviation is not
        positive.

    Examples
    --------
    >>> kalman = KalmanFilter((0.0, 0.0), interval=0.1, acceleration=1.0, noise=0.01)
    >>> for k in range(1, 4):
    ...     predicted = kalman.predict()
    ...     kalman.update((2.0 * k, -1.0 * k))
    >>> kalman.velocity.round(1)
    array([ 20., -10.])
    """

    def __init__(
        self, position: ArrayLike, *, interval: float, acceleration: float, noise: float
    ) -> None:
        dt = float(positive("interval", interval))
        self._position = as_array("position", position, shape=(2,)).copy()
        self._velocity = np.zeros(2)
        self._noise = float(positive("noise", noise)) ** 2
        self._step = np.array([[1.0, dt], [0.0, 1.0]])
        drive = np.array([dt**2 / 2, dt])
        self._drive = float(positive("acceleration", acceleration)) ** 2 * np.outer(drive, drive)
        self._covariance = np.diag([self._noise, _UNKNOWN_VELOCITY**2])

    @property
    def position(self) -> Array:
        """Estimated position, (x, y) in px."""
        return self._position.copy()

    @property
    def velocity(self) -> Array:
        """Estimated velocity, (vx, vy) in px/s."""
        return self._velocity.copy()

    @property
    def covariance(self) -> Array:
        """Covariance of (position, velocity) of either axis, px² and px²/s²."""
        return self._covariance.copy()

    def predict(self) -> Array:
        """Move the state to the next frame and return the position expected there, in px."""
        self._position += self._step[0, 1] * self._velocity
        self._covariance = self._step @ self._covariance @ self._step.T + self._drive
        return self.position

    def update(self, position: ArrayLike) -> None:
        """Correct the state with a measured position, (x, y) in px."""
        innovation = as_array("position", position, shape=(2,)) - self._position
        gain = self._covariance[:, 0] / (self._covariance[0, 0] + self._noise)
        self._position += gain[0] * innovation
        self._velocity += gain[1] * innovation
        self._covariance = self._covariance - np.outer(gain, self._covariance[0])
