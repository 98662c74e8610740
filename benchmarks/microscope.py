"""The loop over a microscope without hardware: how near it comes to its targets.

Run with ``python -m benchmarks microscope``; it takes some ten seconds of one core. Without
``pymmcore-plus`` only the simulation is measured.
"""

from __future__ import annotations

import importlib.util

import numpy as np
import pandas as pd

from benchmarks.report import Limits, Tables
from compendium.experiments.microscope import reach

#: The loop was developed on seeds 0 to 9, and the tests have 100 to 107.
SEEDS = range(200, 240)
NOTE = f"""\
Each row has {len(SEEDS)} runs. A rendered gripper of 50 px is under a camera that is rotated at
random and mirrored or not, with 0.08 to 0.6 px/µm and a noise of two grey levels. The target is up
to 50 px away in x and in y, and the tolerance is 0.05 px. The errors are those of the true
feature. For the demo camera, the true feature is the position of its stage at 1 µm/px.
"""


def main() -> tuple[Tables, Limits]:
    runs = {"simulated workstation": [reach(seed) for seed in SEEDS]}
    if importlib.util.find_spec("pymmcore_plus") is not None:
        runs["demo camera's beads"] = [reach(None) for _ in range(5)]
    reached = pd.DataFrame(
        {
            "microscope": name,
            "reached": f"{sum(run['reached'] for run in rows)} of {len(rows)}",
            "mean error (px)": round(float(np.mean([run["error"] for run in rows])), 4),
            "worst error (px)": round(max(run["error"] for run in rows), 4),
            "moves to the target, most": max(run["steps"] for run in rows),
        }
        for name, rows in runs.items()
    )
    return {"Targets": reached}, [
        ("worst error (px)", reached["worst error (px)"].max(), "≤", 0.12),
        ("mean error (px)", reached["mean error (px)"].max(), "≤", 0.05),
    ]
