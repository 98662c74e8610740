"""Short films that loop: a picture that moves, beside the still of it that is printed.

A film is a WebP inside the page, so that a page opened from a file shows it. Readers who asked for
less motion, and those on paper, get the still; the book adds a button that stops the film.
"""

from __future__ import annotations

import base64
from collections.abc import Callable
from html import escape
from io import BytesIO
from typing import Any

import numpy as np
from IPython.display import HTML
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.text import Text
from numpy.typing import NDArray
from PIL import Image
from scipy.interpolate import interp1d

from compendium.experiments.chapter_2_tracking import Target, corners, warped
from compendium.figures.panels import letter, photograph
from compendium.figures.style import COLORS
from microlib.membrane import dimple_profile

#: What one film may weigh.
MOST_BYTES = 400_000
#: Text and axes of a film: its contrast is 4:1 or more on a light and on a dark page.
ON_BOTH = "#7A7A7A"


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
    for axes in figure.axes:
        axes.tick_params(colors=ON_BOTH)
        axes.spines[:].set_color(ON_BOTH)
    for text in figure.findobj(Text):
        text.set_color(ON_BOTH)
    canvas = FigureCanvasAgg(figure)
    pictures = []
    for k in range(len(durations)):
        draw(k)
        canvas.draw()
        # The axes stay where the first picture has them.
        figure.set_layout_engine("none")
        pictures.append(Image.fromarray(np.array(canvas.buffer_rgba())))
    loop: dict[str, Any] = {"append_images": pictures[1:], "duration": durations, "loop": 0}
    moving = _webp(pictures[0], save_all=True, quality=45, method=4, **loop)
    if len(moving) > 4 / 3 * MOST_BYTES:
        raise ValueError(f"the film {name} is heavier than {MOST_BYTES} bytes")
    width, height = pictures[0].size
    size = f'width="{width}" height="{height}" alt="{escape(alt)}"'
    return HTML(
        f'<figure class="film" id="{name}">'
        f'<img class="film-moving" {size} src="{moving}">'
        f'<img class="film-still" hidden {size} src="{_webp(pictures[still], quality=80)}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _two_panels(height: float, **how: Any) -> tuple[Figure, Any, Any]:
    """Return a figure nearly as wide as the page, of 640 px, with two panels, and the panels."""
    figure = Figure((6.4, height), dpi=100, facecolor="none", layout="constrained")
    return figure, *figure.subplots(1, 2, **how)


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
    figure, left, right = _two_panels(3.8)
    photograph(left, target.image, "image and window")
    window = left.add_patch(Polygon(corners(warps[0]), fill=False, ec=COLORS["orange"], lw=3))
    title = "step 0, error 00.00 px"
    difference = photograph(right, target.template, title, cmap="RdBu_r", vmin=-80, vmax=80)
    letter((left, right))
    parts = 4  # pictures from one step to the next
    steps = np.arange(parts * (len(warps) - 1) + 1) / parts
    flat = np.reshape(warps, (len(warps), 9))
    between = interp1d(np.arange(len(warps)), flat, axis=0)(steps).reshape(-1, 3, 3)
    true = corners(target.warp)

    def draw(k: int) -> None:
        window.set_xy(corners(between[k]))
        difference.set_data(warped(target.image, between[k]) - target.template)
        off = np.linalg.norm(corners(between[k]) - true, axis=1).mean()
        right.set_title(f"(b) step {k // parts}, error {off:.2f} px", loc="left")

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
    figure, left, right = _two_panels(3.5, sharey=True)
    frame = photograph(left, frames[0])
    heights = {"cmap": "viridis", "vmin": positions[0], "vmax": positions[-1]}
    known = photograph(right, depth, "height found so far", **heights)
    letter((left, right))
    right.set(facecolor="#D9D9D9", ylabel="")
    figure.colorbar(known, ax=right, label="height (µm)")
    half = np.diff(positions).mean() / 2

    def draw(k: int) -> None:
        frame.set_data(frames[k])
        left.set_title(f"(a) frame at d = {positions[k]:.0f} µm", loc="left")
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
    figure, section, curve = _two_panels(3.4, width_ratios=(1.5, 1))
    r = np.linspace(half_width, radius, 200)
    both = np.r_[-r[::-1], r]
    (wall,) = section.plot(both, 0 * both, color=COLORS["blue"], lw=3)
    (probe,) = section.fill([0], [0], color=COLORS["grey"], alpha=0.6, lw=0)
    section.set(xlabel="distance from the axis r (µm)", ylabel="height (µm)", aspect="equal")
    section.set(ylim=(-1.2 * depth, 0.9 * depth))
    curve.plot(depths, forces, color=COLORS["grey"], lw=1.2)
    (now,) = curve.plot([0], [0], "o", color=COLORS["orange"], ms=10)
    curve.set(xlabel="dimple depth (µm)", ylabel="force F (µN)")
    letter((section, curve))
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
        section.set_title(f"(a) pressed by {force:.0f} µN", loc="left")

    return film(figure, draw, [100] * turns, still=turns // 2, **texts)


def _webp(picture: Image.Image, **how: object) -> str:
    buffer = BytesIO()
    picture.save(buffer, "WEBP", **how)
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
