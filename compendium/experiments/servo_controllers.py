"""The controller of the thesis beside one that knows the delay of its loop."""

from __future__ import annotations

import pandas as pd

from compendium import thesis
from compendium.experiments.section_5_4 import (
    LAW,
    PATHS,
    Workstation,
    nominal_jacobian,
    path_errors,
    thesis_controller,
)
from microlib.servoing import PredictiveController


def true_errors(
    station: Workstation, zoom: str, name: str, latency: float, draws: int
) -> list[float]:
    """Return the mean distance to the reference of the same frame, µm.

    Of `OptimalController` (2.28) and of `PredictiveController`, with the same draws.
    """
    path, jacobian = station.path(name), nominal_jacobian(zoom)
    known = LAW | {"delay": latency, "saturation": station.saturation[zoom]}
    errors = []
    for controller in (thesis_controller(zoom), PredictiveController(jacobian, **known)):
        run = station.runs(zoom, path, draws, controller=controller, latency=latency)
        errors.append(float(path_errors(zoom, path, run.feature, ahead=0)[:, 0].mean()))
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
                errors = true_errors(station, zoom, name, latency, draws)
                rows.append((zoom, name, 1000 * latency, *errors))
    columns = ["zoom", "path", "latency (ms)", "optimal (2.28), µm", "predictive, µm"]
    return pd.DataFrame(rows, columns=columns)
