"""The controller of the thesis beside one that knows the delay of its loop."""

from __future__ import annotations

import numpy as np
import pandas as pd

from compendium import thesis
from compendium.experiments.section_5_4 import LAW, PATHS, Workstation, nominal_jacobian
from microlib import servoing


def true_error(
    station: Workstation, zoom: str, name: str, latency: float, draw: int
) -> list[float]:
    """Return the mean distance to the reference of the same frame, µm.

    Of `OptimalController` (2.28) and of `PredictiveController`, with the same draws.
    """
    pixel, jacobian = thesis.effective_pixel(zoom), nominal_jacobian(zoom)
    known = LAW | {"delay": latency, "saturation": station.saturation[zoom]}
    errors = []
    for controller in (
        servoing.OptimalController(jacobian, **LAW),
        servoing.PredictiveController(jacobian, **known),
    ):
        run = station.simulate(controller, zoom, station.path(name), draw, latency=latency)
        errors.append(servoing.path_metrics(run.feature * pixel, run.reference * pixel).accuracy)
    return errors


def compare(station: Workstation, draws: int = 6) -> pd.DataFrame:
    """Compare both controllers on every path, at both zooms and two latencies.

    Returns
    -------
    pandas.DataFrame
        A row each task: zoom, path, latency (ms), and the mean error of each controller, µm.
    """
    rows = []
    for zoom in thesis.ZOOMS:
        for name in PATHS:
            for latency in (station.assumed.latency, 0.8 * thesis.FRAME_INTERVAL):
                errors = [true_error(station, zoom, name, latency, k) for k in range(draws)]
                rows.append((zoom, name, 1000 * latency, *np.mean(errors, axis=0)))
    columns = ["zoom", "path", "latency (ms)", "optimal (2.28), µm", "predictive, µm"]
    return pd.DataFrame(rows, columns=columns)
