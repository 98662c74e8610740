"""Figures of merit of a servoing experiment, and the paths it follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, as_array, between, positive, same_length

__all__ = [
    "PathMetrics",
    "StepMetrics",
    "circle_path",
    "path_metrics",
    "sinusoid_path",
    "square_path",
    "step_metrics",
]


@dataclass(frozen=True)
class StepMetrics:
    """How a step was answered; NaN throughout, except the overshoot, if it never settled.

    Attributes
    ----------
    settling_time : float
        From the step until the error stays within the band, s.
    overshoot : float
        Largest passage beyond the target along the step, as a share of the step.
    accuracy : float
        Error at the settling time, in the unit of the positions.
    precision : float
        Standard deviation of the error from the settling time on, likewise.
    """

    settling_time: float
    overshoot: float
    accuracy: float
    precision: float


@dataclass(frozen=True)
class PathMetrics:
    """How a path was followed, in the unit of the positions.

    Attributes
    ----------
    accuracy : float
        Mean of the distance to the reference.
    precision : float
        Its standard deviation.
    largest : float
        Its maximum.
    """

    accuracy: float
    precision: float
    largest: float


def step_metrics(
    time: ArrayLike, position: ArrayLike, target: ArrayLike, *, band: float = 0.05
) -> StepMetrics:
    """Measure the answer to a step from the first position to `target`.

    Parameters
    ----------
    time : array_like, shape (K,)
        Increasing, s.
    position : array_like, shape (K, D)
        Any unit of length.
    target : array_like, shape (D,)
        Same unit.
    band : float, optional
        Settled means within this share of the step's length.

    Returns
    -------
    StepMetrics
        Settling time, overshoot, accuracy and precision.

    Raises
    ------
    ValueError
        If shapes do not fit, the time does not increase, the step has no length, or the band is not
        in (0, 1).

    Examples
    --------
    >>> time = np.arange(6) / 10
    >>> step_metrics(time, [[0], [60], [104], [98], [98], [98]], [100]).settling_time
    0.2
    """
    t = as_array("time", time, shape=(None,))
    x = as_array("position", position, shape=(None, None))
    same_length(("time", "position"), t, x)
    if (np.diff(t) <= 0).any():
        raise ValueError("time must increase")
    goal = as_array("target", target, shape=(x.shape[1],))
    share = float(between("band", band, 0.0, 1.0))
    step = goal - x[0]
    length = float(np.linalg.norm(step))
    if length == 0:
        raise ValueError("target must differ from the first position")
    error = np.linalg.norm(x - goal, axis=1)
    overshoot = max(0.0, float(((x - goal) @ step).max()) / length**2)
    outside = np.flatnonzero(error > share * length)
    settled = int(outside[-1]) + 1
    if settled == len(t):
        return StepMetrics(np.nan, overshoot, np.nan, np.nan)
    rest = error[settled:]
    return StepMetrics(float(t[settled] - t[0]), overshoot, float(rest[0]), float(rest.std()))


def path_metrics(position: ArrayLike, reference: ArrayLike) -> PathMetrics:
    """Measure the distances between positions and the references of the same samples.

    Parameters
    ----------
    position, reference : array_like, shape (K, D)
        In one unit of length.

    Returns
    -------
    PathMetrics
        Mean, standard deviation and maximum of the distances.

    Raises
    ------
    ValueError
        If the shapes differ or a value is not finite.

    Examples
    --------
    >>> path_metrics([[0, 0], [3, 4]], [[0, 0], [0, 0]])
    PathMetrics(accuracy=2.5, precision=2.5, largest=5.0)
    """
    wanted = as_array("reference", reference, shape=(None, None))
    x = as_array("position", position, shape=wanted.shape)
    error = np.linalg.norm(x - wanted, axis=1)
    return PathMetrics(float(error.mean()), float(error.std()), float(error.max()))


def circle_path(radius: float, speed: float, interval: float) -> Array:
    """Return one turn around a circle that starts at the origin.

    Parameters
    ----------
    radius : float
        Of the circle.
    speed : float
        Along it, in the radius' unit per second.
    interval : float
        Between samples, s.

    Returns
    -------
    ndarray, shape (K, 2)
        Positions, counter-clockwise if y points up.

    Raises
    ------
    ValueError
        If a parameter is not positive, or one sample would cover the whole path.

    Examples
    --------
    >>> path = circle_path(50.0, 100.0, 0.01)
    >>> bool(np.allclose(np.hypot(path[:, 0] + 50, path[:, 1]), 50))
    True
    """
    arc = _samples(2 * np.pi * float(positive("radius", radius)), speed, interval)
    return radius * np.column_stack([np.cos(arc / radius) - 1.0, np.sin(arc / radius)])


def square_path(side: float, speed: float, interval: float) -> Array:
    """Return one turn around a square that starts at the origin.

    Parameters
    ----------
    side : float
        Of the square.
    speed, interval : float
        As in `circle_path`.

    Returns
    -------
    ndarray, shape (K, 2)
        Positions, first along x.

    Raises
    ------
    ValueError
        As `circle_path`.

    Examples
    --------
    >>> square_path(1.0, 1.0, 0.5)[:4]
    array([[0. , 0. ],
           [0.5, 0. ],
           [1. , 0. ],
           [1. , 0.5]])
    """
    side = float(positive("side", side))
    arc = _samples(4 * side, speed, interval)
    corners = side * np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]])
    stops = side * np.arange(5)
    return np.column_stack([np.interp(arc, stops, corners[:, axis]) for axis in (0, 1)])


def sinusoid_path(
    length: float, amplitude: float, speed: float, interval: float, *, periods: float = 2.0
) -> Array:
    """Return a sinusoid along x that starts at the origin.

    Parameters
    ----------
    length, amplitude : float
        Extent along x, and height of the crests.
    speed : float
        Of x, per second; the speed along the curve is largest where it crosses the axis.
    interval : float
        Between samples, s.
    periods : float, optional
        Within the length.

    Returns
    -------
    ndarray, shape (K, 2)
        Positions.

    Raises
    ------
    ValueError
        As `circle_path`.

    Examples
    --------
    >>> sinusoid_path(4.0, 2.0, 1.0, 1.0, periods=1.0).round(9) + 0.0
    array([[ 0.,  0.],
           [ 1.,  2.],
           [ 2.,  0.],
           [ 3., -2.]])
    """
    length, height = float(positive("length", length)), float(positive("amplitude", amplitude))
    x = _samples(length, speed, interval)
    return np.column_stack(
        [x, height * np.sin(2 * np.pi * positive("periods", periods) / length * x)]
    )


def _samples(total: float, speed: float, interval: float) -> Array:
    step = float(positive("speed", speed)) * float(positive("interval", interval))
    if step > total:
        raise ValueError(
            f"speed must leave more than one sample on a length of {total:g}, got {step:g}"
        )
    return np.arange(0.0, total, step)
