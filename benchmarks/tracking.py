"""The tracker beside OpenCV's ECC and pyramidal Lucas-Kanade, on the same rendered frames.

Run with ``python -m benchmarks tracking``; it takes about four minutes of one core.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from time import process_time, thread_time

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.report import Limits, Tables, paired_times
from compendium.experiments.section_5_3 import texture_sequence
from microlib.synthetic import gripper_scene, mixed_texture
from microlib.tracking import ESMTracker, KalmanFilter
from tests.scenes import WarpedPair, camera_frame, warped_pair

Array = NDArray[np.float64]
#: Corners (4×2, px) and iterations, or None where a method says that it failed.
Found = tuple[Array, float] | None

TRIALS = 40
INTERVAL = 1 / 33
MODES = {
    "translation": cv2.MOTION_TRANSLATION,
    "affine": cv2.MOTION_AFFINE,
    "homography": cv2.MOTION_HOMOGRAPHY,
}
CELLS = [
    ("shift", "translation", (3.0, 7.6, 20.0, 32.0)),
    ("shift", "homography", (3.0, 15.0)),
    ("affine", "affine", (3.0, 7.6, 15.0)),
    ("homography", "homography", (3.0, 7.6, 15.0)),
]


@lru_cache(maxsize=2000)
def frames_of(seed: int, distance: float, warp: str) -> WarpedPair:
    """Every method sees the same pairs."""
    return warped_pair(seed, distance, warp=warp)


def esm(pair: WarpedPair, motion: str) -> Found:
    track = ESMTracker(pair.first, pair.box, motion).track(pair.second)
    return None if track.lost else (track.corners, track.iterations)


def ecc(pair: WarpedPair, motion: str, filter_size: int) -> Found:
    x, y, width, height = pair.box
    warp = np.eye(3, dtype=np.float32)
    warp[:2, 2] = x, y
    warp = warp if motion == "homography" else warp[:2]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-6)
    template = pair.first[y : y + height, x : x + width]
    try:
        _, warp = cv2.findTransformECC(
            template, pair.second, warp, MODES[motion], criteria, None, filter_size
        )
    except cv2.error:
        return None
    corners = np.array([[0.0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]])
    mapped = np.column_stack([corners, np.ones(4)]) @ warp.T
    return (mapped[:, :2] / mapped[:, 2:] if motion == "homography" else mapped), np.nan


def lucas_kanade(pair: WarpedPair) -> Found:
    x, y, width, height = pair.box
    middle = np.array([[x + (width - 1) / 2, y + (height - 1) / 2]], np.float32)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
    moved, status, _ = cv2.calcOpticalFlowPyrLK(
        pair.first,
        pair.second,
        middle,
        None,
        winSize=(width - 1, height - 1),
        maxLevel=3,
        criteria=criteria,
    )
    if not status[0, 0]:
        return None
    half = np.array([width - 1, height - 1]) / 2
    return moved[0] + half * [[-1, -1], [1, -1], [1, 1], [-1, 1]], np.nan


def methods(motion: str) -> dict[str, Callable[[WarpedPair], Found]]:
    chosen: dict[str, Callable[[WarpedPair], Found]] = {
        "ESM": lambda pair: esm(pair, motion),
        "ECC, filter 5": lambda pair: ecc(pair, motion, 5),
    }
    if motion == "translation":
        chosen["pyramidal LK"] = lucas_kanade
    return chosen


def convergence() -> pd.DataFrame:
    """Success (all corners within 1 px) and error over warps of growing size."""
    rows = []
    for warp, motion, distances in CELLS:
        for distance in distances:
            tally: dict[str, list[tuple[float, float]]] = {name: [] for name in methods(motion)}
            wrong = dict.fromkeys(tally, 0)
            for seed in range(TRIALS):
                pair = frames_of(seed, distance, warp)
                for name, method in methods(motion).items():
                    found = method(pair)
                    if found is None:
                        continue
                    error = np.linalg.norm(found[0] - pair.corners, axis=1)
                    if error.max() < 1.0:
                        tally[name].append((float(np.mean(error**2)), found[1]))
                    else:
                        wrong[name] += 1
            for name, hits in tally.items():
                squares, steps = np.transpose(hits) if hits else np.full((2, 1), np.nan)
                rows.append(
                    {
                        "motion": motion,
                        "warp": warp,
                        "corner displacement (px)": distance,
                        "method": name,
                        "success (%)": round(100 * len(hits) / TRIALS, 1),
                        "wrong (%)": round(100 * wrong[name] / TRIALS, 1),
                        "RMS corner error (px)": round(float(np.sqrt(np.mean(squares))), 4),
                        "steps": round(float(np.mean(steps)), 1),
                    }
                )
    return pd.DataFrame(rows)


def times() -> pd.DataFrame:
    """Time of one frame, the template being known, beside ECC on the same pair."""
    rows = []
    for motion in MODES:
        for distance in (1.0, 2.0):
            pair = warped_pair(1, distance)
            tracker = ESMTracker(pair.first, pair.box, motion)
            start = tracker._pose

            def ours(tracker=tracker, start=start, frame=pair.second) -> object:
                tracker._pose = start
                return tracker.track(frame)

            def peer(pair=pair, motion=motion) -> object:
                return ecc(pair, motion, 5)

            mine, other, ratio = paired_times(ours, peer, rounds=201, clock=process_time)
            rows.append(
                {
                    "motion": motion,
                    "shift (px)": distance,
                    "ESM (ms)": round(1e3 * mine, 3),
                    "ECC (ms)": round(1e3 * other, 3),
                    "ESM / ECC": round(ratio, 2),
                    "ESM frames/s": round(1 / mine),
                }
            )
    return pd.DataFrame(rows)


def moving_square(speed: float, seed: int) -> tuple[list, Array]:
    """Frames of a textured square on another texture, and its path."""
    rng = np.random.default_rng(seed)
    path = circle(speed, rng) + 115
    return texture_sequence(path, rng), path


def moving_texture(speed: float, seed: int) -> tuple[list, Array]:
    """Frames of one texture that moves as a whole, and the path of one of its points."""
    rng = np.random.default_rng(seed)
    path = np.rint(circle(speed, rng))
    texture = mixed_texture((400, 400), rng, scales=1.0, std=45.0)
    frames = [
        camera_frame(np.roll(texture, (int(y), int(x)), (0, 1))[:300, :300], rng, noise=2.0)
        for x, y in path
    ]
    return frames, path + 115


def circle(speed: float, rng: np.random.Generator) -> Array:
    angle = speed * INTERVAL / 80 * np.arange(66) + rng.uniform(0, 2 * np.pi)
    return 80 * np.column_stack([np.cos(angle), np.sin(angle)])


def sequences() -> pd.DataFrame:
    """Two seconds at 33 Hz with the Kalman filter's start: how many of 5 runs are never lost."""
    rows = []
    for scene in (moving_texture, moving_square):
        for speed in (250.0, 500.0, 1e3):
            for motion in ("translation", "homography"):
                done, worst = 0, 0.0
                for seed in range(5):
                    frames, path = scene(speed, seed)
                    error = followed(frames, path, motion)
                    done += error < 1.0
                    worst = max(worst, error) if error < 1.0 else worst
                rows.append(
                    {
                        "scene": scene.__name__.replace("_", " "),
                        "speed (px/s)": speed,
                        "motion": motion,
                        "runs completed (%)": 20 * done,
                        "largest error (px)": round(worst, 3),
                    }
                )
    return pd.DataFrame(rows)


def followed(frames: list, path: Array, motion: str) -> float:
    """Return the largest error of the center along a sequence, or infinity if it was lost."""
    x, y = np.ceil(path[0]).astype(int)
    start = np.array([x + 24.0, y + 24.0])
    kalman = KalmanFilter(start, interval=INTERVAL, acceleration=3000.0, noise=0.1)
    tracker = ESMTracker(frames[0], (int(x), int(y), 49, 49), motion, kalman=kalman)
    worst = 0.0
    for frame, position in zip(frames[1:], path[1:], strict=True):
        track = tracker.track(frame)
        if track.lost:
            return np.inf
        worst = max(worst, float(np.linalg.norm(track.center - start - position + path[0])))
    return worst


def drift() -> pd.DataFrame:
    """Frames of the gripper on a known path, and the rate on this machine."""
    rows = []
    for zoom, pixel_size, size in (("1X", 6.23, 50), ("4X", 1.55, 90)):
        for motion in MODES:
            rng = np.random.default_rng(0)
            scene = gripper_scene(rng, pixel_size=pixel_size)
            box = scene.box(size)
            middle = np.array([box[0], box[1]]) + (size - 1) / 2
            tracker = ESMTracker(scene.frame((0, 0), rng), box, motion)
            errors, times = [], []
            for k in range(500):
                truth = 40 * np.array([np.sin(k / 40), np.cos(k / 30) - 1])
                frame = scene.frame(truth, rng)
                start = thread_time()
                track = tracker.track(frame)
                times.append(thread_time() - start)
                errors.append(
                    np.inf if track.lost else np.linalg.norm(track.center - middle - truth)
                )
            rows.append(
                {
                    "zoom": zoom,
                    "window (px)": size,
                    "motion": motion,
                    "end error (px)": round(float(errors[-1]), 4),
                    "largest error (px)": round(float(np.max(errors)), 4),
                    "frames/s": round(1 / float(np.median(times))),
                }
            )
    return pd.DataFrame(rows)


def limits(tables: Tables) -> Limits:
    cells = tables["Convergence"].set_index(
        ["motion", "warp", "corner displacement (px)", "method"]
    )
    frame, runs = tables["Time of one frame"].set_index("motion"), tables["Sequences"]
    drift = tables["Drift over 500 frames of the gripper"]

    def success(motion: str, warp: str, distance: float) -> tuple:
        what = f"{motion}, corners moved {distance:g} px by a {warp}: success, %"
        return what, cells.loc[(motion, warp, distance, "ESM"), "success (%)"]

    def completed(speed: float) -> tuple:
        chosen = runs.loc[runs["speed (px/s)"] == speed, "runs completed (%)"]
        return f"sequences at {speed:g} px/s: runs completed, least of scenes, %", chosen.min()

    near = cells.loc[("translation", "shift", 3.0, "ESM"), "RMS corner error (px)"]
    wrong = cells.xs("ESM", level="method")["wrong (%)"].max()
    return [
        *((*success("translation", "shift", far), "≥", 100) for far in (3.0, 7.6, 20.0)),
        (*success("translation", "shift", 32.0), "≥", 95),
        ("translation by 3 px: RMS corner error, px", near, "≤", 0.015),
        (*success("affine", "affine", 7.6), "≥", 98),
        (*success("homography", "homography", 7.6), "≥", 98),
        (*success("homography", "homography", 15.0), "≥", 80),
        ("more than 1 px off and not called lost, worst row, %", wrong, "≤", 0),
        ("translation: time over ECC's", frame.loc["translation", "ESM / ECC"].max(), "≤", 5),
        ("affine: time over ECC's", frame.loc["affine", "ESM / ECC"].max(), "≤", 3),
        (*completed(250.0), "≥", 100),
        (*completed(500.0), "≥", 90),
        ("drift at the end of 500 frames, px", drift["end error (px)"].max(), "≤", 0.2),
    ]


NOTE = f"""\
Templates are 50×50 px of white noise, blurred by σ = 1 px; the camera's noise is 2 grey levels,
and the gain changes by 5 %. A trial moves the corners by exactly the displacement named (root mean
square), either by a shift in a random direction or each corner on its own. It succeeds if all four
corners are found to within 1 px; *wrong* is more than that, and not called lost. {TRIALS} trials a
row.

*Times* are the processor's, of one frame within a sequence.
"""


def main() -> tuple[Tables, Limits]:
    tables = {
        "Convergence": convergence(),
        "Time of one frame": times(),
        "Sequences": sequences(),
        "Drift over 500 frames of the gripper": drift(),
    }
    return tables, limits(tables)
