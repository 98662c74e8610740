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
from matplotlib.text import Text
from PIL import Image

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


def two_panels(height: float, **how: Any) -> tuple[Figure, Any, Any]:
    """Return a figure nearly as wide as the page, of 640 px, with two panels, and the panels."""
    figure = Figure((6.4, height), dpi=100, facecolor="none", layout="constrained")
    return figure, *figure.subplots(1, 2, **how)


def _webp(picture: Image.Image, **how: object) -> str:
    buffer = BytesIO()
    picture.save(buffer, "WEBP", **how)
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
