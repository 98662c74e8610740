"""Which disturbance of the loop of §5.4 would explain the spreads of Table 5.4?

Each is added to the workstation of section 5.4, one at a time, and fitted to the twelve printed
numbers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from compendium import thesis
from compendium.experiments.section_5_4 import (
    PATH_RESULTS,
    PATHS,
    Workstation,
    nominal_jacobian,
    printed_path,
    thesis_controller,
)
from microlib.servoing import simulate

#: Shares of the frames in which something rare happens.
_RATES = (0.02, 0.05, 0.1, 0.2)
_SHARES = [(rate, 0.0) for rate in (0.05, 0.1, 0.15, 0.2, 0.3)]
#: What is tried: what the two numbers of a disturbance mean, and their values.
DISTURBANCES: dict[str, tuple[str, list[tuple[float, float]]]] = {
    "none": ("", [(0.0, 0.0)]),
    "frames dropped": ("{0:.0%} of the frames", _SHARES),
    "frames logged twice": ("{0:.0%} of the frames", _SHARES),
    "stage noise": ("{1:.1f} µm", [(1.0, size) for size in (0.2, 0.4, 0.6, 0.9, 1.3, 2.0)]),
    "bursts of image noise": (
        "{0:.0%} of the frames, {1:.1f} px",
        [(rate, size) for rate in _RATES for size in (0.5, 1.0, 2.0, 4.0, 8.0)],
    ),
    "jumps of the stage": (
        "{0:.0%} of the frames, {1:.0f} µm",
        [(rate, size) for rate in _RATES for size in (1.0, 2.0, 4.0, 7.0, 12.0)],
    ),
    "begun beside the start": ("{1:.0f} µm", [(1.0, size) for size in (4, 7, 10, 14, 20, 28, 40)]),
}
#: Jitters (px) and speeds along a path, both over those of the workstation, and runs of each, that
#: are tried with each disturbance.
_JITTERS, _SPEEDS, _RUNS = (0.3, 0.6, 0.8, 1.0, 1.3, 1.8), (0.75, 0.82, 0.9, 1.0), 10


def disturbed(
    station: Workstation, zoom: str, path: NDArray, label: str, values: NDArray, jitter: NDArray
) -> NDArray[np.float64]:
    """Run a path under a disturbance, each time with another strength.

    Parameters
    ----------
    station : Workstation
        The apparatus; its calibration is taken as exact.
    zoom : str
        ``1X`` or ``4X``.
    path : ndarray, shape (K, 2)
        References, px.
    label : str
        One of `DISTURBANCES`.
    values : ndarray, shape (N, 2)
        Rate and size of the disturbance.
    jitter : ndarray, shape (N,)
        Of the image, px.

    Returns
    -------
    ndarray, shape (N, 2)
        Mean and standard deviation of |f(k) − f*(k+1)| of each run, µm.
    """
    rng = np.random.default_rng(station.seed)
    shape = (len(values), len(path), 2)
    shake = jitter[:, None, None] * rng.standard_normal(shape)
    event = rng.random(shape[:2]) < values[:, :1]
    extra = values[:, 1, None, None] * rng.standard_normal(shape) * event[:, :, None]
    pixel, jacobian = thesis.effective_pixel(zoom), nominal_jacobian(zoom)
    start, lost = path[0], np.zeros(shape[:2], bool)
    if label == "bursts of image noise":
        shake = shake + extra
    elif label == "stage noise":
        shake = shake + extra / pixel
    elif label == "jumps of the stage":
        shake = shake + extra.cumsum(axis=1) @ jacobian.T
    elif label == "begun beside the start":
        start = path[0] + extra[:, 0] / pixel
    elif label.startswith("frames"):
        event[:, 0] = False  # the first frame is seen
        lost = event
    measured = measure(station, zoom, path, shake, start, lost)
    distance = pixel * np.linalg.norm(measured[:, :-1] - path[1:], axis=2)
    if label == "frames dropped":  # they are missing from the log
        distance[event[:, :-1]] = np.nan
    return np.column_stack([np.nanmean(distance, axis=1), np.nanstd(distance, axis=1)])


def measure(
    station: Workstation, zoom: str, path: NDArray, shake: NDArray, start: NDArray, lost: NDArray
) -> NDArray:
    """Return the measured features of N runs with given errors of each measurement, px.

    In a lost frame the stage keeps its speed, and the measurement before it is repeated.

    Parameters
    ----------
    station : Workstation
        The apparatus; its calibration is taken as exact.
    zoom : str
        ``1X`` or ``4X``.
    path : ndarray, shape (K, 2)
        References, px.
    shake : ndarray, shape (N, K, 2)
        Errors of the measurements, px.
    start : ndarray, shape (2,) or (N, 2)
        First feature, px.
    lost : ndarray of bool, shape (N, K)
        Frames without a measurement.
    """
    control = thesis_controller(zoom)
    errors = iter(np.where(lost[..., None], np.nan, shake).swapaxes(0, 1))
    speed = np.zeros((len(shake), 2))

    def keep_speed(k: int, measured: NDArray, reference: NDArray) -> NDArray:
        speed[:] = np.where(np.isnan(measured), speed, control(k, measured, reference))
        return speed

    still = replace(station, jitter=0.0)
    run = simulate(
        keep_speed,
        path,
        jacobian=np.broadcast_to(nominal_jacobian(zoom), (len(shake), 2, 2)),
        rng=0,
        start=start,
        observer=lambda feature: feature + next(errors),
        **still.apparatus(zoom),
    )
    measured = run.measured
    for k in range(1, len(path)):
        measured[:, k] = np.where(lost[:, k, None], measured[:, k - 1], measured[:, k])
    return measured


def fit(station: Workstation, label: str) -> tuple[str, float, pd.DataFrame]:
    """Fit a disturbance to Table 5.4 by least squares of the logarithms.

    Parameters
    ----------
    station : Workstation
        As `section_5_4.identify` finds it.
    label : str
        One of `DISTURBANCES`.

    Returns
    -------
    strength : str
        The fitted disturbance in words.
    deviation : float
        Root mean square of the twelve logarithms of fitted over printed numbers.
    numbers : pandas.DataFrame
        The twelve numbers: in words, printed and fitted, µm.
    """
    text, values = DISTURBANCES[label]
    tried = np.array([(*value, j) for value in values for j in _JITTERS])
    rows = np.repeat(tried, _RUNS, axis=0)
    found, squared_sums = {}, np.zeros(len(tried))
    for name in PATHS:
        each = []
        printed = np.array([[printed_path(z, name, w) for w in PATH_RESULTS] for z in thesis.ZOOMS])
        for factor in _SPEEDS:
            path = replace(station, path_speed={name: factor * station.path_speed[name]}).path(name)
            both = [
                disturbed(station, zoom, path, label, rows[:, :2], rows[:, 2] * station.jitter)
                for zoom in thesis.ZOOMS
            ]
            runs = np.reshape(both, (len(thesis.ZOOMS), len(tried), _RUNS, 2))
            each.append(np.median(runs, axis=2).transpose(1, 0, 2))  # tried, zoom, number
        squares = np.sum(np.log(np.array(each) / printed) ** 2, axis=(2, 3))
        best = squares.argmin(axis=0)  # a speed for each strength
        squared_sums += squares.min(axis=0)
        found[name] = (printed, np.array(each)[best, np.arange(len(tried))])
    at = int(squared_sums.argmin())
    table = [
        (f"{what} on the {name} at {zoom} (µm)", printed[i, j], numbers[at, i, j])
        for name, (printed, numbers) in found.items()
        for i, zoom in enumerate(thesis.ZOOMS)
        for j, what in enumerate(PATH_RESULTS)
    ]
    rate, size, jitter = tried[at]
    strength = f"{text.format(rate, size)}, {jitter * station.jitter:.2f} px of jitter".lstrip(", ")
    numbers = pd.DataFrame(table, columns=["number", "printed", "fitted"])
    return strength, float(np.sqrt(squared_sums[at] / len(table))), numbers
