"""Section 5.3: a gripper to track, and how fast a feature may move."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from compendium import thesis
from microlib.synthetic import gripper_scene, mixed_texture
from microlib.tracking import ESMTracker, KalmanFilter, Track

#: At 4X the opening is wider than the window of 50 px, so the tracker gets a larger one, px.
WINDOWS = {"1X": thesis.WINDOW, "4X": 90}
#: Given where the gripper is in the image (px) and a source of noise, a frame.
Frame = Callable[[ArrayLike, np.random.Generator], NDArray[np.uint8]]


def texture_sequence(
    positions: ArrayLike,
    rng: np.random.Generator,
    *,
    size: int = 50,
    noise: float = 2.0,
    grain: float = 1.0,
) -> list[NDArray[np.uint8]]:
    """Return frames of a textured square that moves over another texture of the same fineness.

    Parameters
    ----------
    positions : array_like, shape (N, 2)
        (x, y) of the first pixel of the square in each frame, px; they set the size of the frames.
    rng : numpy.random.Generator
        Source of both textures and the noise.
    size : int, optional
        Width and height of the square, px.
    noise : float, optional
        Standard deviation of the noise of the camera, grey levels.
    grain : float, optional
        Standard deviation of the Gaussian that smooths white noise to a texture, px.

    Returns
    -------
    list of ndarray of uint8
        One frame a position, all of one size.

    Notes
    -----
    The square is moved by splines of the fifth order, which are wrong by 0.4 grey levels (root mean
    square) on a texture with a grain of 1 px; cubic splines by 0.8 and linear ones by 4.5.

    Examples
    --------
    >>> frames = texture_sequence([[5.0, 5.0], [7.5, 5.0]], np.random.default_rng(0), size=20)
    >>> [frame.shape for frame in frames]
    [(45, 48), (45, 48)]
    """
    positions = np.asarray(positions)
    width, height = (np.ceil(positions.max(axis=0)) + 2 * size).astype(int)
    ground = mixed_texture((height, width), rng, std=45.0, scales=grain)
    square = mixed_texture((size, size), rng, std=45.0, scales=grain)
    margin = 8  # what the spline assumes beyond decays by 0.43 a sample
    spline = ndimage.spline_filter(np.pad(square, margin, mode="wrap"), order=5)
    frames = []
    for x, y in positions:
        image = ground.copy()
        column, row = int(np.floor(x)), int(np.floor(y))
        columns, rows = np.arange(size + 1) + column - x, np.arange(size + 1) + row - y
        grid = np.meshgrid(rows + margin, columns + margin, indexing="ij")
        moved = ndimage.map_coordinates(spline, grid, order=5, prefilter=False)
        # The share of each unit pixel that lies on the square, along both axes.
        share = (np.clip(np.minimum(n + 1, size - n), 0, 1) for n in (rows, columns))
        part = image[row : row + size + 1, column : column + size + 1]
        part += np.outer(*share) * (moved - part)
        noisy = image + noise * rng.standard_normal(image.shape, np.float32)
        frames.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    return frames


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


def esm_shift(
    first: ArrayLike, then: ArrayLike, box: tuple[int, int, int, int], iterations: int = 50
) -> NDArray[np.float64]:
    """Return by how much (x, y) ESM alone finds a template shifted in another frame, px.

    The only unknown is a translation, and the search starts from the place in the first frame.
    There is no smoothing, no model of the light, no second start and no filter. A step is the
    least-squares solution with the mean of the gradients of the template and of the shifted frame,
    as in chapter 2.

    Parameters
    ----------
    first, then : array_like, shape (rows, cols)
        Frame with the template, and the frame in which it is sought, grey levels.
    box : tuple of int
        (x, y, width, height) of the template, px.
    iterations : int
        Largest number of steps. The search ends before at a step below 1e-4 px.

    Examples
    --------
    >>> import numpy as np
    >>> from compendium.experiments.section_5_3 import esm_shift
    >>> y, x = np.mgrid[:40, :40] / 6.0
    >>> frames = [np.sin(x - off / 6) + np.cos(y - off / 12) for off in (0.0, 2.0)]
    >>> esm_shift(*frames, (8, 8, 24, 24)).round(2).tolist()
    [2.0, 1.0]
    """
    x, y, width, height = box
    rows, columns = np.mgrid[y : y + height, x : x + width]
    template = np.asarray(first, dtype=float)[rows, columns]
    spline = ndimage.spline_filter(np.asarray(then, dtype=float), mode="nearest")
    shift = np.zeros(2)
    for _ in range(iterations):
        place = [rows + shift[1], columns + shift[0]]
        seen = ndimage.map_coordinates(spline, place, mode="nearest", prefilter=False)
        slopes = (np.array(np.gradient(template)) + np.array(np.gradient(seen)))[::-1] / 2
        step = np.linalg.lstsq(slopes.reshape(2, -1).T, (template - seen).ravel())[0]
        shift += step
        if np.hypot(*step) < 1e-4:
            break
    return shift


def esm_study(seed: int, steps: ArrayLike, grains: ArrayLike, trials: int) -> pd.DataFrame:
    """Count how often ESM alone follows a textured square from one frame to the next.

    Parameters
    ----------
    seed : int
        Of the scenes.
    steps : array_like
        Motions from the first frame to the second, px. Their direction is random.
    grains : array_like
        Of the textures of square and ground, px, see `texture_sequence`.
    trials : int
        Scenes for each step and grain.

    Returns
    -------
    pandas.DataFrame
        Trials in which `esm_shift` errs by less than a pixel: a row each step, a column each grain.
    """
    lengths, widths = np.asarray(steps, dtype=float), np.asarray(grains, dtype=float)
    table = pd.DataFrame(0, pd.Index(lengths, name="step (px)"), pd.Index(widths))
    side = thesis.WINDOW
    corner = int(np.ceil(lengths.max())) + 2  # of the square; it stays inside the frame
    for n, (step, grain) in enumerate(itertools.product(lengths, widths)):
        for trial in range(trials):
            rng = np.random.default_rng([seed, n, trial])
            angle = rng.uniform(0, 2 * np.pi)
            motion = step * np.array([np.cos(angle), np.sin(angle)])
            path = [[corner] * 2, corner + motion]
            first, then = texture_sequence(path, rng, size=side, grain=grain)
            found = esm_shift(first, then, (corner, corner, side, side))
            table.loc[step, grain] += np.linalg.norm(found - motion) < 1.0
    return table


def speed_study(seed: int, speeds: ArrayLike, runs: int) -> pd.Series:
    """Count the runs in which the tracker of the library follows a square around a circle.

    Parameters
    ----------
    seed : int
        Of the scenes.
    speeds : array_like
        Along the circle, px/s.
    runs : int
        Of 25 frames, at each speed, each with a scene of its own.

    Returns
    -------
    pandas.Series
        Runs without a loss, see `largest_error`, by speed.
    """
    counts = {
        speed: sum(np.isfinite(largest_error(speed, [seed, k])) for k in range(runs))
        for speed in np.asarray(speeds, dtype=float)
    }
    return pd.Series(counts, name="runs completed").rename_axis("speed (px/s)")


def largest_error(speed: float, seed: int | list[int]) -> float:
    """Return how far off a run of 25 frames is at most.

    Parameters
    ----------
    speed : float
        px/s, along a circle of 80 px radius. The first step comes without warning.
    seed : int or list of int
        Of the scene and of where on the circle the run begins.

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
    tracker = ESMTracker(frames[0], (int(x), int(y), side, side), "translation", kalman=kalman)
    largest = 0.0
    for frame, position in zip(frames[1:], path[1:], strict=True):
        track = tracker.track(frame)
        off = float(np.linalg.norm(track.center - start - position + path[0]))
        if track.lost or not off <= 1.0:
            return np.inf
        largest = max(largest, off)
    return largest
