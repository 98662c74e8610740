"""Print benchmark tables and keep them, with the machine named, where the book finds them."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from collections.abc import Callable, Iterable
from datetime import date
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

import numpy as np
import pandas as pd

__all__ = ["machine", "must_hold", "paired_times", "publish"]

RESULTS = Path(__file__).parent / "results"


def machine() -> dict[str, str]:
    """Return what a reader needs to judge a result: processor, cores, day, commit, versions."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        model = names[0].split(":", 1)[1].strip() if names else model
    command = ["git", "describe", "--always", "--dirty= with changes", "--exclude=*", "--abbrev=10"]
    commit = subprocess.run(
        command, capture_output=True, text=True, cwd=RESULTS.parent, check=False
    )
    packages = ("numpy", "scipy", "scikit-image", "opencv-python-headless")
    return {
        "processor": model,
        "cores": str(os.cpu_count()),
        "date": date.today().isoformat(),
        "commit": commit.stdout.strip() or "unknown",
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }


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


def must_hold(lines: Iterable[tuple[str, float, str, float]]) -> pd.DataFrame:
    """Judge lines of what was measured, the number, ``"≤"`` or ``"≥"``, and the limit."""
    rows = []
    for what, number, sense, limit in lines:
        held = number <= limit if sense == "≤" else number >= limit
        rows.append(
            (what, f"{number:.4g}", f"{sense}\N{NO-BREAK SPACE}{limit:g}", "yes" if held else "no")
        )
    return pd.DataFrame(rows, columns=["what", "measured", "limit", "holds"])


def publish(
    name: str,
    tables: dict[str, pd.DataFrame],
    *,
    limits: pd.DataFrame | None = None,
    note: str = "",
) -> None:
    """Print `tables` (title to frame) and write ``results/NAME.json``, which the book shows."""
    shown = tables if limits is None else {"Must hold": limits, **tables}
    for title, frame in shown.items():
        print(f"\n{title}\n{frame.to_string(index=False)}")
    record = {
        "machine": machine(),
        "note": note,
        "limits": [] if limits is None else limits.to_numpy().tolist(),
        "tables": {
            title: frame.to_dict(orient="split", index=False) for title, frame in tables.items()
        },
    }
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.json"
    path.write_text(json.dumps(record, indent=1, ensure_ascii=False, default=float) + "\n")
