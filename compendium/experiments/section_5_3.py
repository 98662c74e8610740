"""Section 5.3: a gripper to track, and how fast a feature may move."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from compendium import thesis
from microlib.synthetic import gripper_scene, texture_sequence
from microlib.tracking import ESMTracker, KalmanFilter, Track

#: At 4X the opening is wider than the window of 50 px, so the tracker gets a larger one, px.
WINDOWS = {"1X": thesis.WINDOW, "4X": 90}
#: Given where the gripper is in the image (px) and a source of noise, a frame.
Frame = Callable[[ArrayLike, np.random.Generator], NDArray[np.uint8]]


def gripper(
    zoom: str, away: tuple[float, float], rng: np.random.Generator, motion: str = "translation"
) -> tuple[Frame, ESMTracker]:
    """Render a microgripper and begin to track its opening.

    Parameters
    ----------
    zoom : str
        ``1X`` or ``4X``.
    away : tuple of float
        Where the opening is at first, (x, y) in px from the middle of the frame.
    rng : numpy.random.Generator
        Source of texture and noise.
    motion : str
        As for `ESMTracker`.

    Returns
    -------
    frame : callable
        Renders the gripper at another place.
    tracker : ESMTracker
        Started at `away`.
    """
    scene = gripper_scene(
        rng, pixel_size=thesis.effective_pixel(zoom), gap=thesis.GRIPPER_GAP, reach=110
    )
    box = scene.box(WINDOWS[zoom], away)
    return scene.frame, ESMTracker(scene.frame(away, rng), box, motion)


def gripper_tracks(seed: int) -> list[tuple[str, NDArray[np.uint8], Track]]:
    """Track the gripper over two frames at each zoom (figure 5.3): label, frame and track."""
    rng = np.random.default_rng(seed)
    shown = []
    for zoom in thesis.ZOOMS:
        render, tracker = gripper(zoom, (-15.0, 10.0), rng, "homography")
        for place in ((-15.0, 10.0), (8.3, -6.6)):
            frame = render(place, rng)
            label = f"{zoom}, at ({place[0]:g}, {place[1]:g}) px".replace("-", "−")
            shown.append((label, frame, tracker.track(frame)))
    return shown


def speed_study(seed: int, speeds: ArrayLike, runs: int) -> pd.DataFrame:
    """Follow a textured square around a circle, ever faster, over a ground textured as finely.

    Parameters
    ----------
    seed : int
        Of the scenes.
    speeds : array_like
        Along the circle, px/s.
    runs : int
        Of 25 frames, at each speed.

    Returns
    -------
    pandas.DataFrame
        Share of the runs without a loss, see `largest_error`, a row each speed: predicted by the
        Kalman filter, and looked for at the last place.
    """
    index = pd.Index(np.asarray(speeds, dtype=float), name="speed (px/s)")
    shares = {
        label: [
            np.mean([np.isfinite(largest_error(v, [seed, k], predict)) for k in range(runs)])
            for v in index
        ]
        for label, predict in {"with the Kalman filter": True, "from the last place": False}.items()
    }
    return pd.DataFrame(shares, index=index)


def fastest_followed(shares: pd.Series) -> float:
    """Return the speed up to which every run was followed, px/s; 0 if not even the slowest was.

    Parameters
    ----------
    shares : pandas.Series
        A column of `speed_study`, slowest first.

    Examples
    --------
    >>> import pandas as pd
    >>> from compendium.experiments.section_5_3 import fastest_followed
    >>> fastest_followed(pd.Series([1.0, 1.0, 0.9, 1.0], index=[100.0, 200.0, 300.0, 400.0]))
    200.0
    """
    every = np.logical_and.accumulate(shares.to_numpy() == 1.0)
    return float(max([0.0, *shares.index[every]]))


def largest_error(speed: float, seed: int | list[int], predict: bool) -> float:
    """Return how far off a run of 25 frames is at most.

    Parameters
    ----------
    speed : float
        px/s, along a circle of 80 px radius. The first step comes without warning.
    seed : int or list of int
        Of the scene and of where on the circle the run begins.
    predict : bool
        Whether a Kalman filter says where to look next.

    Returns
    -------
    float
        Largest distance of the tracked center from the true one, px; infinite if a frame is lost or
        off by more than a pixel.
    """
    rng = np.random.default_rng(seed)
    angle = speed * thesis.FRAME_INTERVAL / 80 * np.arange(25) + rng.uniform(0, 2 * np.pi)
    path = 115 + 80 * np.column_stack([np.cos(angle), np.sin(angle)])  # px
    frames = texture_sequence(path, rng)
    x, y = np.ceil(path[0]).astype(int)
    side = thesis.WINDOW - 1  # whole pixels inside the square
    start = np.array([x, y]) + (side - 1) / 2
    kalman = KalmanFilter(start, interval=thesis.FRAME_INTERVAL, acceleration=3000.0, noise=0.1)
    tracker = ESMTracker(
        frames[0], (int(x), int(y), side, side), "translation", kalman=kalman if predict else None
    )
    largest = 0.0
    for frame, position in zip(frames[1:], path[1:], strict=True):
        track = tracker.track(frame)
        off = float(np.linalg.norm(track.center - start - position + path[0]))
        if track.lost or not off <= 1.0:
            return np.inf
        largest = max(largest, off)
    return largest
