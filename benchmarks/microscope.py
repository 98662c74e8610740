"""The loop over a microscope without hardware: what it reaches, and how it ends when things fail.

Run with ``python -m benchmarks microscope``; it takes some two minutes of one core. Without
``pymmcore-plus`` only the simulation is measured.
"""

from __future__ import annotations

import importlib.util

import numpy as np
import pandas as pd

from benchmarks.report import Limits, Tables
from compendium.experiments.microscope import reach, reach_on
from tests.servoing.faults import FAULTS, engine_scope, run_with

#: The loop was developed on seeds 0 to 9, and the tests have 100 to 107.
SEEDS = range(200, 240)
NOTE = f"""\
Each row has {len(SEEDS)} runs. A rendered gripper of 50 px is under a camera that is rotated at
random and mirrored or not, with 0.08 to 0.6 px/µm and a noise of two grey levels. The target is up
to 50 px away in x and in y, and the tolerance is 0.05 px. The errors are those of the true
feature. For the demo camera, the true feature is the position of its stage at 1 µm/px. Each fault
occurs at a different time.
"""


def main() -> tuple[Tables, Limits]:
    engine = importlib.util.find_spec("pymmcore_plus") is not None
    runs = {"simulated workstation": [reach(seed) for seed in SEEDS]}
    failed = {"simulated workstation": [run_with(*fault) for fault in FAULTS]}
    if engine:
        runs["the same behind UniMMCore"] = [reach_on(engine_scope(seed), seed) for seed in SEEDS]
        runs["demo camera's beads"] = [reach(None) for _ in range(5)]
        failed["the same behind UniMMCore"] = [run_with(*fault, engine=True) for fault in FAULTS]
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
    ended = pd.DataFrame(
        {
            "microscope": name,
            "faults": len(rows),
            "stage stopped and still": sum(row.still and row.stops > 0 for row in rows),
            "reason in the log": sum(bool(row.run.reason) for row in rows),
            "reached all the same": sum(bool(row.run.reached.all()) for row in rows),
            "farthest, of the travel": round(max(row.excursion for row in rows), 2),
        }
        for name, rows in failed.items()
    )
    everything = [row for rows in failed.values() for row in rows]
    bad = sum(
        not (r.still and r.stops and (r.run.reason or r.run.reached.all())) for r in everything
    )
    farthest = ended["farthest, of the travel"].max()
    return {"Targets": reached, "Faults": ended}, [
        ("worst error (px)", reached["worst error (px)"].max(), "≤", 0.12),
        ("mean error (px)", reached["mean error (px)"].max(), "≤", 0.05),
        ("faults after which no reason was reported or the stage moved", bad, "≤", 0),
        ("largest distance from the start, share of the travel", farthest, "≤", 1),
    ]
