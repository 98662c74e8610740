"""Section 5.5: a parabolic ridge and a rough ball, their depth from focus and surface types."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import ndimage

from compendium import thesis
from microlib.curvature import hk_labels, surface_curvature
from microlib.focus import FocusResult, correct_spikes, depth_from_focus
from microlib.synthetic import focal_stack, mixed_texture, parabolic_cylinder, sphere_on_plane

# Assumed, because the thesis does not say.
RIDGE_SHAPE, RIDGE_WIDTH, RIDGE_NOISE = (200, 200), 100.0, 5.0  # px, px, grey levels
BALL_SHAPE, BALL_RADIUS = (180, 180), 375.0  # px, µm
BALL_ROUGHNESS, BALL_GRAIN, BALL_NOISE = 15.0, 3.0, 1.0  # µm, px, grey levels
#: At 1X, µm.
BALL_PIXEL = thesis.effective_pixel("1X")


@dataclass(frozen=True)
class Scene:
    """A rendered object and the truth behind it.

    Attributes
    ----------
    texture : ndarray, shape (rows, cols)
        Grey levels in focus.
    height : ndarray, shape (rows, cols)
        True height, µm.
    positions : ndarray, shape (n,)
        Height in focus in each frame, µm.
    frames : ndarray of uint8, shape (n, rows, cols)
        The focal stack.
    """

    texture: NDArray
    height: NDArray
    positions: NDArray
    frames: NDArray[np.uint8]


def render_ridge(seed: int) -> Scene:
    """Render the parabolic ridge by the thesis' recipe, with a little noise."""
    rng = np.random.default_rng(seed)
    texture = mixed_texture(RIDGE_SHAPE, rng)
    height = parabolic_cylinder(RIDGE_SHAPE, thesis.RIDGE_HEIGHT, width=RIDGE_WIDTH)
    positions = np.arange(0, thesis.RIDGE_HEIGHT + 1, thesis.RIDGE_STEP)
    clean = thesis.thesis_stack(texture, height, positions)
    noisy = clean + RIDGE_NOISE * rng.standard_normal(clean.shape)
    return Scene(texture, height, positions, np.clip(np.rint(noisy), 0, 255).astype(np.uint8))


def render_ball(seed: int) -> Scene:
    """Render a rough ball on paper, which a lens blurs by the distance."""
    rng = np.random.default_rng(seed)
    texture = mixed_texture(BALL_SHAPE, rng)
    height = sphere_on_plane(
        BALL_SHAPE, BALL_RADIUS, BALL_PIXEL, roughness=BALL_ROUGHNESS, grain=BALL_GRAIN, rng=rng
    )
    positions = np.arange(-1, 18) * thesis.BALL_STEP
    frames = focal_stack(
        texture, height, positions, blur_rate=1 / thesis.BALL_STEP, noise=BALL_NOISE, rng=rng
    )
    return Scene(texture, height, positions, frames)


def thesis_depth(frames: NDArray, positions: NDArray) -> tuple[NDArray, FocusResult]:
    """Return the depth by the thesis' chain, and as found before it is corrected.

    Parameters
    ----------
    frames : ndarray, shape (n, rows, cols)
        Focal stack.
    positions : ndarray, shape (n,)
        Height in focus in each frame, µm.

    Returns
    -------
    depth : ndarray, shape (rows, cols)
        SML over 5×5 px with the parabola (3.13), spikes corrected by (3.14), mean filter; µm.
    found : FocusResult
        Without the last two.
    """
    found = depth_from_focus(frames, positions, measure="sml", window=5)
    smooth = correct_spikes(found.depth, window=thesis.MEDIAN_WINDOW, delta=thesis.DELTA)
    return ndimage.uniform_filter(smooth, thesis.MEAN_WINDOW), found


def thesis_labels(depth: NDArray) -> NDArray[np.uint8]:
    """Return surface types as the thesis computes them: heights in µm on a grid of pixels."""
    found = surface_curvature(depth, 1.0)
    return hk_labels(found.mean, found.gaussian, thesis.H_THRESHOLD, thesis.K_THRESHOLD)


def inside_ridge() -> NDArray[np.bool_]:
    """Return the pixels of the ridge away from its feet and from the image's edges."""
    columns = np.abs(np.arange(RIDGE_SHAPE[1]) - (RIDGE_SHAPE[1] - 1) / 2) < RIDGE_WIDTH / 2 - 8
    inner = np.zeros(RIDGE_SHAPE, bool)
    inner[10:-10] = columns
    return inner


def ridge_errors(ridge: Scene, seed: int) -> pd.DataFrame:
    """Compare depths of the ridge, on frames by the thesis' recipe and as a lens would give them.

    Parameters
    ----------
    ridge : Scene
        From `render_ridge`.
    seed : int
        Of the noise on the lens' frames.

    Returns
    -------
    pandas.DataFrame
        RMS errors inside the ridge in µm: a row each kind of frames, a column each chain.
    """
    lens = focal_stack(
        ridge.texture,
        ridge.height,
        ridge.positions,
        blur_rate=1 / thesis.RIDGE_STEP,
        noise=2.0,
        rng=np.random.default_rng(seed),
    )
    inner = inside_ridge()

    def rms(depth: NDArray) -> float:
        return float(np.sqrt(np.nanmean((depth - ridge.height)[inner] ** 2)))

    errors = {}
    for name, frames in (("two levels of blur", ridge.frames), ("blur by distance", lens)):
        smooth, raw = thesis_depth(frames, ridge.positions)
        errors[name] = {
            "SML, (3.13)": rms(raw.depth),
            "and corrected, averaged": rms(smooth),
            "default": rms(depth_from_focus(frames, ridge.positions).depth),
        }
    return pd.DataFrame(errors).T


def steepest_step(ridge: Scene) -> float:
    """Return the largest rise of the ridge from pixel to pixel, in steps of the focus."""
    return float(np.abs(np.diff(ridge.height, axis=1)).max() / thesis.RIDGE_STEP)


def from_ball_center() -> NDArray:
    """Return the distance of each pixel from the ball's axis, in radii of the ball."""
    y, x = np.indices(BALL_SHAPE)
    rows, columns = BALL_SHAPE
    return np.hypot(x - (columns - 1) / 2, y - (rows - 1) / 2) * BALL_PIXEL / BALL_RADIUS


def share_of(labels: NDArray, where: NDArray[np.bool_], kinds: tuple[int, ...]) -> float:
    """Return the share of labels of some kinds among the pixels of a place.

    Examples
    --------
    >>> share_of(np.array([1, 2, 2, 5]), np.array([True, True, True, False]), (2, 8))
    0.6666666666666666
    """
    return float(np.isin(labels[where], kinds).mean())


def sentence_shares(seed: int, runs: int) -> pd.DataFrame:
    """Turn each sentence of the thesis about its label maps into a share of pixels.

    *Crest*, *sides* and *edge* are the places where the thesis' thresholds label the true ridge
    convex cylindric, planar and concave cylindric.

    Parameters
    ----------
    seed : int
        Of the first scenes; the next ones have the next seeds.
    runs : int
        Rendered scenes of each object.

    Returns
    -------
    pandas.DataFrame
        A row each run, a column each claim of section 5.5.
    """
    distance = from_ball_center()
    rows = []
    for run in range(seed, seed + runs):
        ridge, ball = render_ridge(run), render_ball(run)
        labels = thesis_labels(thesis_depth(ridge.frames, ridge.positions)[0])
        exact = thesis_labels(ridge.height)
        crest, sides, edge = exact == 2, (exact == 5) & (ridge.height > 0), exact == 8
        misread = crest & ~np.isin(labels, (2, 5))
        types = thesis_labels(thesis_depth(ball.frames, ball.positions)[0])
        top, paper = distance < 0.5, (distance > 1.25) & (types > 0)
        rows.append(
            {
                "sides-planar": share_of(labels, sides, (5,)),
                "crest-convex-cylindric": share_of(labels, crest, (2,)),
                "crest-saddle-and-elliptic": share_of(labels, crest, (1, 3)),
                "crest-convex": share_of(labels, misread, (1, 2, 3)),
                "edge-concave-cylindric": share_of(labels, edge, (8,)),
                "ball-top-cylindric": share_of(types, top, (2, 8)),
                "ball-hyperbolic": share_of(types, top, (3, 6, 9)),
                "ball-background-planar": share_of(types, paper, (5,)),
            }
        )
    return pd.DataFrame(rows)


def widest_ridge(*, printed_window: bool = False) -> float:
    """Return the width in px up to which the crest passes the threshold of H.

    At the crest z'' = −8 height / width² and H is half of it, or half of that with the window
    (3.19) as printed.
    """
    return float(np.sqrt((2 if printed_window else 4) * thesis.RIDGE_HEIGHT / thesis.H_THRESHOLD))


def ball_labels_by_window(ball: Scene, windows: tuple[int, ...]) -> dict[int, NDArray[np.uint8]]:
    """Label the ball with the pixel size in µm and a matching pair of thresholds.

    Parameters
    ----------
    ball : Scene
        From `render_ball`.
    windows : tuple of int
        Sides of the window of the derivatives, px.

    Returns
    -------
    dict of int to ndarray
        Labels by window. The thresholds are a third of the ball's curvature, and its square.
    """
    depth = depth_from_focus(ball.frames, ball.positions).depth
    threshold = 0.3 / BALL_RADIUS
    found = {size: surface_curvature(depth, BALL_PIXEL, size=size) for size in windows}
    return {
        size: hk_labels(each.mean, each.gaussian, threshold, threshold**2)
        for size, each in found.items()
    }
