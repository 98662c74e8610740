"""One disturbance at a time on the identified workstation of §5.4, beside the printed spreads."""

from __future__ import annotations

import numpy as np
import pandas as pd

from compendium import thesis
from compendium.experiments.section_5_4 import PATH_RESULTS, PATHS, Workstation, printed_path
from compendium.experiments.servo_loop import COLUMNS, PATH_READINGS, simulated

#: What is tried, in the loop's units: as many lost frames as a tracker survives, a stage that
#: shakes on all paths, and paths begun away from their start.
TRIED: dict[str, dict[str, float]] = {
    "as identified": {},
    "15 % of frames dropped": {"dropped": 0.15},
    "15 % of frames logged twice": {"lost": 0.15},
    "stage noise of 0.9 µm": {"stage noise": 0.9},
    "begun 15 µm off": {"start": 15.0},
}
_RUNS = 40


def path_numbers(
    station: Workstation, zoom: str, name: str, disturbance: dict[str, float], seed: int
) -> tuple[float, float]:
    """Return accuracy and precision along a path, µm, the medians of forty runs.

    Parameters
    ----------
    station : Workstation
        As identified; its calibration is taken as exact.
    zoom, name : str
        The experiment.
    disturbance : dict of str to float
        Values of `servo_loop.COLUMNS` that differ.
    seed : int
        Of the draws.

    Returns
    -------
    tuple of float
        By the reading of the chapter: the distance to the next reference.
    """
    given = {
        "pixel": thesis.effective_pixel(zoom),
        "saturation": station.saturation[zoom],
        "latency": station.assumed.latency,
        "noise x": station.shake(zoom),
        "noise y": station.shake(zoom),
        "scale": 1.0,
        "speed": station.path_speed[name],
        "size": station.assumed.size,
        "height": station.assumed.height,
    } | disturbance
    settings = np.array([[given.get(column, 0.0) for column in COLUMNS]])
    found = simulated(name, settings, _RUNS, np.random.default_rng(seed))
    reading = PATH_READINGS.index(("next reference", "of the distance"))
    accuracy, precision = np.median(found[0, :, reading], axis=0)
    return float(accuracy), float(precision)


def table(station: Workstation) -> pd.DataFrame:
    """Return accuracy and precision of every path, µm: printed, and with each of `TRIED`."""
    rows = []
    for zoom in thesis.ZOOMS:
        for name in PATHS:
            printed = [printed_path(zoom, name, what) for what in PATH_RESULTS]
            each = {"printed": printed} | {
                label: path_numbers(station, zoom, name, disturbance, station.seed)
                for label, disturbance in TRIED.items()
            }
            texts = {label: f"{mean:.2f} ± {spread:.2f}" for label, (mean, spread) in each.items()}
            rows.append({"path": f"{name} at {zoom}", **texts})
    return pd.DataFrame(rows)
