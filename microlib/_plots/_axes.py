"""What the pictures share: axes to draw in, photographs, round numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: What was found, what it is compared with, and what is off: told apart on grey and by all eyes.
FOUND, BESIDE, OFF = "#ffb000", "#56b4e9", "#e0245e"


@contextmanager
def default_style() -> Iterator[None]:
    """Draw as Matplotlib does without the settings of a user, such as another origin or LaTeX."""
    from matplotlib import rc_context, rcdefaults

    with rc_context():
        rcdefaults()
        yield


def in_default_style(draw: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that draws a new figure in the default style, and in axes as they are."""

    @wraps(draw)
    def drawn(*args: Any, **options: Any) -> Any:
        if signature(draw).bind(*args, **options).arguments.get("ax") is not None:
            return draw(*args, **options)
        with default_style():
            figure = draw(*args, **options)
            figure.draw_without_rendering()  # or ticks are made later, in another style
        return figure

    return drawn


def new_axes(rows: int, columns: int, width: float, height: float) -> Any:
    """Return the axes (rows, columns) of a new figure, each `width` by `height` inches."""
    from matplotlib import pyplot

    size = (width * columns, height * rows)
    return pyplot.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)[1]


def show_image(ax: Any, image: NDArray) -> None:
    """Show a photograph in the range of its own grey levels, without axes of its own."""
    levels = np.asarray(image, dtype=np.float32)
    low, high = levels.min(), levels.max()
    grey = np.uint8(255 * (levels - low) / (high - low or 1))
    ax.imshow(grey, cmap="gray", vmin=0, vmax=255, origin="upper")
    ax.set_axis_off()


def rounded_down(value: float) -> float:
    """Return the next smaller of 1, 2, 5, 10, 20, …"""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1, 2, 5) if step * power <= value))
