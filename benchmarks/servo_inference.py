"""What Tables 5.3 and 5.4 can tell: evidence, numbers predicted without themselves, calibration.

Run with ``python -m benchmarks.servo_inference``; it takes three quarters of an hour of one core.
Named parts, such as ``evidence`` or ``left-out``, are measured alone.
Besides the tables it writes ``data/inference/section_5_4.json``, which chapter 5 reads.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.report import must_hold, publish
from compendium.experiments import servo_predictions, servo_record
from compendium.experiments.servo_inference import (
    BLOCKS,
    NUMBERS,
    Problem,
    log_likelihood,
    printed,
)
from compendium.experiments.servo_models import LEADING, MECHANISMS, RARE, priors, values
from compendium.experiments.servo_sampler import Posterior, infer

SEEDS = range(5)
#: States of each seed; where a disturbance is rare, a good explanation takes less of the prior.
PARTICLES, RARE_PARTICLES = 720, 960
#: More where five seeds of so many deviated by more than a half: what explains the tables best is
#: a small and noisy part of the prior.
MORE_PARTICLES = {"dropped frames": 1920, "bursts": 2880, "latency jitter": 960}
#: Sets of numbers drawn from the prior, their seeds' second part, and states of each.
SETS, SET_SEED, SET_PARTICLES = 100, 8, 240
#: States of each of the ninety runs without a number.
LEFT_OUT_PARTICLES = 240
CALIBRATED = ("base", "stage jumps")
#: Particles at which the noise of the likelihood is measured, and estimates at each.
NOISY, ESTIMATES = 20, 30


@cache
def run(model: str, seed: int) -> Posterior:
    """All eighteen numbers by one model and seed."""
    usual = RARE_PARTICLES if model in RARE else PARTICLES
    return infer(Problem(model, printed()), seed, MORE_PARTICLES.get(model, usual))


def evidence() -> dict[str, list[float]]:
    """Log evidence of every model by each seed."""
    return {
        model: [round(run(model, seed).log_evidence, 3) for seed in SEEDS] for model in MECHANISMS
    }


def posterior() -> dict[str, Any]:
    """What the leading models leave of their unknown numbers and of the readings."""
    return {model: left_by(model) for model in LEADING}


def left_by(model: str) -> dict[str, Any]:
    """What one model leaves of its unknown numbers and of the readings, and the noise of that."""
    problem = Problem(model, printed())
    runs = [run(model, seed) for seed in SEEDS]
    normal = np.concatenate([each.normal for each in runs])
    rng = np.random.default_rng(2)
    read = servo_predictions.readings(runs[0], rng)
    some = np.repeat(normal[:: len(normal) // NOISY][:NOISY], ESTIMATES, axis=0)
    again = [problem.of_block(some, b, rng, runs[0].runs[b]) for b in range(len(BLOCKS))]
    noise = log_likelihood(again).reshape(-1, ESTIMATES).std(axis=1)
    quantiles = [
        np.quantile(each, servo_predictions.QUANTILES) for each in values(model, normal).values()
    ]
    return {
        "names": [prior.name for prior in priors(model)],
        "quantiles": np.round(quantiles, 4).tolist(),
        "widths": normal.std(axis=0).round(3).tolist(),
        "correlation": np.corrcoef(normal.T).round(3).tolist(),
        "steps": read.steps.round(4).tolist(),
        "paths": read.paths.round(4).tolist(),
        "noise": round(float(np.median(noise)), 2),
        "runs": [int(each) for each in runs[0].runs],
    }


def left_out() -> dict[str, list[list[float]]]:
    """Interval of each number from a run without it, for each leading model."""
    return {
        model: [
            [
                round(end, 4)
                for end in servo_predictions.left_out(model, place, 0, LEFT_OUT_PARTICLES)
            ]
            for place in range(len(NUMBERS))
        ]
        for model in LEADING
    }


def calibration() -> dict[str, Any]:
    """Ranks of drawn unknown numbers in the posteriors of their own tables."""
    return {
        model: {
            "names": [prior.name for prior in priors(model)],
            "ranks": [
                np.round(servo_predictions.rank(model, [seed, SET_SEED], SET_PARTICLES), 4).tolist()
                for seed in range(SETS)
            ],
        }
        for model in CALIBRATED
    }


def small() -> list[float]:
    """What a notebook and a test remake."""
    return servo_record.summary(servo_record.small_piece())


PARTS: dict[str, Callable[[], Any]] = {
    "small": small,
    "evidence": evidence,
    "posterior": posterior,
    "left out": left_out,
    "calibration": calibration,
}


def measure(names: list[str]) -> None:
    """Make parts of the record anew and write it after each."""
    path = servo_record.PATH
    for name in names:
        made = PARTS[name]()
        kept = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        write(kept | {name: made})
        print(f"{name} measured", flush=True)


def write(kept: dict[str, Any]) -> None:
    """Write the parts that there are, in their order."""
    servo_record.PATH.parent.mkdir(parents=True, exist_ok=True)
    ordered = {part: kept[part] for part in PARTS if part in kept}
    text = json.dumps(ordered, separators=(",", ":"))
    servo_record.PATH.write_text(text.replace("],", "],\n") + "\n", encoding="utf-8")


def noise_table() -> pd.DataFrame:
    """Deviation of the estimated log likelihood at a model's own particles."""
    kept = servo_record.record()["posterior"]
    names = [f"{kind} at {zoom}" for zoom, kind in BLOCKS]
    rows = [(model, each["noise"], *each["runs"]) for model, each in kept.items()]
    return pd.DataFrame(rows, columns=["model", "deviation of the log likelihood", *names])


def tell() -> None:
    """Print and keep the tables of the record."""
    evidences, ranks = servo_record.evidence(), servo_record.calibration()
    intervals = servo_record.record()["left out"]
    publish(
        "servo_inference",
        {
            "Evidence": evidences.round(2),
            "Numbers left out one by one": servo_record.left_out_table(),
            "Calibration": ranks.round(3),
            "Noise": noise_table(),
        },
        limits=must_hold(
            [
                (
                    "largest deviation of a log evidence over five seeds",
                    evidences["deviation"].max(),
                    "≤",
                    servo_record.STEADY,
                ),
                (
                    "numbers of each leading model with an interval from a run without it",
                    min(len(each) for each in intervals.values()),
                    "≥",
                    len(NUMBERS),
                ),
                (
                    "models whose ranks are not uniform",
                    float((ranks["uniform"] == "no").sum()),
                    "≤",
                    0,
                ),
            ]
        ),
        note=f"{PARTICLES} states, {RARE_PARTICLES} where a disturbance is rare, up to "
        f"{max(MORE_PARTICLES.values())} where that left the evidence uncertain by over a half, "
        f"{LEFT_OUT_PARTICLES} for each number left out, {SET_PARTICLES} for the calibration; "
        "intervals hold 90 %. The noise is that of the runs beside it. "
        "Ranks by Kolmogorov and Smirnov, at 5 % over the count of numbers. "
        "Section 5.4 of the book says what is inferred.",
    )


def main() -> None:
    names = [name.replace("-", " ") for name in sys.argv[1:]]
    measure(names or list(PARTS))
    tell()


if __name__ == "__main__":
    main()
