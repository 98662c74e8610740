"""Figures of merit of a servoing experiment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import FlatResult, as_array, as_scalar, check_same_length


@dataclass(frozen=True)
class StepMetrics(FlatResult):
    """Settling time, accuracy, precision and overshoot of a step; NaN if the step never settled.

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
class PathMetrics(FlatResult):
    """Errors along a path, in the unit of the positions.

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
    """Measure the response to a step from the first position to `target`.

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
        With ``settling_time`` (s), ``overshoot`` (share of the step), and ``accuracy`` and
        ``precision`` (the error at settling and its standard deviation from then on, in the unit of
        the positions). An answer that never settles has an overshoot, and NaN for the others.

    Raises
    ------
    ValueError
        If shapes do not fit, the time does not increase, the step has no length, or the band is not
        in (0, 1).

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.servoing import step_metrics
    >>> time = np.arange(6) / 10
    >>> step_metrics(time, [[0], [60], [104], [98], [98], [98]], [100]).settling_time
    0.2
    """
    t = as_array("time", time, shape=(None,))
    x = as_array("position", position, shape=(None, None))
    check_same_length(("time", "position"), t, x)
    if (np.diff(t) <= 0).any():
        raise ValueError("time must increase")
    goal = as_array("target", target, shape=(x.shape[1],))
    share = as_scalar("band", band, above=0, below=1)
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
    after = error[settled:]
    return StepMetrics(float(t[settled] - t[0]), overshoot, float(after[0]), float(after.std()))


def path_metrics(position: ArrayLike, reference: ArrayLike) -> PathMetrics:
    """Measure the distances between positions and the references of the same samples.

    Parameters
    ----------
    position, reference : array_like, shape (K, D)
        In one unit of length.

    Returns
    -------
    PathMetrics
        With ``accuracy``, ``precision`` and ``largest``: mean, standard deviation and maximum of
        the distances.

    Raises
    ------
    ValueError
        If the shapes differ or a value is not finite.

    Examples
    --------
    >>> from microlib.servoing import path_metrics
    >>> path_metrics([[0, 0], [3, 4]], [[0, 0], [0, 0]])
    PathMetrics(accuracy=2.5, precision=2.5, largest=5.0)
    """
    references = as_array("reference", reference, shape=(None, None))
    x = as_array("position", position, shape=references.shape)
    error = np.linalg.norm(x - references, axis=1)
    return PathMetrics(float(error.mean()), float(error.std()), float(error.max()))
