"""Depth while acquiring: frames saved, what is missed, the same depth, and the time of a push.

Run with ``python -m benchmarks live_depth``; it takes some two minutes of one core.
"""

from __future__ import annotations

from time import process_time

import pandas as pd

from benchmarks.report import Limits, Tables, paired_times
from compendium.experiments.live_depth import COARSE, POSITIONS, frames_of, saved
from microlib.automation import LiveDepth
from microlib.focus import depth_from_focus

#: The rules were chosen on seeds 0 to 37.
SEEDS = range(100, 106)
WAYS = ("farthest", "coarse")


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


def push_share() -> float:
    """Return the time of all pushes over that of the whole stack at once, median."""
    stack = frames_of("cone", 0)

    def push_all() -> None:
        live = LiveDepth(farthest=1e6)
        for frame, z in zip(stack, POSITIONS, strict=True):
            live.push(frame, z)

    return paired_times(push_all, lambda: depth_from_focus(stack, POSITIONS), clock=process_time)[2]


NOTE = f"""\
Each stack has {len(POSITIONS)} positions, 12 µm apart. The parts are 120 to 150 µm high; one scene
fills the whole range, and one has a part 12 px wide and 100 µm high on a dome. The blur grows by
0.06 px per µm, the noise is two grey levels, a coarse look takes every {COARSE} positions, and
there are {len(SEEDS)} seeds.
"""


def main() -> tuple[Tables, Limits]:
    table = pd.concat([saved(seed) for seed in SEEDS])
    share = push_share()
    worst = table[table["scene"] != "small part"].groupby(["way", "scene"])["saved"].min()
    saving = {way: int((worst[way] >= 25).sum()) for way in WAYS}
    kept = "scenes of four with a quarter of the frames saved"
    missed = float((~table["seen"] & (table["scene"] != "fills the range")).sum())
    return {"Frames saved": summarize(table)}, [
        (f"{kept}, greatest height given", saving["farthest"], "≥", 3),
        (f"{kept}, coarse look", saving["coarse"], "≥", 3),
        ("highest parts missed, those of 12 px included", missed, "≤", 0),
        ("time of a push over the frame's share of the whole", share, "≤", 1),
    ]
