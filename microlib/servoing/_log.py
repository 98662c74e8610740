"""The log of a run: one row a frame, the same columns whatever was steered."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from microlib._common import Array

if TYPE_CHECKING:
    import pandas as pd

#: The columns, with the type of each.
COLUMNS = {
    "time_s": "float64",
    "phase": "object",
    "target": "int64",
    **{f"{name}_{axis}_px": "float64" for name in ("reference", "measured") for axis in "xy"},
    "lost": "bool",
    **{f"{name}_{axis}_um": "float64" for name in ("stage", "command") for axis in "xy"},
    "latency_s": "float64",
    "event": "object",
}


def new_row(time: float, phase: str, target: int) -> dict[str, Any]:
    """Return a row without measurements."""
    about = {"time_s": time, "phase": phase, "target": target, "lost": False, "event": ""}
    return dict.fromkeys(COLUMNS, np.nan) | about


def put(row: dict[str, Any], name: str, value: Array, unit: str) -> None:
    """Enter both axes of a quantity."""
    row[f"{name}_x_{unit}"], row[f"{name}_y_{unit}"] = map(float, value)


def add_event(row: dict[str, Any], event: str) -> None:
    """Add an event to those of the row."""
    row["event"] = "; ".join(filter(None, (row["event"], event)))


def as_frame(rows: list[dict[str, Any]]) -> pd.DataFrame:
    """Return the rows as a table."""
    import pandas as pd  # here, as it takes long to import

    return pd.DataFrame(rows, columns=list(COLUMNS)).astype(COLUMNS)
