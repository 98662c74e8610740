"""Section 5.4: find the lost workstation from a few printed numbers, and predict the others.

Lengths are in px of the image or µm on the sample, as said; an interval of seeds is the median with
the ends that hold 95 % of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.stats import f as scipy_f
from scipy.stats import rice as scipy_rice

from compendium import thesis
from compendium.experiments import paths
from compendium.experiments.microscope import turned
from compendium.experiments.section_5_3 import gripper
from compendium.ledger import claim
from microlib import servoing

#: Standard deviations of the calibration's angle (rad) and scale: assumed. The circles and squares
#: of Table 5.1 differ by 2.2 % in magnification at 1X and by 0.9 % at 4X.
CALIBRATION_ANGLE, CALIBRATION_SCALE = np.pi / 180, 0.01
#: The step of 50 px in both axes, over two seconds.
STEP_PATH = np.full((66, 2), claim("table-5.3/1X/step").value)
#: Paths of §5.4, px, by their speed (px/s), their size over the one here, and the sinusoid's height
#: over the one here: neither is printed.
PATHS: dict[str, Callable[[float, float, float], NDArray]] = {
    "circle": lambda speed, size, _: paths.circle_path(40.0 * size, speed, thesis.FRAME_INTERVAL),
    "square": lambda speed, size, _: paths.square_path(60.0 * size, speed, thesis.FRAME_INTERVAL),
    "sinusoid": lambda speed, size, height: paths.sinusoid_path(
        100.0 * size, 20.0 * size * height, 0.5 * speed, thesis.FRAME_INTERVAL
    ),
}
STEP_RESULTS = ("settling-time", "accuracy", "precision")
PATH_RESULTS = ("accuracy", "precision")
#: The seven printed numbers that were used to find the workstation; the other eleven are predicted.
#: The last one chose between two explanations of the settling times.
USED = (
    "table-5.3/1X/settling-time",
    "table-5.3/4X/settling-time",
    "table-5.4/1X/circle/accuracy",
    "table-5.4/1X/square/accuracy",
    "table-5.4/1X/sinusoid/accuracy",
    "table-5.4/1X/circle/precision",
    "table-5.3/4X/precision",
)
#: What a controller needs to know, with J in px/µm.
LAW: dict[str, Any] = {
    "interval": thesis.FRAME_INTERVAL,
    "feature_weight": thesis.FEATURE_WEIGHT,
    "control_weight": thesis.CONTROL_WEIGHT_MICROMETER,
}


@dataclass(frozen=True)
class Assumed:
    """What the thesis does not print and the simulation needs.

    Attributes
    ----------
    band : float
        Settled means within this share of the step. The thesis gives no band; it says that the
        error at the settling time is less than 3 %.
    latency : float
        From an exposure until its command takes effect, s, less than a frame; it stands for
        exposure, transfer and tracking.
    one_speed : bool
        Whether both zooms share one largest speed. The latency is then what gives the settling time
        at 4X, instead of a lower speed.
    calibration : float
        Errors of the calibration over `CALIBRATION_ANGLE` and `CALIBRATION_SCALE`.
    size, height : float
        Of `PATHS`, and of the sinusoid alone, over those written there.
    faster, shakier : float
        Speed along the paths and jitter at 4X over those at 1X, both in px.
    """

    band: float = 0.05
    latency: float = 0.01
    one_speed: bool = False
    calibration: float = 1.0
    size: float = 1.0
    height: float = 1.0
    faster: float = 1.0
    shakier: float = 1.0


#: What is assumed throughout, and the other assumptions by which the verdicts are tried. Those at
#: 4X were sought so that a verdict changes: they show that it can, not how likely that is.
ASSUMED = Assumed()
OTHER_READINGS = {
    "one speed": Assumed(one_speed=True),
    "band 3 %": Assumed(band=0.03),
    "band 3 %, one speed": Assumed(band=0.03, one_speed=True),
    "band 10 %": Assumed(band=0.1),
    "no latency": Assumed(latency=0.0),
    "latency 25 ms": Assumed(latency=0.025),
    "exact calibration": Assumed(calibration=0.0),
    "paths half as large": Assumed(size=0.5),
    "sinusoid twice as high": Assumed(height=2.0),
    "7 % slower at 4X": Assumed(faster=0.93),
    "19 % slower at 4X": Assumed(faster=0.81),
    "3 times the jitter at 4X": Assumed(shakier=3.0),
    "4.5 times the jitter at 4X": Assumed(shakier=4.5),
    "5 times the jitter at 4X": Assumed(shakier=5.0),
}


def nominal_jacobian(zoom: str) -> NDArray:
    """Return px/µm as the controller knows them."""
    return np.eye(2) / thesis.effective_pixel(zoom)


def thesis_controller(zoom: str) -> servoing.OptimalController:
    """Return the controller (2.28) with the weights of §5.4."""
    return servoing.OptimalController(nominal_jacobian(zoom), **LAW)


def drawn_jacobian(zoom: str, rng: np.random.Generator, assumed: Assumed) -> NDArray:
    """Draw the true px/µm, which the calibration knows with an error."""
    angle = rng.normal(0, assumed.calibration * CALIBRATION_ANGLE)
    size = rng.normal(1, assumed.calibration * CALIBRATION_SCALE)
    return turned(angle, size / thesis.effective_pixel(zoom), mirrored=False)


def path_errors(zoom: str, path: NDArray, measured: NDArray, ahead: int = 1) -> NDArray:
    """Return `PATH_RESULTS` of |f(k) − f*(k + ahead)|, a row each run, µm."""
    pixel, count = thesis.effective_pixel(zoom), len(path) - ahead
    each = (servoing.path_metrics(m[:count] * pixel, path[ahead:] * pixel) for m in measured)
    return np.array([(found.accuracy, found.precision) for found in each])


def step_errors(zoom: str, measured: NDArray, ahead: ArrayLike, band: float) -> NDArray[np.float64]:
    """Return `STEP_RESULTS`, a row each run, in s and µm.

    The step is commanded some time before the first exposure that the loop knows it at: `ahead` is
    that share of a frame.
    """
    time = thesis.FRAME_INTERVAL * np.arange(len(STEP_PATH))
    seen, goal = (thesis.effective_pixel(zoom) * px for px in (measured, STEP_PATH[0]))
    each = (servoing.step_metrics(time, run, goal, band=band) for run in seen)
    found = np.array([(m.settling_time, m.accuracy, m.precision) for m in each])
    found[:, 0] += np.asarray(ahead) * thesis.FRAME_INTERVAL
    return found


@dataclass(frozen=True)
class Workstation:
    """What stands for the workstation of 2008.

    Attributes
    ----------
    saturation : dict of str to float
        Largest speed of the stage at each zoom, µm/s.
    jitter : float
        Standard deviation of the image's shake, px.
    path_speed : dict of str to float
        Speed along each of `PATHS`, px/s.
    seed : int
        Of all that is drawn.
    assumed : Assumed
        Under which the other values were found.
    """

    saturation: dict[str, float]
    jitter: float
    path_speed: dict[str, float]
    seed: int
    assumed: Assumed = ASSUMED

    def path(self, name: str, zoom: str = "1X") -> NDArray:
        """Return one of `PATHS` at its speed, px."""
        faster = self.assumed.faster if zoom == "4X" else 1.0
        speed = faster * self.path_speed[name]
        return PATHS[name](speed, self.assumed.size, self.assumed.height)

    def apparatus(self, zoom: str, latency: float | None = None) -> dict[str, Any]:
        """Return the stage and the camera, with a latency (s) that may be another."""
        late = self.assumed.latency if latency is None else latency
        jitter = self.jitter * (self.assumed.shakier if zoom == "4X" else 1.0)
        return {
            "stage": servoing.StageModel(self.saturation[zoom], increment=thesis.STAGE_STEP),
            "camera": servoing.CameraTiming(thesis.FRAME_INTERVAL, late, jitter),
        }

    def runs(self, zoom: str, path: NDArray, draws: int, *, start: ArrayLike | None = None) -> Any:
        """Simulate `draws` runs at once, each with its own jitter and calibration."""
        generators = [np.random.default_rng([self.seed, draw]) for draw in range(draws)]
        return servoing.simulate(
            thesis_controller(zoom),
            path,
            jacobian=[drawn_jacobian(zoom, rng, self.assumed) for rng in generators],
            rng=generators,
            start=start,
            **self.apparatus(zoom),
        )

    def path_errors(self, zoom: str, name: str, draws: int) -> NDArray:
        """Return `PATH_RESULTS` along one of `PATHS`, a row each draw, µm."""
        path = self.path(name, zoom)
        return path_errors(zoom, path, self.runs(zoom, path, draws).measured)

    def steps(self, zoom: str, draws: int) -> NDArray:
        """Return `STEP_RESULTS` of steps of 50 px, a row each draw, s and µm."""
        measured = self.runs(zoom, STEP_PATH, draws, start=(0.0, 0.0)).measured
        ahead = [np.random.default_rng([self.seed, draw, 1]).random() for draw in range(draws)]
        return step_errors(zoom, measured, ahead, self.assumed.band)


@cache
def settling_time(zoom: str, saturation: float, latency: float, band: float) -> float:
    """Return the settling time of a step without jitter, s; NaN if it never settles."""
    station = Workstation({zoom: saturation}, 0.0, {}, 0)
    run = servoing.simulate(
        thesis_controller(zoom),
        STEP_PATH,
        jacobian=nominal_jacobian(zoom),
        rng=0,
        start=(0.0, 0.0),
        **station.apparatus(zoom, latency),
    )
    return float(step_errors(zoom, run.measured[None], 0.5, band)[0, 0])


def nearest(values: NDArray, times: ArrayLike, printed: float) -> float:
    """Return the middle of the values whose time is nearest to the printed one.

    Examples
    --------
    >>> import numpy as np
    >>> from compendium.experiments.section_5_4 import nearest
    >>> nearest(np.array([1.0, 2.0, 3.0, 4.0]), [np.nan, 0.8, 0.8, 0.6], 0.75)
    2.5
    """
    distance = np.abs(np.asarray(times, dtype=float) - printed)
    return float(np.mean(values[np.isclose(distance, np.nanmin(distance))]))


def within(inputs: NDArray, values: NDArray, id: str) -> float:
    """Return the input between those given at which increasing values reach the printed number.

    Raises
    ------
    ValueError
        If the values do not increase past the printed one.

    Examples
    --------
    >>> import numpy as np
    >>> from compendium.experiments.section_5_4 import within
    >>> found = within(np.array([1.0, 2.0]), np.array([4.0, 12.0]), "table-5.4/1X/circle/accuracy")
    >>> round(found, 3)
    1.465
    """
    printed = claim(id).value
    if not values[0] <= printed <= values[-1]:
        raise ValueError(
            f"values tried must give {id}, printed {printed:g}, got {values[0]:.3g} to "
            f"{values[-1]:.3g}"
        )
    return float(np.interp(printed, values, inputs))


def common_speed() -> tuple[float, float]:
    """Return one largest speed (µm/s) and one rest of the time (s) for both settling times.

    The stage covers the step of 50 px along one axis at the speed, and the rest is the same at both
    zooms. Two printed times determine the two numbers.
    """
    pixels = [thesis.effective_pixel(zoom) for zoom in thesis.ZOOMS]
    distance = claim("table-5.3/1X/step").value * np.array(pixels)
    time = np.array([claim(f"table-5.3/{zoom}/settling-time").value for zoom in thesis.ZOOMS])
    slope, rest = np.polyfit(distance, time, 1)
    return float(1 / slope), float(rest)


def frames_to_distinguish(ratio: float) -> int:
    """Return how many independent frames each of two standard deviations must come from, so that
    an F test at 5 % tells that they are not of one noise.

    Examples
    --------
    >>> from compendium.experiments.section_5_4 import frames_to_distinguish
    >>> frames_to_distinguish(2.0)
    11
    """
    counts = np.arange(2, 10_000)
    p = 2 * scipy_f.sf(ratio**2, counts - 1, counts - 1)
    return int(counts[p < 0.05][0])


#: Largest speeds (µm/s) and latencies (s) that are tried.
SPEEDS = np.arange(120.0, 480.0, 4.0)
LATENCIES = np.arange(0.0, 0.96, 0.02) * thesis.FRAME_INTERVAL


def identify(seed: int, assumed: Assumed = ASSUMED) -> Workstation:
    """Find the workstation that gives six printed numbers.

    The largest speeds follow from the settling times, the speed along each path from its accuracy
    at 1X, and the jitter from the precision on the circle at 1X.

    Parameters
    ----------
    seed : int
        Of the runs.
    assumed : Assumed
        What is not printed.

    Returns
    -------
    Workstation
        With these values.

    Raises
    ------
    ValueError
        If no speed or jitter gives a printed number.
    """
    printed = {zoom: claim(f"table-5.3/{zoom}/settling-time").value for zoom in thesis.ZOOMS}
    saturation = {}
    for zoom in thesis.ZOOMS:
        times = [settling_time(zoom, v, assumed.latency, assumed.band) for v in SPEEDS]
        saturation[zoom] = nearest(SPEEDS, times, printed[zoom])
    if assumed.one_speed:
        saturation["4X"] = saturation["1X"]
        times = [settling_time("4X", saturation["4X"], v, assumed.band) for v in LATENCIES]
        assumed = replace(assumed, latency=nearest(LATENCIES, times, printed["4X"]))
    jitters, speeds = np.arange(0.0, 0.26, 0.05), np.arange(10.0, 51.0, 5.0)  # px, px/s
    found = Workstation(saturation, 0.1, {}, seed, assumed)

    def mean_error(station: Workstation, name: str) -> NDArray:
        return station.path_errors("1X", name, draws=8).mean(axis=0)

    for _ in range(2):  # jitter and speeds depend a little on each other
        path_speed = {}
        for name in PATHS:
            tried = [mean_error(replace(found, path_speed={name: v}), name)[0] for v in speeds]
            path_speed[name] = within(speeds, np.array(tried), f"table-5.4/1X/{name}/accuracy")
        found = replace(found, path_speed=path_speed)
        spreads = [mean_error(replace(found, jitter=j), "circle")[1] for j in jitters]
        jitter = within(jitters, np.array(spreads), "table-5.4/1X/circle/precision")
        found = replace(found, jitter=jitter)
    return found


def printed_path(zoom: str, name: str, what: str) -> float:
    """Return an entry of Table 5.4, µm."""
    return claim(f"table-5.4/{zoom}/{name}/{what}").value


def printed_table() -> pd.DataFrame:
    """Return Table 5.4 as printed, µm: a row each path, a column each result and zoom."""
    columns = [(what, zoom) for what in PATH_RESULTS for zoom in thesis.ZOOMS]
    return pd.DataFrame(
        {c: {name: printed_path(c[1], name, c[0]) for name in PATHS} for c in columns}
    )


def median_and_ends(values: ArrayLike) -> tuple[float, float, float]:
    """Return the median and the ends between which 95 % of the values lie.

    Examples
    --------
    >>> from compendium.experiments.section_5_4 import median_and_ends
    >>> median_and_ends(range(101))
    (50.0, 2.5, 97.5)
    """
    low, middle, high = np.percentile(np.asarray(values, dtype=float), [2.5, 50, 97.5])
    return float(middle), float(low), float(high)


def predicted_tables(station: Workstation, draws: int) -> pd.DataFrame:
    """Predict Tables 5.3 and 5.4.

    Parameters
    ----------
    station : Workstation
        The apparatus.
    draws : int
        Runs behind each number, which draw jitter and calibration.

    Returns
    -------
    pandas.DataFrame
        A row each entry: claim, value (the median), the ends low and high, in s or µm, and whether
        it is one of `USED`.
    """
    rows = []
    for zoom in thesis.ZOOMS:
        steps = station.steps(zoom, draws)
        for k, what in enumerate(STEP_RESULTS):
            rows.append((f"table-5.3/{zoom}/{what}", *median_and_ends(steps[:, k])))
        for name in PATHS:
            errors = station.path_errors(zoom, name, draws)
            for k, what in enumerate(PATH_RESULTS):
                rows.append((f"table-5.4/{zoom}/{name}/{what}", *median_and_ends(errors[:, k])))
    table = pd.DataFrame(rows, columns=["claim", "value", "low", "high"])
    return table.assign(used=table["claim"].isin(USED))


def by_reading(station: Workstation, draws: int) -> pd.DataFrame:
    """Predict the numbers anew under each of `OTHER_READINGS`.

    Parameters
    ----------
    station : Workstation
        As found under `ASSUMED`.
    draws : int
        Runs behind each interval.

    Returns
    -------
    pandas.DataFrame
        As `predicted_tables`, a row each reading and number, with the reading and whether the
        printed number lies inside the interval.
    """
    tables = []
    for name, reading in ({"as assumed": station.assumed} | OTHER_READINGS).items():
        # All is found at 1X.
        same = replace(reading, faster=1.0, shakier=1.0) == station.assumed
        at = replace(station, assumed=reading) if same else identify(station.seed, reading)
        table = predicted_tables(at, draws)
        printed = table["claim"].map(lambda id: claim(id).value)
        tables.append(
            table.assign(reading=name, inside=printed.between(table["low"], table["high"]))
        )
    return pd.concat(tables, ignore_index=True)


def decided(table: pd.DataFrame) -> pd.DataFrame:
    """Return a row each predicted number: whether the printed one lies inside the interval, and the
    readings that change this."""
    table = table[~table["used"]]
    assumed = table[table["reading"] == "as assumed"].set_index("claim")["inside"]
    changed = table[table["inside"] != table["claim"].map(assumed)]
    names = changed.groupby("claim")["reading"].agg("; ".join)
    return pd.DataFrame(
        {"inside": assumed, "changed by": names.reindex(assumed.index, fill_value="")}
    )


def over_images(
    station: Workstation, zoom: str, path: NDArray, start: ArrayLike | None = None
) -> Any:
    """Close the loop over rendered frames of the gripper, measured by the tracker of §5.3.

    Parameters
    ----------
    station : Workstation
        The apparatus.
    zoom : str
        ``1X`` or ``4X``.
    path : ndarray, shape (K, 2)
        References, px.
    start : array_like, shape (2,), optional
        First feature, px; the first reference by default.

    Returns
    -------
    Simulation
        As `microlib.servoing.simulate` returns it.
    """
    rng = np.random.default_rng(station.seed)
    begin = path[0] if start is None else np.asarray(start)
    span = np.vstack([path, begin])
    # The path lies in the middle of the frame.
    away = begin - np.rint((span.min(axis=0) + span.max(axis=0)) / 2)
    frame, tracker = gripper(zoom, away, rng)
    origin = tracker.track(frame(away, rng)).center - begin

    def observer(feature: NDArray) -> NDArray:
        track = tracker.track(frame(feature + away - begin, rng))
        return np.full(2, np.nan) if track.lost else track.center - origin

    drawn = np.random.default_rng([station.seed, 0])
    return servoing.simulate(
        thesis_controller(zoom),
        path,
        jacobian=drawn_jacobian(zoom, drawn, station.assumed),
        rng=drawn,
        start=begin,
        observer=observer,
        **station.apparatus(zoom),
    )


def error_left(zoom: str, unit: float) -> float:
    """Return the share of an error that one sample leaves, with J in px per `unit` µm.

    By (2.28) that is l / (T² j² q + l), which depends on the unit.
    """
    jacobian = unit * nominal_jacobian(zoom)
    weights = LAW | {"control_weight": thesis.CONTROL_WEIGHT}
    gain = servoing.OptimalController(jacobian, **weights).gain
    return float(1 - thesis.FRAME_INTERVAL * (jacobian @ gain)[0, 0])


def largest_error_in_frame(station: Workstation) -> float:
    """Return the largest mean of |f(k) − f*(k)| on the circle at 1X, µm.

    Of all latencies tried, and of speeds up to nine tenths of what the stage can follow.
    """
    most = 0.9 * station.saturation["1X"] / thesis.effective_pixel("1X")
    errors = []
    for speed in np.linspace(0.2, 1.0, 5) * most:
        path = PATHS["circle"](speed, 1.0, 1.0)
        for latency in {reading.latency for reading in OTHER_READINGS.values()}:
            at = replace(station, assumed=replace(ASSUMED, latency=latency))
            measured = at.runs("1X", path, 1).measured
            errors.append(path_errors("1X", path, measured, ahead=0)[0, 0])
    return float(max(errors))


def saturated_share(station: Workstation, draws: int) -> float:
    """Return the share of the settling time in which the velocity stays at its limit.

    From the first sample on, along both axes: the least of both zooms and of `draws` steps.
    """
    shares = []
    for zoom in thesis.ZOOMS:
        command = station.runs(zoom, STEP_PATH, draws, start=(0.0, 0.0)).command
        at_limit = (np.abs(command) >= station.saturation[zoom]).all(axis=2)
        held = at_limit.argmin(axis=1) * thesis.FRAME_INTERVAL
        shares.append(held / station.steps(zoom, draws)[:, 0])
    return float(np.min(shares))


def rare_errors(lag: float, error: float, rate: float) -> tuple[float, float]:
    """Return mean and standard deviation of the distance |lag + e|, all in the unit of the lag.

    e is zero but for a share `rate` of the frames, in which it is normal along both axes with the
    standard deviation `error`.

    Examples
    --------
    >>> rare_errors(1.0, 2.0, 0.0)
    (1.0, 0.0)
    """
    rice = scipy_rice(lag / error, scale=error)
    mean = (1 - rate) * lag + rate * rice.mean()
    square = (1 - rate) * lag**2 + rate * (lag**2 + 2 * error**2)
    return float(mean), float(np.sqrt(square - mean**2))
