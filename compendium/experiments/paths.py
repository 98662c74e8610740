"""The reference paths of the experiments in path following (§5.4, Table 5.4), from the origin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def circle_path(radius: float, speed: float, interval: float) -> NDArray[np.float64]:
    """Return one turn around a circle, (K, 2), counter-clockwise if y points up.

    Parameters
    ----------
    radius : float
        Of the circle.
    speed : float
        Along it, in the radius' unit per second.
    interval : float
        Between samples, s.

    Examples
    --------
    >>> import numpy as np
    >>> from compendium.experiments.paths import circle_path
    >>> path = circle_path(50.0, 100.0, 0.01)
    >>> bool(np.allclose(np.hypot(path[:, 0] + 50, path[:, 1]), 50))
    True
    """
    angle = np.arange(0.0, 2 * np.pi * radius, speed * interval) / radius
    return radius * np.column_stack([np.cos(angle) - 1.0, np.sin(angle)])


def square_path(side: float, speed: float, interval: float) -> NDArray[np.float64]:
    """Return one turn around a square, (K, 2), first along x; speed and interval as on a circle.

    Examples
    --------
    >>> from compendium.experiments.paths import square_path
    >>> square_path(1.0, 1.0, 0.5)[:4]
    array([[0. , 0. ],
           [0.5, 0. ],
           [1. , 0. ],
           [1. , 0.5]])
    """
    arc = np.arange(0.0, 4 * side, speed * interval)
    corners, stops = side * np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]), side * np.arange(5)
    return np.column_stack([np.interp(arc, stops, corners[:, axis]) for axis in (0, 1)])


def sinusoid_path(
    length: float, amplitude: float, speed: float, interval: float
) -> NDArray[np.float64]:
    """Return two periods of a sinusoid along x, (K, 2).

    Parameters
    ----------
    length, amplitude : float
        Extent along x, and height of the crests.
    speed : float
        Of x, per second; the speed along the curve is largest where it crosses the axis.
    interval : float
        Between samples, s.

    Examples
    --------
    >>> from compendium.experiments.paths import sinusoid_path
    >>> sinusoid_path(8.0, 2.0, 1.0, 1.0)[:4].round(9) + 0.0
    array([[ 0.,  0.],
           [ 1.,  2.],
           [ 2.,  0.],
           [ 3., -2.]])
    """
    x = np.arange(0.0, length, speed * interval)
    return np.column_stack([x, amplitude * np.sin(4 * np.pi / length * x)])
