"""Short films that loop: a picture that moves, beside the still of it that is printed.

A film is a WebP inside the page, so that a page opened from a file shows it. Readers who asked for
less motion, and those on paper, get the still; the book adds a button that stops the film.
"""

from __future__ import annotations

import base64
from collections.abc import Callable
from html import escape
from io import BytesIO
from itertools import pairwise

import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from PIL import Image

from compendium.experiments.chapter_2_tracking import Target, corners, warped
from compendium.figures.style import COLORS
from microlib.membrane import dimple_profile

__all__ = ["MOST_BYTES", "film", "film_alignment", "film_dimple", "film_focus", "film_step"]

#: What one film may weigh.
MOST_BYTES = 400_000
#: Resolution, px per inch: 720 px across at the width of the page.
_DPI = 100


def film(
    figure: Figure,
    draw: Callable[[int], None],
    durations: list[int],
    *,
    still: int,
    name: str,
    alt: str,
    caption: str,
) -> HTML:
    """
    Return a looping film of a figure, with one of its pictures as the still.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Drawn once for each picture.
    draw : callable
        Brings the figure to the picture of this number, from 0.
    durations : list of int
        How long each picture stands, ms.
    still : int
        Number of the picture that stands for the film.
    name : str
        Identifier of the HTML element, unique on its page.
    alt, caption : str
        What the film shows, for those who do not see it, and what stands below; the caption is
        HTML.

    Returns
    -------
    IPython.display.HTML
        A ``figure`` of the class ``film``.

    Raises
    ------
    ValueError
        If the film is heavier than `MOST_BYTES`.
    """
    canvas = FigureCanvasAgg(figure)
    pictures = []
    for k in range(len(durations)):
        draw(k)
        canvas.draw()
        # The axes stay where the first picture has them.
        figure.set_layout_engine("none")
        pictures.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))
    moving = _webp(
        pictures[0],
        save_all=True,
        append_images=pictures[1:],
        duration=durations,
        loop=0,
        quality=45,
        method=4,
    )
    if len(moving) > MOST_BYTES:
        raise ValueError(f"the film {name} weighs {len(moving)} bytes, at most {MOST_BYTES}")
    resting = _webp(pictures[still], quality=80)
    width, height = pictures[0].size
    size = f'width="{width}" height="{height}" alt="{escape(alt)}"'
    return HTML(
        f'<figure class="film" id="{name}">'
        f'<img class="film-moving" {size} src="{_address(moving)}">'
        f'<img class="film-still" hidden {size} src="{_address(resting)}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def film_alignment(target: Target, warps: list[NDArray], **texts: str) -> HTML:
    """Show ESM converging: the window on the image, and what template and image differ by.

    Parameters
    ----------
    target : Target
        Template, image and true warp.
    warps : list of ndarray
        As `align` returns them.
    **texts : str
        ``name``, ``alt`` and ``caption`` of `film`.
    """
    figure = Figure(figsize=(7.2, 3.8), dpi=_DPI, layout="constrained")
    left, right = figure.subplots(1, 2)
    left.imshow(target.image, vmin=0, vmax=255)
    window = left.add_patch(Polygon(corners(warps[0]), fill=False, ec=COLORS["orange"], lw=3))
    left.set(xlabel="x (px)", ylabel="y (px)", title="image and window")
    difference = right.imshow(target.template, cmap="RdBu_r", vmin=-80, vmax=80)
    right.set(xlabel="x (px)", title="step 0: corners off by 00.00 px")
    for axes in (left, right):
        axes.grid(False)
    parts = 4  # pictures from one step to the next
    between = [
        warp + k / parts * (following - warp)
        for warp, following in pairwise(warps)
        for k in range(parts)
    ]
    between.append(warps[-1])
    true = corners(target.warp)

    def draw(k: int) -> None:
        window.set_xy(corners(between[k]))
        difference.set_data(warped(target.image, between[k]) - target.template)
        off = np.linalg.norm(corners(between[k]) - true, axis=1).mean()
        right.set_title(f"step {k // parts}: corners off by {off:.2f} px")

    durations = [900 if k % parts == 0 else 90 for k in range(len(between))]
    durations[-1] = 2500
    return film(figure, draw, durations, still=2 * parts, **texts)


def film_focus(frames: NDArray, positions: NDArray, depth: NDArray, **texts: str) -> HTML:
    """Show a focal stack from the ground up, and the heights that are known by then.

    Parameters
    ----------
    frames : ndarray, shape (F, H, W)
        The stack.
    positions : ndarray, shape (F,)
        Where each frame was taken, µm.
    depth : ndarray, shape (H, W)
        Heights from the whole stack, µm.
    **texts : str
        ``name``, ``alt`` and ``caption`` of `film`.
    """
    figure = Figure(figsize=(7.2, 3.5), dpi=_DPI, layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    frame = left.imshow(frames[0], vmin=0, vmax=255)
    known = right.imshow(depth, cmap="viridis", vmin=positions[0], vmax=positions[-1])
    right.set_facecolor("#D9D9D9")
    left.set(xlabel="x (px)", ylabel="y (px)")
    right.set(xlabel="x (px)", title="height found so far")
    for axes in (left, right):
        axes.grid(False)
    figure.colorbar(known, ax=right, label="height (µm)")
    half = np.diff(positions).mean() / 2

    def draw(k: int) -> None:
        frame.set_data(frames[k])
        left.set_title(f"frame at d = {positions[k]:.0f} µm")
        known.set_data(np.where(depth <= positions[k] + half, depth, np.nan))

    durations = [450] * len(frames)
    durations[-1] = 2000
    return film(figure, draw, durations, still=len(frames) // 2, **texts)


def film_dimple(
    depths: NDArray, forces: NDArray, *, radius: float, half_width: float, **texts: str
) -> HTML:
    """Show a probe that presses a dimple and is drawn back, and the force that this takes.

    Parameters
    ----------
    depths, forces : ndarray, shape (N,)
        w_d from 0, µm, and F, µN.
    radius, half_width : float
        a and c, µm; the dimple keeps its radius.
    **texts : str
        ``name``, ``alt`` and ``caption`` of `film`.
    """
    depth = float(depths[-1])
    figure = Figure(figsize=(7.2, 3.4), dpi=_DPI, layout="constrained")
    section, curve = figure.subplots(1, 2, width_ratios=(1.5, 1))
    r = np.linspace(half_width, radius, 200)
    both = np.r_[-r[::-1], r]
    (wall,) = section.plot(both, 0 * both, color=COLORS["blue"], lw=3)
    (probe,) = section.fill([0], [0], color=COLORS["grey"], alpha=0.6, lw=0)
    section.set(xlabel="distance from the axis r (µm)", ylabel="height (µm)", aspect="equal")
    section.set(ylim=(-1.2 * depth, 0.9 * depth))
    curve.plot(depths, forces, color=COLORS["grey"], lw=1.2)
    (now,) = curve.plot([0], [0], "o", color=COLORS["orange"], ms=10)
    curve.set(xlabel="depth $w_d$ (µm)", ylabel="force F (µN)")
    turns = 32
    push = (1 - np.cos(2 * np.pi * np.arange(turns) / turns)) / 2  # there and back

    def draw(k: int) -> None:
        w = push[k] * depth
        heights = -dimple_profile(r, radius, w, probe_half_width=half_width) if w else 0 * r
        wall.set_ydata(np.r_[heights[::-1], heights])
        edge = [-half_width, half_width]
        probe.set_xy(np.c_[[*edge, *edge[::-1]], [-w, -w, depth, depth]])
        force = float(np.interp(w, depths, forces))
        now.set_data([w], [force])
        section.set_title(f"pressed by {force:.0f} µN")

    return film(figure, draw, [100] * turns, still=turns // 2, **texts)


def film_step(
    frames: list[NDArray], times: NDArray, places: NDArray, goal: NDArray, side: float, **texts: str
) -> HTML:
    """Show the gripper driven to its goal in the image, and its step response.

    Parameters
    ----------
    frames : list of ndarray
        What the camera saw.
    times : ndarray, shape (K,)
        Of the frames, s.
    places : ndarray, shape (K, 2)
        The tracked feature in the frames, (x, y) in px.
    goal : ndarray, shape (2,)
        Where it shall go, px.
    side : float
        Of the tracked window, px.
    **texts : str
        ``name``, ``alt`` and ``caption`` of `film`.
    """
    figure = Figure(figsize=(7.2, 3.5), dpi=_DPI, layout="constrained")
    left, right = figure.subplots(1, 2)
    picture = left.imshow(frames[0], vmin=0, vmax=255)
    square = side / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    window = left.add_patch(Polygon(square, fill=False, ec=COLORS["yellow"], lw=2.5))
    left.plot(*goal, "+", color=COLORS["orange"], ms=16, mew=3)
    middle = (places[0] + goal) / 2
    left.set(xlim=middle[0] + np.array([-90, 90]), ylim=middle[1] + np.array([90, -90]))
    left.set(xlabel="x (px)", ylabel="y (px)")
    left.grid(False)
    moved = pd.DataFrame(places - places[0], columns=["x", "y"])
    looks = {"x": ("blue", "-"), "y": ("orange", "--")}
    lines = {
        axis: right.plot([], [], line, color=COLORS[color], label=axis)[0]
        for axis, (color, line) in looks.items()
    }
    right.axhline((goal - places[0])[0], color="black", lw=1, label="goal")
    right.set(xlabel="time (s)", ylabel="moved by (px)", xlim=(0, times[-1]))
    right.set(ylim=(-3, 1.15 * float(moved.to_numpy().max())))
    right.legend(loc="lower right")

    def draw(k: int) -> None:
        picture.set_data(frames[k])
        window.set_xy(square + places[k])
        for axis, line in lines.items():
            line.set_data(times[: k + 1], moved[axis][: k + 1])
        left.set_title(f"t = {times[k]:.2f} s")

    durations = [90] * len(frames)
    durations[-1] = 2000
    return film(figure, draw, durations, still=len(frames) // 2, **texts)


def _webp(picture: Image.Image, **how: object) -> bytes:
    buffer = BytesIO()
    picture.save(buffer, "WEBP", **how)
    return buffer.getvalue()


def _address(webp: bytes) -> str:
    return "data:image/webp;base64," + base64.b64encode(webp).decode("ascii")
