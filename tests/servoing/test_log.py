"""Rows of the log: what is not known is NaN, and events keep their order."""

from __future__ import annotations

import numpy as np

from microlib.servoing._log import COLUMNS, add_event, as_frame, median_latency, new_row, put


def test_a_new_row_knows_the_time_the_phase_and_the_target() -> None:
    row = new_row(1.5, "servo", 3)
    known = {"time_s": 1.5, "phase": "servo", "target": 3, "lost": False, "event": ""}
    assert {name: row[name] for name in known} == known
    rest = {name: value for name, value in row.items() if name not in known}
    assert set(rest) | set(known) == set(COLUMNS)
    assert np.isnan(list(rest.values())).all()


def test_both_axes_and_all_events_are_entered() -> None:
    row = new_row(0.0, "servo", 0)
    put(row, "stage", np.array([1.0, -2.0]), "um")
    assert (row["stage_x_um"], row["stage_y_um"]) == (1.0, -2.0)
    add_event(row, "limit")
    assert row["event"] == "limit"
    add_event(row, "travel")
    assert row["event"] == "limit; travel"
    table = as_frame([row, new_row(1.0, "end", -1)])
    assert {name: str(kind) for name, kind in table.dtypes.items()} == COLUMNS
    assert table["event"].tolist() == ["limit; travel", ""]
    assert table["target"].tolist() == [0, -1]


def test_the_latency_is_the_median_of_what_is_known() -> None:
    rows = [new_row(0.0, "servo", 0) for _ in range(4)]
    assert np.isnan(median_latency(rows))
    assert np.isnan(median_latency([]))
    for row, latency in zip(rows, (0.5, 0.1, 0.2), strict=False):
        row["latency_s"] = latency
    assert median_latency(rows) == 0.2
