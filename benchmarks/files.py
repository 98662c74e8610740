"""The order of the frames of a folder, beside tifffile and names that are sorted.

Run as ``python -m benchmarks files``; takes seconds.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import pandas as pd
from tifffile import natural_sorted

from benchmarks.report import Limits, Tables
from microlib.io import read_frames

ORDER_TABLE = "Order of the frames in a folder"
#: The names of nine frames in their order.
NAMES = {
    "counter, z1 to z9": [f"z{k}" for k in range(1, 10)],
    "counter without zeros, z8 to z16": [f"z{k}" for k in range(8, 17)],
    "numbers with gaps, f2 to f130": [f"f{k}" for k in (2, 18, 34, 50, 66, 82, 98, 114, 130)],
    "sign, z-40 to z+40": [f"z{k:+d}" for k in range(-40, 50, 10)],
    "negative numbers, z-8 to z0": [f"z{k}" for k in range(-8, 1)],
    "decimals, z_0 to z_0.4": [f"z_{0.05 * k:g}" for k in range(9)],
    "decimal comma, z_0,5 to z_4,5": [f"z_{0.5 * k:.1f}".replace(".", ",") for k in range(1, 10)],
    "counter that begins again, DSC_9994 to DSC_0003": [
        f"DSC_{(9993 + k) % 9999 + 1:04d}" for k in range(9)
    ],
    "two axes, c0_z9 to c2_z11": [f"c{c}_z{z}" for c in range(3) for z in range(9, 12)],
}


def judged(names: list[str]) -> dict[str, str]:
    """Return whether each program has the frames in order; a rejection asks the user."""
    with TemporaryDirectory() as top:
        paths = [Path(top) / f"{name}.png" for name in names]
        for k, path in enumerate(paths):
            cv2.imwrite(str(path), np.full((8, 9), k, np.uint8))
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                order = [int(frame[0, 0]) for frame in read_frames(top)]
            wrong = "wrong, with a warning" if caught else "wrong"
            ours = "right" if order == list(range(len(names))) else wrong
        except ValueError:
            ours = "rejected"
        right = [str(path) for path in paths]
    others = {"tifffile.natural_sorted": natural_sorted(right), "sorted by name": sorted(right)}
    peers = {name: "right" if list(order) == right else "wrong" for name, order in others.items()}
    return {"microlib": ours} | peers


NOTE = """\
Nine frames are written under each kind of name and read again. *Rejected* means that the command
names both possible orders and asks for a list of files. A warning names the files between which
some may be missing. A wrong order without a warning is not noticed by a program that measures the
frames.
"""


def main() -> tuple[Tables, Limits]:
    rows = [{"names": kind} | judged(names) for kind, names in NAMES.items()]
    table = pd.DataFrame(rows)
    wrong = int((table["microlib"] == "wrong").sum())
    return {ORDER_TABLE: table}, [("wrong orders of frames without a warning", wrong, "≤", 0)]
