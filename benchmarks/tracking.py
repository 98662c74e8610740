"""The tracker beside OpenCV's ECC and pyramidal Lucas-Kanade, on the same frames.

Run with ``python -m benchmarks.tracking``; it takes about twelve minutes of one core.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import islice
from time import perf_counter
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.report import must_hold, paired_times, publish
from microlib.synthetic import (
    camera_frame,
    gripper_scene,
    mixed_texture,
    texture_sequence,
    warped_pair,
)
from microlib.synthetic._gripper import WarpedPair
from microlib.tracking import ESMTracker, KalmanFilter, _esm, _kalman, _tracker

if TYPE_CHECKING:
    from microlib.synthetic._gripper import WarpedPair

Array = NDArray[np.float64]
#: Corners (4×2, px) and iterations, or None where a method says that it failed.
Found = tuple[Array, float] | None

TRIALS = 200
INTERVAL = 1 / 33
MODES = {
    "translation": cv2.MOTION_TRANSLATION,
    "affine": cv2.MOTION_AFFINE,
    "homography": cv2.MOTION_HOMOGRAPHY,
}
CELLS = [
    ("shift", "translation", (3.0, 7.6, 15.0, 20.0)),
    ("shift", "affine", (5.0, 7.6)),
    ("shift", "homography", (3.0, 7.6, 15.0)),
    ("affine", "affine", (3.0, 5.0, 7.6)),
    ("homography", "homography", (3.0, 7.6, 15.0)),
]


#: Constant of the tracker to the values that are tried in its place; the utmost switch some off.
CONSTANTS = {
    (_tracker, "_COARSEST"): (4, 12, 24),
    (_tracker, "_DEFORMABLE"): (6, 24),
    (_tracker, "_TOLERANCE"): (0.25, 1.0),
    (_tracker, "_LAST_TOLERANCE"): (0.01, 0.2, 0.5),
    (_tracker, "_MOST_STEPS"): (4, 15, 30),
    (_tracker, "_CONVINCING"): (0.8, 0.95),
    (_tracker, "_NOISE_FACTOR"): (1.0, 4.0, 1e3),
    (_tracker, "_INTERPOLATION_LOSS"): (0.0, 0.01),
    (_tracker, "_LARGEST_MATCHED"): (32, 128),
    (_tracker, "_DISTORTION"): (0.0, 0.085, 0.34),
    (_tracker, "_PROMISING"): (-1.0, 0.6, 0.9),
    (_tracker, "_LAST_MARGIN"): (0.0, 3.0, 12.0),
    (_tracker, "_LEAST_CONTRAST"): (0.0, 0.1),
    (_tracker, "_LEAST_CORNERNESS"): (1e-6, 1e-2),
    (_esm, "_DAMPING"): (0.0, 1e-12, 1e-6),
    (_esm, "_VANISHING"): (1e-9, 1e-3),
    (_esm, "_AREA_FACTOR"): (2.0, 16.0, 1e9),
    (_esm, "_LARGEST_STEP"): (1.0, 16.0, 1e9),
    (_esm, "_LEAST_VISIBLE"): (0.0, 0.1, 0.5),
    (_esm, "_TRUNCATION"): (1, 2, 4),
    (_kalman, "_UNKNOWN_VELOCITY"): (1.0, 100.0, 1e4),
}


@lru_cache(maxsize=2000)
def frames_of(seed: int, distance: float, warp: str) -> WarpedPair:
    """Every method sees the same pairs."""
    return warped_pair(np.random.default_rng(seed), distance, warp=warp)


class GradientOnly(ESMTracker):
    """The tracker without its last resorts, the search by correlation and distorted starts."""

    def _starts(self, pose: Array, image: NDArray) -> Iterator:
        return islice(super()._starts(pose, image), len(self._levels))

    def _search_robustly(
        self, image: NDArray, start: Array, best: _esm.Alignment, origin: Array
    ) -> _tracker.Found:
        return self._lost(best, self._reason(best))


def esm(
    pair: WarpedPair, motion: str, kind: type[ESMTracker] = ESMTracker, **options: float
) -> Found:
    track = kind(pair.first, pair.box, motion, **options).track(pair.second)
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
        "ESM, gradients only": lambda pair: esm(pair, motion, GradientOnly),
        "ESM, one resolution": lambda pair: esm(
            pair, motion, GradientOnly, levels=1, smoothing=3.0
        ),
        "ECC, filter 1": lambda pair: ecc(pair, motion, 1),
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
            for seed in range(TRIALS):
                pair = frames_of(seed, distance, warp)
                for name, method in methods(motion).items():
                    found = method(pair)
                    if found is None:
                        continue
                    error = np.linalg.norm(found[0] - pair.corners, axis=1)
                    if error.max() < 1.0:
                        tally[name].append((float(np.mean(error**2)), found[1]))
            for name, hits in tally.items():
                squares, steps = np.transpose(hits) if hits else np.full((2, 1), np.nan)
                rows.append(
                    {
                        "motion": motion,
                        "warp": warp,
                        "corner displacement (px)": distance,
                        "method": name,
                        "success (%)": round(100 * len(hits) / TRIALS, 1),
                        "RMS corner error (px)": round(float(np.sqrt(np.mean(squares))), 4),
                        "steps": round(float(np.mean(steps)), 1),
                    }
                )
    return pd.DataFrame(rows)


def basins() -> pd.DataFrame:
    """The largest shift in whole pixels that 38 of 40 trials survive."""
    rows = []
    for motion in MODES:
        for name, method in methods(motion).items():
            reach = 0
            while reach < 30 and _survivors(method, reach + 1) >= 38:
                reach += 1
            rows.append({"motion": motion, "method": name, "basin (px)": reach})
    return pd.DataFrame(rows)


def _survivors(method: Callable[[WarpedPair], Found], distance: int) -> int:
    hits = 0
    for seed in range(40):
        pair = frames_of(seed, float(distance), "shift")
        found = method(pair)
        if found is not None:
            hits += bool(np.linalg.norm(found[0] - pair.corners, axis=1).max() < 1.0)
        if seed - hits > 2:  # 38 are out of reach
            break
    return hits


def times() -> pd.DataFrame:
    """Time of one frame, the template being known, beside ECC on the same pair."""
    rows = []
    for motion in MODES:
        for distance in (1.0, 2.0):
            pair = warped_pair(np.random.default_rng(1), distance)
            tracker = ESMTracker(pair.first, pair.box, motion)
            start = tracker._pose

            def ours(tracker=tracker, start=start, frame=pair.second) -> object:
                tracker._pose = start
                return tracker.track(frame)

            def peer(pair=pair, motion=motion) -> object:
                return ecc(pair, motion, 1)

            mine, other, ratio = paired_times(ours, peer, rounds=201)
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
    """Two seconds at 33 Hz with the Kalman filter's start: how many of 20 runs are never lost."""
    rows = []
    for scene in (moving_texture, moving_square):
        for speed in (250.0, 500.0, 1e3):
            for motion in ("translation", "homography"):
                done, worst = 0, 0.0
                for seed in range(20):
                    frames, path = scene(speed, seed)
                    error = followed(frames, path, motion)
                    done += error < 1.0
                    worst = max(worst, error) if error < 1.0 else worst
                rows.append(
                    {
                        "scene": scene.__name__.replace("_", " "),
                        "speed (px/s)": speed,
                        "motion": motion,
                        "runs completed (%)": 5 * done,
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
    """A thousand frames of the gripper on a known path, and the rate on this machine."""
    rows = []
    for zoom, pixel_size, size in (("1X", 6.23, 50), ("4X", 1.55, 90)):
        for motion in MODES:
            rng = np.random.default_rng(0)
            scene = gripper_scene(rng, pixel_size=pixel_size)
            box = scene.box(size)
            middle = np.array([box[0], box[1]]) + (size - 1) / 2
            tracker = ESMTracker(scene.frame((0, 0), rng), box, motion)
            errors, spent = [], []
            for k in range(1000):
                truth = 40 * np.array([np.sin(k / 40), np.cos(k / 30) - 1])
                frame = scene.frame(truth, rng)
                start = perf_counter()
                track = tracker.track(frame)
                spent.append(perf_counter() - start)
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
                    "frames/s": round(1 / float(np.median(spent))),
                }
            )
    return pd.DataFrame(rows)


def constants() -> pd.DataFrame:
    """Every constant of the tracker at other values, one at a time."""
    rows = [{"constant": "all as they are", "value": np.nan} | _qualities()]
    for (module, name), values in CONSTANTS.items():
        usual = getattr(module, name)
        for value in values:
            try:
                setattr(module, name, value)
                rows.append({"constant": name.lstrip("_"), "value": value} | _qualities())
            finally:
                setattr(module, name, usual)
    return pd.DataFrame(rows)


def _qualities() -> dict[str, float]:
    """Return what a change of a constant could spoil, in short."""
    found: dict[str, float] = {}
    steps, false = [], 0
    for motion, warp in (
        ("translation", "shift"),
        ("affine", "affine"),
        ("homography", "homography"),
    ):
        hits = 0
        for seed in range(100):
            pair = frames_of(seed, 15.0, warp)
            track = ESMTracker(pair.first, pair.box, motion).track(pair.second)
            right = np.linalg.norm(track.corners - pair.corners, axis=1).max() < 1.0
            hits += bool(right and not track.lost)
            false += bool(not right and not track.lost)
            steps.append(track.iterations)
        found[f"{motion}, 15 px: success (%)"] = hits
    near = [(frames_of(seed, 3.0, "shift"), "translation") for seed in range(50)]
    near += [(frames_of(seed, 3.0, "homography"), "homography") for seed in range(50)]
    errors = []
    for pair, motion in near:
        track = ESMTracker(pair.first, pair.box, motion).track(pair.second)
        errors.append(np.mean((track.corners - pair.corners) ** 2 * 2))
    for seed in range(50):  # the template is not there
        pair, other = frames_of(seed, 15.0, "shift"), frames_of(seed + 50, 15.0, "shift")
        false += not ESMTracker(pair.first, pair.box, "homography").track(other.second).lost
    paths = [moving_square(500.0, seed) for seed in range(10)]
    found |= {
        "3 px: RMS corner error (px)": round(float(np.sqrt(np.mean(errors))), 4),
        "steps": round(float(np.mean(steps)), 1),
        "wrong, not called lost (of 350)": false,
        "square at 500 px/s: runs completed (%)": 10
        * sum(followed(*path, "homography") < 1.0 for path in paths),
        "jump along the jaws: found (%)": _jumps(),
    }
    return found


def _jumps() -> float:
    """Return how often the gripper, alike along its jaws, is found after a jump, in percent."""
    found, count = 0, 30
    rng = np.random.default_rng(10)
    scene = gripper_scene(rng, pixel_size=1.55)
    still = scene.frame((0, 0), rng)
    for angle in rng.uniform(0, 2 * np.pi, count):
        tracker = ESMTracker(still, scene.box(90), "translation")
        middle = tracker.track(scene.frame((0, 0), rng)).center
        jump = np.array([25 * np.cos(angle), 5 * np.sin(angle)])
        track = tracker.track(scene.frame(jump, rng))
        found += not track.lost and np.linalg.norm(track.center - middle - jump) < 1.0
    return round(100 * found / count)


def limits(tables: dict[str, pd.DataFrame]) -> pd.DataFrame:
    cells = tables["Convergence"].set_index(
        ["motion", "warp", "corner displacement (px)", "method"]
    )
    basins = tables["Basins"].set_index(["motion", "method"])["basin (px)"]
    frame, runs = tables["Time of one frame"].set_index("motion"), tables["Sequences"]
    drift = tables["Drift over 1,000 frames of the gripper"]

    def success(motion: str, warp: str, distance: float, method: str = "ESM") -> tuple:
        what = f"{motion}, corners moved {distance:g} px, {method}: success, %"
        return what, cells.loc[(motion, warp, distance, method), "success (%)"]

    def completed(speed: float) -> tuple:
        chosen = runs.loc[runs["speed (px/s)"] == speed, "runs completed (%)"]
        return f"sequences at {speed:g} px/s: runs completed, least of scenes, %", chosen.min()

    def basin(motion: str) -> tuple:
        peer = max(basins[motion, "ECC, filter 1"], basins[motion, "ECC, filter 5"])
        return f"{motion}: reach over that of ECC, gradients only", (
            basins[motion, "ESM, gradients only"] / peer
        )

    near = cells.loc[("translation", "shift", 3.0, "ESM"), "RMS corner error (px)"]
    one = ("affine", "affine", 5.0, "ESM, one resolution")
    return must_hold(
        [
            (*success("translation", "shift", 7.6), "≥", 99),
            (*success("translation", "shift", 15.0), "≥", 98),
            (*success("translation", "shift", 20.0), "≥", 90),
            ("translation by 3 px: RMS corner error, px", near, "≤", 0.015),
            (*success("affine", "affine", 7.6, "ESM, one resolution"), "≥", 97),
            ("affine, corners moved 5 px, one resolution: steps", cells.loc[one, "steps"], "≤", 5),
            (*success("homography", "homography", 7.6), "≥", 98),
            (*success("homography", "homography", 15.0), "≥", 90),
            *((*basin(motion), "≥", 1.5) for motion in MODES),
            ("translation: time over ECC's", frame.loc["translation", "ESM / ECC"].max(), "≤", 5),
            ("affine: time over ECC's", frame.loc["affine", "ESM / ECC"].max(), "≤", 3),
            ("frames/s, slowest motion", frame["ESM frames/s"].min(), "≥", 330),
            (*completed(250.0), "≥", 100),
            (*completed(500.0), "≥", 90),
            ("drift at the end of 1,000 frames, px", drift["end error (px)"].max(), "≤", 0.2),
        ]
    )


NOTE = """\
Templates are 50×50 px of white noise, blurred by σ = 1 px; the camera's noise is 2 grey levels,
and the gain changes by 5 %. A trial moves the corners by exactly the displacement named (root mean
square), either by a shift in a random direction or each corner on its own. It succeeds if all four
corners are found to within 1 px.

- *ESM, gradients only* omits the search by correlation and the distorted starts; *one resolution*
  does so as well, and smooths by σ = 3 px.
- A *basin* is the largest shift at which 38 of 40 trials succeed, sought up to 30 px.
- *Times* are those of one frame within a sequence.
- *Constants* have the names of the source, where each is explained. *Wrong* is a result that is
  more than 1 px off and not called lost.
"""


def main() -> None:
    cv2.setNumThreads(1)
    tables = {
        "Convergence": convergence(),
        "Basins": basins(),
        "Time of one frame": times(),
        "Sequences": sequences(),
        "Drift over 1,000 frames of the gripper": drift(),
        "Constants": constants(),
    }
    publish(
        "tracking",
        tables,
        limits=limits(tables),
        note=NOTE,
    )


if __name__ == "__main__":
    main()
