"""Time of a calibration with thousands of marks, beside that of OpenCV.

Run with ``python -m benchmarks thousands``; it takes a minute.
"""

from __future__ import annotations

from functools import partial
from time import process_time

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.calibration import tilted
from benchmarks.report import Limits, Tables, paired_times
from microlib.calibration import calibrate

MARKS = (4096, 16384)

CALIBRATION = "Calibration from many marks of one view, CPU time"


def peer_calibrate(world: np.ndarray, image: np.ndarray, f: float) -> tuple[float, float]:
    """cv2.calibrateCamera on the one plane: its focal length and its standard deviation, in µm of
    the model's T_op + f."""
    guess = f / 9.9
    camera = np.array([[guess, 0, 327.5], [0, guess, 245.0], [0, 0, 1]])
    flags = (
        cv2.CALIB_USE_INTRINSIC_GUESS
        | cv2.CALIB_FIX_PRINCIPAL_POINT
        | cv2.CALIB_FIX_ASPECT_RATIO
        | cv2.CALIB_ZERO_TANGENT_DIST
        | cv2.CALIB_FIX_K2
        | cv2.CALIB_FIX_K3
    )
    flat = np.column_stack([world, np.zeros(len(world))]).astype(np.float32)
    result = cv2.calibrateCameraExtended(
        [flat], [image.astype(np.float32)], (656, 491), camera, np.zeros(5), flags=flags
    )
    # OpenCV adjusts f_y and ties f_x to it; the deviation of f_x is that of a fixed number, zero.
    return float(result[1][1, 1] * 9.9), float(result[5].ravel()[1] * 9.9)


def view(count: int) -> tuple[float, NDArray, NDArray]:
    """Return the length of the optical path, and marks of a tilted plane with where they are."""
    scope, _ = tilted(10)
    side = round(np.sqrt(count))
    seen = np.stack(np.meshgrid(np.linspace(8, 648, side), np.linspace(8, 483, side)), axis=-1)
    flat = scope.back_project(seen.reshape(-1, 2))
    noise = np.random.default_rng(0).normal(0, 0.02, flat.shape)
    return scope.tube_length + scope.focal_length, flat, scope.project(flat) + noise


def calibrations() -> pd.DataFrame:
    focal = tilted(10)[0].focal_length
    rows = []
    for count in MARKS:
        path, world, seen = view(count)
        options = {"focal_length": focal, "pixel_size": 9.9, "image_size": (656, 491)}
        found = paired_times(
            partial(calibrate, world, seen, **options),
            partial(peer_calibrate, world, seen, path),
            rounds=3,
            clock=process_time,
        )
        rows.append((count, *np.round(found, 3)))
    return pd.DataFrame(rows, columns=["marks", "microlib, s", "calibrateCamera, s", "ratio"])


NOTE = """\
Each calibration is of one view of a tilted plane, with noise of 0.02 px on the marks.
"""


def main() -> tuple[Tables, Limits]:
    marks = calibrations()
    ours = marks["microlib, s"]
    return {CALIBRATION: marks}, [
        ("calibrate over calibrateCamera, 16384 marks", marks["ratio"].iloc[-1], "≤", 1),
        ("time of 16384 marks over that of 4096", ours.iloc[-1] / ours.iloc[0], "≤", 6),
    ]
