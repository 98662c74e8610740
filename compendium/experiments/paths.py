"""The reference paths of the experiments in path following (§5.4, Table 5.4)."""

from __future__ import annotations

import numpy as np

from microlib._common import Array, positive

__all__ = ["circle_path", "sinusoid_path", "square_path"]


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
