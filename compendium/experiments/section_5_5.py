"""Section 5.5: a parabolic ridge and a rough ball, their depth from focus and surface types."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import ndimage
from scipy.stats import t as student_t
from skimage.measure import label as connected

from compendium import thesis
from compendium.experiments.chapter_3 import PRINTED_WINDOWS
from compendium.experiments.rendering import expose
from compendium.ledger import Contradicts, claim
from microlib.curvature import hk_labels
from microlib.focus import (
    correct_spikes,
    depth_from_focus,
    sum_modified_laplacian,
    three_point_peak,
)
from microlib.synthetic import focal_stack, mixed_texture, parabolic_cylinder, sphere_on_plane

# Assumed, because the thesis does not say. Without noise (3.14) has nothing to correct.
RIDGE_SHAPE, RIDGE_WIDTH, RIDGE_NOISE = (200, 200), 100.0, 5.0  # px, px, grey levels
LABELED_WIDTH = 40.0  # px, at which all sentences on the surface types of the ridge hold
LABELED_ROUGHNESS = 45.0  # µm, at which those on the ball hold
BALL_SHAPE, BALL_RADIUS = (180, 180), 375.0  # px, µm
BALL_ROUGHNESS, BALL_GRAIN, BALL_NOISE = 15.0, 3.0, 1.0  # µm, px, grey levels
#: At 1X, µm.
BALL_PIXEL = thesis.effective_pixel("1X")
#: Side of the window of the focus measure, px: the larger of the two that the thesis names.
SML_WINDOW = int(claim("section-3.1.2/sml-window-large").value)
#: How far from a pixel the windows reach by which its label follows from the depth, px: half of the
#: mean, of the smoother (3.15) and of the derivatives (3.16).
REACH = thesis.MEAN_WINDOW // 2 + sum(
    int(claim(f"section-3.2.1/{kind}-window").value) // 2 for kind in ("smoothing", "derivative")
)
#: How far they reach altogether: with the focus measure and the median of (3.14), px.
FULL_REACH = REACH + SML_WINDOW // 2 + thesis.MEDIAN_WINDOW // 2

#: The two forms of the window (3.19), whose printed one gives half of the second derivative.
WINDOWS = ("printed", "corrected")

# What the sentences of section 5.5.2 mean as numbers; our choice.

#: Connected pixels that make a patch: a block of two by two, the smallest with an inside.
PATCH = 4
#: Share above which most pixels are of a type, and largest share that is still small.
MOST, SMALL = 0.5, 0.1


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


def render_ridge(seed: int, width: float = RIDGE_WIDTH, noise: float = RIDGE_NOISE) -> Scene:
    """Render the parabolic ridge by the thesis' recipe, `width` px wide, noise in grey levels."""
    rng = np.random.default_rng(seed)
    shape = RIDGE_SHAPE[0], max(RIDGE_SHAPE[1], int(width) + 60)
    texture = mixed_texture(shape, rng)
    height = parabolic_cylinder(shape, thesis.RIDGE_HEIGHT, width=width)
    positions = np.arange(0, thesis.RIDGE_HEIGHT + 1, thesis.RIDGE_STEP)
    clean = thesis.thesis_stack(texture, height, positions)
    return Scene(texture, height, positions, expose(clean, rng, noise))


def render_ball(seed: int, roughness: float = BALL_ROUGHNESS) -> Scene:
    """Render a ball on paper, rough by so many µm, which a lens blurs by the distance."""
    rng = np.random.default_rng(seed)
    texture = mixed_texture(BALL_SHAPE, rng)
    smooth = sphere_on_plane(BALL_SHAPE, BALL_RADIUS, BALL_PIXEL)
    relief = ndimage.gaussian_filter(rng.standard_normal(BALL_SHAPE), BALL_GRAIN)
    height = smooth + np.where(smooth > 0, roughness * relief / relief.std(), 0.0)
    positions = np.arange(-1, 18) * thesis.BALL_STEP
    frames = focal_stack(
        texture, height, positions, blur_rate=1 / thesis.BALL_STEP, noise=BALL_NOISE, rng=rng
    )
    return Scene(texture, height, positions, frames)


def thesis_depth(frames: NDArray, positions: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Return the depth by the thesis' method, the depth before it is corrected, and a sharp image.

    The method has no test whether a peak is significant, so each pixel has a depth.

    Parameters
    ----------
    frames : ndarray, shape (n, rows, cols)
        Focal stack.
    positions : ndarray, shape (n,)
        Height in focus in each frame, µm.

    Returns
    -------
    depth : ndarray, shape (rows, cols)
        SML over `SML_WINDOW` px with the parabola (3.13), spikes corrected by (3.14), mean
        filter; µm.
    found : ndarray, shape (rows, cols)
        Without the last two.
    fused : ndarray, shape (rows, cols)
        Each pixel of its sharpest frame.
    """
    measures = np.stack([sum_modified_laplacian(frame, window=SML_WINDOW) for frame in frames])
    best = measures.argmax(axis=0)
    middle = np.clip(best, 1, len(frames) - 2)
    around = np.take_along_axis(measures, middle + np.array([-1, 0, 1])[:, None, None], axis=0)
    # A peak in the first or last frame has no neighbors to fit.
    found = np.where(best == middle, three_point_peak(around, middle, positions), positions[best])
    smooth = correct_spikes(found, window=thesis.MEDIAN_WINDOW, delta=thesis.DELTA)
    fused = np.take_along_axis(frames, best[None], axis=0)[0]
    return ndimage.uniform_filter(smooth, thesis.MEAN_WINDOW), found, fused


def thesis_curvature(height: NDArray, *, corrected: bool = False) -> tuple[NDArray, NDArray]:
    """Return H and K as the thesis computes them, with the windows (3.15)–(3.19) as printed.

    Parameters
    ----------
    height : ndarray, shape (rows, cols)
        Heights, µm.
    corrected : bool
        Take 1/42 in (3.19) instead of the printed 1/84.

    Returns
    -------
    mean, gaussian : ndarray, shape (rows, cols)
        H and K on a grid of pixels, as if a pixel were 1 µm wide. NaN where a window leaves the
        map.
    """
    windows = {}
    for name, (_, integers) in PRINTED_WINDOWS.items():
        entry = claim(f"section-3.2.1/{name}")
        right = entry.corrected if isinstance(entry, Contradicts) else entry.printed
        windows[name] = np.array(integers) / float(right if corrected else entry.printed)

    def correlate(image: NDArray, along_y: str, along_x: str) -> NDArray:
        half = ndimage.correlate1d(image, windows[along_y], axis=0)
        return ndimage.correlate1d(half, windows[along_x], axis=1)

    smooth = correlate(height, "s", "s")
    zx, zy = correlate(smooth, "d0", "d1"), correlate(smooth, "d1", "d0")
    zxx, zyy = correlate(smooth, "d0", "d2"), correlate(smooth, "d2", "d0")
    zxy = correlate(smooth, "d1", "d1")
    steep = 1 + zx**2 + zy**2
    mean = ((1 + zx**2) * zyy - 2 * zx * zy * zxy + (1 + zy**2) * zxx) / (2 * steep**1.5)
    gaussian = (zxx * zyy - zxy**2) / steep**2
    inner = np.zeros(height.shape, bool)
    inner[6:-6, 6:-6] = True
    return np.where(inner, mean, np.nan), np.where(inner, gaussian, np.nan)


def thesis_labels(height: NDArray, *, corrected: bool = False) -> NDArray[np.uint8]:
    """Return surface types with the thesis' thresholds, from `thesis_curvature`."""
    mean, gaussian = thesis_curvature(height, corrected=corrected)
    return hk_labels(mean, gaussian, thesis.H_THRESHOLD, thesis.K_THRESHOLD)


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
        RMS errors inside the ridge in µm: a row each kind of frames, a column each chain; and the
        share of pixels to which the default gives a depth.
    """
    rng, rate = np.random.default_rng(seed), 1 / thesis.RIDGE_STEP
    scene = (ridge.texture, ridge.height, ridge.positions)
    lens = focal_stack(*scene, blur_rate=rate, noise=2.0, rng=rng)
    inner = inside_ridge()

    def rms(depth: NDArray) -> float:
        return float(np.sqrt(np.nanmean((depth - ridge.height)[inner] ** 2)))

    errors = {}
    for name, frames in (("two levels of blur", ridge.frames), ("blur by distance", lens)):
        smooth, raw, _ = thesis_depth(frames, ridge.positions)
        default = depth_from_focus(frames, ridge.positions).depth
        errors[name] = {
            "thesis, before correction": rms(raw),
            "thesis, corrected and averaged": rms(smooth),
            "default method": rms(default),
            "pixels with a default depth (%)": 100 * float(np.isfinite(default[inner]).mean()),
        }
    return pd.DataFrame(errors).T


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


def count_patches(labels: NDArray, where: NDArray[np.bool_], kinds: tuple[int, ...]) -> int:
    """Return how many connected patches of some kinds there are, of `PATCH` pixels or more.

    Examples
    --------
    >>> count_patches(np.array([[3, 3, 1], [3, 3, 1]]), np.ones((2, 3), bool), (3,))
    1
    """
    regions = connected(np.isin(labels, kinds) & where, connectivity=1)
    return int((np.bincount(regions.ravel())[1:] >= PATCH).sum())


def ridge_sentences(
    height: NDArray, labels: NDArray[np.uint8], *, corrected: bool = False
) -> dict[str, float]:
    """Turn each sentence about the label map of the ridge into a number.

    The places are those of the true shape. *Near the maximum* is where the label of the true shape
    is convex cylindric; the *sides* are the rest of the ridge, the *edge* is the line of its foot.

    Parameters
    ----------
    height : ndarray, shape (rows, cols)
        True height, µm; one profile all along the ridge.
    labels : ndarray, shape (rows, cols)
        Surface types; 0 where unknown.
    corrected : bool
        Label the true shape with the corrected window (3.19) instead of the printed one.

    Returns
    -------
    dict of str to float
        By claim of section 5.5.
    """
    known, on = labels > 0, height > 0
    convex = thesis_labels(height, corrected=corrected) == 2
    feet = np.flatnonzero(np.diff(on[0])) + np.array([0, 1])  # the ground's last and first pixel
    near = [known[:, foot - REACH : foot + REACH + 1] for foot in feet]
    lines = [(labels[:, foot - REACH : foot + REACH + 1] == 8).any(axis=1) for foot in feet]
    rows = near[0].all(axis=1)
    patches = min(count_patches(labels, on, (kind,)) for kind in (1, 3))
    few = share_of(labels, on & known, (1, 3)) <= SMALL
    return {
        "sides-planar": share_of(labels, on & ~convex & known, (5,)),
        # On a wide ridge there is no such place.
        "crest-convex-cylindric": share_of(labels, convex & known, (2,)) if convex.any() else 0.0,
        "crest-saddle-and-elliptic": float(patches if few else 0),
        "edge-concave-cylindric": float(np.mean([line[rows] for line in lines])),
    }


def edge_by_ground(*, corrected: bool = False) -> float:
    """Return the share of `ridge_sentences` at the feet of a true ridge, less that of a parabola
    that goes on below the ground, which has no concave point."""
    column = np.arange(RIDGE_SHAPE[1]) - (RIDGE_SHAPE[1] - 1) / 2
    profile = thesis.RIDGE_HEIGHT * (1 - (2 * column / LABELED_WIDTH) ** 2)
    parabola = np.broadcast_to(profile, RIDGE_SHAPE)
    shares = [
        ridge_sentences(height, thesis_labels(height, corrected=corrected))[
            "edge-concave-cylindric"
        ]
        for height in (np.maximum(parabola, 0.0), parabola)
    ]
    return shares[0] - shares[1]


def ridge_map(
    seed: int, widths: tuple[float, ...], noises: tuple[float, ...], runs: int
) -> pd.DataFrame:
    """Judge the sentences on the ridge, and the causes that the thesis names, in many scenes.

    Parameters
    ----------
    seed : int
        Of the first scene of each width and noise; the next ones have the next seeds.
    widths : tuple of float
        Widths of the ridge, px.
    noises : tuple of float
        Standard deviations of the noise, grey levels.
    runs : int
        Scenes of each width and noise.

    Returns
    -------
    pandas.DataFrame
        Two rows each scene, by the ``window`` (3.19), ``printed`` or ``corrected``: its ``width``,
        its ``noise``, the `ridge_sentences`, whether ``all`` of them hold;
        how many pixels are saddle ridges or convex elliptic by the ``true shape``, with the depth
        from focus with ``spikes`` and ``corrected`` by (3.14); and the RMS error on the ridge of
        the ``best frame`` and of the Gaussian ``fit`` (3.13), µm.
    """
    rows = []
    for width, noise, run in itertools.product(widths, noises, range(seed, seed + runs)):
        ridge = render_ridge(run, width, noise)
        depth, found, _ = thesis_depth(ridge.frames, ridge.positions)
        on = ridge.height > 0
        # The vertex of (3.13) is nearest to the best frame.
        frame = thesis.RIDGE_STEP * np.rint(found / thesis.RIDGE_STEP)
        maps = {
            "true shape": ridge.height,
            "spikes": ndimage.uniform_filter(found, thesis.MEAN_WINDOW),
            "corrected": depth,
        }
        errors = {"best frame": frame, "fit": found}
        rms = {name: np.sqrt(np.mean((z - ridge.height)[on] ** 2)) for name, z in errors.items()}
        for window in WINDOWS:
            right = window == "corrected"
            types = {name: thesis_labels(each, corrected=right) for name, each in maps.items()}
            sentences = ridge_sentences(ridge.height, types["corrected"], corrected=right)
            planar, cylindric, patches, edge = sentences.values()
            hold = min(planar, edge) > 1 - SMALL and cylindric > MOST and patches >= 1
            patchy = {name: int(np.isin(each[on], (1, 3)).sum()) for name, each in types.items()}
            scene = {"width": width, "noise": noise, "window": window}
            rows.append(scene | sentences | {"all": hold} | patchy | rms)
    return pd.DataFrame(rows)


def ball_sentences(labels: NDArray[np.uint8]) -> dict[str, float]:
    """Turn each sentence about the label map of the ball into a number, by claim of section 5.5.

    *On top* is within half of the radius from the axis, where the ball rises by less than 30°; the
    *background* is what no window that reaches the ball takes part in.
    """
    distance = from_ball_center()
    top = distance < 0.5
    paper = (distance > 1 + FULL_REACH * BALL_PIXEL / BALL_RADIUS) & (labels > 0)
    elliptic, cylindric, hyperbolic = (
        share_of(labels, top, kinds) for kinds in ((1, 7), (2, 8), (3, 6, 9))
    )
    patches = count_patches(labels, top, (3, 6, 9))
    return {
        "ball-top-cylindric": cylindric,
        "ball-hyperbolic": float(patches if elliptic < hyperbolic < cylindric else 0),
        "ball-background-planar": share_of(labels, paper, (5,)),
    }


def ball_shape(depth: NDArray) -> dict[str, float]:
    """Compare outlines of the ball, cut at several heights, with those of a cylinder and a sphere.

    Parameters
    ----------
    depth : ndarray, shape (rows, cols)
        Height from focus, µm.

    Returns
    -------
    dict of str to float
        By claim of section 5.5: how far the lower part lies from a cylinder, and the top from a
        sphere, in the distance of the two from each other.
    """
    steps = np.array([0.25, 0.5, 0.75])
    departures = {}
    for name, levels in (("ball-lower-cylindric", steps), ("ball-top-spherical", 1 + steps)):
        areas = [(depth > level * BALL_RADIUS).sum() for level in levels]
        radii = np.sqrt(np.array(areas) / np.pi) * BALL_PIXEL / BALL_RADIUS
        sphere, cylinder = np.sqrt(1 - (levels - 1) ** 2), np.ones(3)
        shape = cylinder if "cylindric" in name else sphere
        departures[name] = float(np.abs(radii - shape).sum() / (cylinder - sphere).sum())
    return departures


def roughness(depth: NDArray) -> float:
    """Return the standard deviation (µm) of a map from the smooth ball, on top as there."""
    smooth = sphere_on_plane(BALL_SHAPE, BALL_RADIUS, BALL_PIXEL)
    return float((depth - smooth)[from_ball_center() < 0.5].std())


def mean_interval(values: pd.Series) -> tuple[float, float, float]:
    """Return the mean over scenes and the ends of its 95 % interval by Student's t.

    Examples
    --------
    >>> tuple(round(end, 2) for end in mean_interval(pd.Series([1.0, 2.0, 3.0])))
    (2.0, -0.48, 4.48)
    """
    half = student_t.ppf(0.975, len(values) - 1) * values.sem()
    return float(values.mean()), float(values.mean() - half), float(values.mean() + half)


def describe_scenes(seed: int, runs: int) -> dict[str, pd.DataFrame]:
    """Turn each sentence of the thesis about its objects into a number, on several scenes.

    Parameters
    ----------
    seed : int
        Of the first scenes; the next ones have the next seeds.
    runs : int
        Rendered scenes of each object.

    Returns
    -------
    dict of str to pandas.DataFrame
        A row each run, a column each claim of section 5.5: of both objects with the window (3.19)
        as *printed* and *corrected*, and of a ``smooth-printed`` and a ``smooth-corrected`` ball.
    """
    rows: dict[str, list[dict[str, float]]] = {
        kind + window: [] for kind in ("", "smooth-") for window in WINDOWS
    }
    for run in range(seed, seed + runs):
        ridge, ball = render_ridge(run, LABELED_WIDTH), render_ball(run, LABELED_ROUGHNESS)
        smooth = render_ball(run, roughness=0.0)
        depths = [thesis_depth(each.frames, each.positions)[0] for each in (ridge, ball, smooth)]
        for window in WINDOWS:
            right = window == "corrected"
            types = [thesis_labels(depth, corrected=right) for depth in depths]
            found = ridge_sentences(ridge.height, types[0], corrected=right)
            rows[window].append(found | ball_sentences(types[1]))
            rows["smooth-" + window].append(ball_sentences(types[2]))
        rows["printed"][-1] |= ball_shape(depths[1])
        rows["printed"][-1]["not-smooth"] = roughness(depths[1]) / roughness(depths[2])
    return {scenes: pd.DataFrame(found) for scenes, found in rows.items()}


def cylindric_tops(*, corrected: bool) -> list[int]:
    """Return the whole radii (px) of balls whose top gets the label of a cylinder."""
    balls = {radius: sphere_on_plane((131, 131), float(radius), 1.0) for radius in range(2, 41)}
    return [r for r, ball in balls.items() if thesis_labels(ball, corrected=corrected)[65, 65] == 2]


def with_corrected_window(
    mapped: pd.DataFrame, scenes: dict[str, pd.DataFrame]
) -> dict[str, float]:
    """Return what the book states of the corrected window, from `ridge_map` and `describe_scenes`.

    The *crest* is of the ridges of `LABELED_WIDTH` without noise and with `RIDGE_NOISE`.
    """
    found: dict[str, float] = {}
    usual = mapped[mapped["noise"].isin([0.0, RIDGE_NOISE])]
    for window in WINDOWS:
        crest = usual[(usual["window"] == window) & (usual["width"] == LABELED_WIDTH)]
        found[f"crest-least-{window}"] = crest["crest-convex-cylindric"].min()
        found[f"crest-most-{window}"] = crest["crest-convex-cylindric"].max()
        sides = mapped.loc[mapped["window"] == window].query("noise <= @RIDGE_NOISE")
        found[f"sides-least-{window}"] = sides["sides-planar"].min()
        cylinders = cylindric_tops(corrected=window == "corrected")
        found |= {f"ball-first-{window}": cylinders[0], f"ball-last-{window}": cylinders[-1]}
    wider = usual[(usual["window"] == "corrected") & (usual["width"] == 60)]
    found["all-corrected-60"] = int(wider["all"].sum())
    smooth, rough = (
        scenes[kind]["ball-top-cylindric"] for kind in ("smooth-corrected", "corrected")
    )
    found["ball-roughness-corrected"] = smooth.mean() / rough.mean()
    return found
