"""Print benchmark tables and keep them, with the machine named, where the book finds them."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from collections.abc import Callable
from datetime import date
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

import numpy as np
import pandas as pd
from numpy.typing import NDArray

RESULTS = Path(__file__).parent / "results"
#: Title to table.
Tables = dict[str, pd.DataFrame]
#: What was measured, the number, ``"≤"`` or ``"≥"``, and the limit.
Limits = list[tuple[str, float, str, float]]


def machine() -> dict[str, str]:
    """Return what a reader needs to judge a result: processor, cores, day, commit, versions."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        model = names[0].split(":", 1)[1].strip() if names else model

    def git(*words: str) -> str:
        command = ["git", *words]
        run = subprocess.run(command, capture_output=True, text=True, cwd=RESULTS, check=False)
        return run.stdout.strip()

    commit = git("rev-parse", "--short=10", "HEAD")
    if git("status", "--short", "--untracked-files=no", "--", ":/", ":!."):  # other than results
        commit += " with changes"
    packages = ("numpy", "scipy", "scikit-image", "opencv-python-headless")
    return {
        "processor": model,
        "cores": str(os.cpu_count()),
        "date": date.today().isoformat(),
        "commit": commit or "unknown",
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }


def rms(error: NDArray) -> float:
    """Return the root mean square of what is known."""
    return float(np.sqrt(np.nanmean(np.square(error))))


def paired_times(
    ours: Callable[[], object],
    peer: Callable[[], object],
    *,
    rounds: int = 7,
    clock: Callable[[], float] = perf_counter,
) -> tuple[float, float, float]:
    """Time two callables in turn; return both medians (s) and the median of their ratios."""
    ours(), peer()
    times = np.empty((rounds, 2))
    for row in times:
        for column, call in enumerate((ours, peer)):
            start = clock()
            call()
            row[column] = clock() - start
    medians = np.median(times, axis=0)
    return float(medians[0]), float(medians[1]), float(np.median(times[:, 0] / times[:, 1]))


def must_hold(lines: Limits) -> pd.DataFrame:
    """Judge what was measured beside its limit."""
    rows = []
    for what, number, sense, limit in lines:
        held = number <= limit if sense == "≤" else number >= limit
        rows.append(
            (what, f"{number:.4g}", f"{sense}\N{NO-BREAK SPACE}{limit:g}", "yes" if held else "no")
        )
    return pd.DataFrame(rows, columns=["what", "measured", "limit", "holds"])


def publish(name: str, tables: Tables, limits: Limits, note: str, minutes: float) -> None:
    """Write `tables` to ``results/NAME.json``, which the book shows, and print them."""
    judged = must_hold(limits)
    record = {
        "machine": machine(),
        "minutes": round(minutes, 1),
        "note": note,
        "limits": judged.to_numpy().tolist(),
        "tables": {
            title: frame.to_dict(orient="split", index=False) for title, frame in tables.items()
        },
    }
    path = RESULTS / f"{name}.json"
    path.write_text(json.dumps(record, indent=1, ensure_ascii=False, default=float) + "\n")
    for title, frame in {"Must hold": judged, **tables}.items():
        print(f"\n{title}\n{frame.to_string(index=False)}")
