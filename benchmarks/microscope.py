"""The loop over a microscope without hardware: what it reaches, and how it ends when things fail.

Run with ``python -m benchmarks.microscope``; it takes some two minutes of one core. Without
``pymmcore-plus`` (``pip install microlib[microscope]``) only the simulation is measured.
"""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.report import must_hold, publish
from compendium.experiments.microscope import FAULTS, inject, interrupt_after, reach
from microlib.servoing import Camera, PredictiveController, Stage, simulate

#: The loop was developed on seeds 0 to 9, and the tests have 100 to 107.
SEEDS = range(200, 240)
INTERRUPTS = 40
NAMES = {
    "simulated": "simulated workstation",
    "engine": "the same behind UniMMCore",
    "demo": "demo camera's beads",
}


def engine() -> str:
    """Return the version of Micro-Manager's engine, or nothing."""
    try:
        return version("pymmcore-plus")
    except PackageNotFoundError:
        return ""


def targets(kinds: list[tuple[str, str]]) -> tuple[pd.DataFrame, dict[tuple[str, str], Any]]:
    """Random turn, mirror, scale and target: errors of the true feature."""
    rows: list[dict[str, object]] = []
    worst: dict[tuple[str, str], Any] = {}
    for kind, drive in kinds:
        runs = [reach(kind, seed, drive=drive) for seed in SEEDS]
        errors = np.array([run["error"] for run in runs])
        worst[kind, drive] = (all(run["reached"] for run in runs), errors.max(), errors.mean())
        rows.append(
            {
                "microscope": NAMES[kind],
                "stage driven by": drive,
                "reached": f"{sum(run['reached'] for run in runs)} of {len(runs)}",
                "mean error (px)": round(errors.mean(), 3),
                "worst (px)": round(errors.max(), 3),
                "moves, median": float(np.median([run["steps"] for run in runs])),
                "moves, most": max(run["steps"] for run in runs),
                "χ²/dof of the calibration": round(np.median([run["misfit"] for run in runs]), 2),
            }
        )
    return pd.DataFrame(rows), worst


def faults(kinds: list[tuple[str, str]]) -> tuple[pd.DataFrame, float, float]:
    """Each fault at its moments; what ended badly, and the farthest that any run went."""
    rows, bad, farthest = [], 0.0, 0.0
    for kind, drive in kinds:
        results = [inject(kind, fault, drive=drive) for fault in FAULTS]
        named = [r["complete"] or r["reason"] != "done" for r in results]
        still = [r["still"] and r["stopped"] for r in results]
        bad += float(np.sum(~(np.array(named) & np.array(still))))
        farthest = max(farthest, *(r["excursion"] for r in results))
        rows.append(
            {
                "microscope": NAMES[kind],
                "stage driven by": drive,
                "faults": len(results),
                "stopped and still": sum(still),
                "reason in the log": sum(r["reason"] != "done" for r in results),
                "reached all the same": sum(r["complete"] for r in results),
                "farthest, of the travel": round(max(r["excursion"] for r in results), 2),
            }
        )
    return pd.DataFrame(rows), bad, farthest


def interrupts(kinds: list[str]) -> tuple[pd.DataFrame, float]:
    """Ctrl-C at random moments of runs that take 0.15 s and 0.7 s."""
    rows, moved = [], 0.0
    for kind in kinds:
        rng = np.random.default_rng(1)
        length = 0.2 if kind == "simulated" else 0.8
        results = [interrupt_after(kind, delay) for delay in rng.uniform(0, length, INTERRUPTS)]
        moved += sum(not r["still"] for r in results)
        rows.append(
            {
                "microscope": NAMES[kind],
                "sent": len(results),
                "during the run": sum(r["reason"] == "interrupted by the user" for r in results),
                "stage still": sum(r["still"] for r in results),
            }
        )
    return pd.DataFrame(rows), moved


def loop_gains() -> pd.DataFrame:
    """Frames until a step of 50 px is within 1 %, over the share of the error taken in a sample."""
    interval = 0.03
    turn = np.array([[np.cos(np.pi / 6), -0.5], [0.5, np.cos(np.pi / 6)]])
    wrong = {
        "exact J": np.eye(2),
        "true J half": 0.5 * np.eye(2),
        "true J 1.5 times": 1.5 * np.eye(2),
        "J at 30°": turn,
    }
    rows = []
    for gain in (0.5, 0.7, 0.9, 0.99):
        row: dict[str, object] = {"share": gain}
        for late in (0.0, 1.0):
            for name, true in wrong.items():
                controller = PredictiveController(
                    np.eye(2),
                    interval=interval,
                    feature_weight=np.ones(2),
                    control_weight=np.full(2, interval**2 * (1 - gain) / gain),
                    delay=0.5 * interval,
                    saturation=1e6,
                )
                run = simulate(
                    controller,
                    np.full((300, 2), 50.0),
                    jacobian=true,
                    stage=Stage(saturation=1e6, step=0.0, travel=1e6),
                    camera=Camera(interval=interval, latency=(0.5 + late) * interval),
                    rng=0,
                    start=(0.0, 0.0),
                )
                outside = np.flatnonzero(np.linalg.norm(run.feature - 50.0, axis=1) > 0.5)
                row[f"{name}, {late:g} samples late"] = int(outside[-1]) + 1
        rows.append(row)
    return pd.DataFrame(rows)


NOTE = """\
Each row is over {runs} runs. A rendered gripper of 50 px stands under a camera that is turned at
random, mirrored or not, with 0.08 to 0.6 px/µm and a noise of two grey levels. The target lies up
to 50 px away in x and in y, and the tolerance is 0.05 px. Errors are those of the true feature;
for the demo camera that is its stage at 1 µm/px.
"""


def main() -> None:
    installed = engine()
    kinds = ["simulated", "engine"] if installed else ["simulated"]
    runs = [(kind, "position") for kind in kinds + (["demo"] if installed else [])]
    both = [*runs[: len(kinds)], ("simulated", "velocity")]
    reached, errors = targets([*runs, ("simulated", "velocity")])
    failed, bad, farthest = faults(both)
    interrupted, moving = interrupts(kinds)
    lines = []
    for kind, drive in runs:
        all_reached, worst, mean = errors[kind, drive]
        lines += [
            (f"{NAMES[kind]}: reached", float(all_reached), "≥", 1.0),
            (f"{NAMES[kind]}: worst error (px)", worst, "≤", 0.12),
            (f"{NAMES[kind]}: mean error (px)", mean, "≤", 0.05),
        ]
    lines += [
        ("faults that did not end with a reason and the stage still", bad, "≤", 0.0),
        ("farthest from the start, of the travel", farthest, "≤", 1.0),
        ("stages moving after Ctrl-C", moving, "≤", 0.0),
    ]
    publish(
        "microscope",
        {
            "Targets": reached,
            "Faults": failed,
            "Ctrl-C at random moments": interrupted,
            "Loop gain": loop_gains(),
        },
        limits=must_hold(lines),
        note=NOTE.format(runs=len(SEEDS))
        + (f" pymmcore-plus {installed}." if installed else " pymmcore-plus was not installed."),
    )


if __name__ == "__main__":
    main()
