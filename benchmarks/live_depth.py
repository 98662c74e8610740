"""Depth while acquiring: frames saved, what is missed, the same depth, and the time of a push.

Run with ``python -m benchmarks.live_depth``; it takes some two minutes of one core.
"""

from __future__ import annotations

from time import process_time

import numpy as np
import pandas as pd

from benchmarks.report import must_hold, publish
from compendium.experiments.live_depth import COARSE, POSITIONS, frames_of, saved
from microlib.automation import LiveDepth
from microlib.focus import depth_from_focus

#: The rules were chosen on seeds 0 to 37.
SEEDS = range(100, 106)
WAYS = ("farthest", "coarse")


def runs() -> pd.DataFrame:
    """One row a scene, a seed and a way to know the end."""
    return pd.concat([saved(seed) for seed in SEEDS])


def summarize(table: pd.DataFrame) -> pd.DataFrame:
    """Frames saved and errors by scene and way."""
    rows = []
    for (name, way), group in table.groupby(["scene", "way"], sort=False):
        rows.append(
            {
                "scene": name,
                "end known by": "the greatest height" if way == "farthest" else "a coarse look",
                "frames saved, median (%)": group["saved"].median(),
                "least (%)": group["saved"].min(),
                "highest part seen": f"{int(group['seen'].sum())} of {len(group)}",
                "RMS error (µm)": group["rms"].median(),
                "of the whole stack (µm)": group["rms of all"].median(),
            }
        )
    return pd.DataFrame(rows).round(2)


def push_times() -> tuple[float, float]:
    """Return the median time of a push and the whole's time over its frames, ms."""
    stack = frames_of("cone", 0)
    depth_from_focus(stack, POSITIONS)
    pushes, shares = [], []
    for _ in range(7):
        live = LiveDepth(farthest=1e6)
        start = process_time()
        for frame, z in zip(stack, POSITIONS, strict=True):
            live.push(frame, z)
        middle = process_time()
        depth_from_focus(stack, POSITIONS)
        pushes.append(1e3 * (middle - start) / len(stack))
        shares.append(1e3 * (process_time() - middle) / len(stack))
    return float(np.median(pushes)), float(np.median(shares))


NOTE = """\
Each stack has {positions} positions, 12 µm apart. The parts are 120 to 150 µm high; one scene
fills the whole range, and one has a part 12 px wide and 100 µm high on a dome. The blur grows by
0.06 px per µm, the noise is two grey levels, a coarse look takes every {coarse} positions, and
there are {seeds} seeds.
"""


def main() -> None:
    table = runs()
    push, share = push_times()
    worst = table[table["scene"] != "small part"].groupby(["way", "scene"])["saved"].min()
    saving = {way: int((worst[way] >= 25).sum()) for way in WAYS}
    publish(
        "live_depth",
        {"Frames saved": summarize(table)},
        limits=must_hold(
            [
                (
                    "scenes of four with a quarter of the frames saved, greatest height given",
                    saving["farthest"],
                    "≥",
                    3,
                ),
                (
                    "scenes of four with a quarter of the frames saved, coarse look",
                    saving["coarse"],
                    "≥",
                    3,
                ),
                (
                    "highest parts missed, those of 12 px included",
                    float((~table["seen"] & (table["scene"] != "fills the range")).sum()),
                    "≤",
                    0,
                ),
                ("time of a push over the frame's share of the whole", push / share, "≤", 1),
            ]
        ),
        note=NOTE.format(positions=len(POSITIONS), coarse=COARSE, seeds=len(SEEDS)),
    )


if __name__ == "__main__":
    main()
