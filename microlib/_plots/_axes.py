"""Axes, photographs and round numbers for all pictures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._common import as_instance, as_picture

#: Colors of results, references and errors, distinct on grey and for color-blind readers.
FOUND, BESIDE, OFF = "#ffb000", "#56b4e9", "#e0245e"


@contextmanager
def default_style() -> Iterator[None]:
    """Draw with Matplotlib's defaults, without a user's settings such as LaTeX."""
    from matplotlib import rc_context, rcdefaults

    with rc_context():
        rcdefaults()
        yield


def new_axes(rows: int, columns: int, width: float, height: float) -> Any:
    """Return the axes (rows, columns) of a new figure, each `width` by `height` inches."""
    from matplotlib import pyplot

    size = (width * columns, height * rows)
    return pyplot.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)[1]


def given_axes(ax: Any) -> Any:
    """Return axes that a caller gave, or None."""
    from matplotlib.axes import Axes

    return None if ax is None else as_instance("ax", ax, Axes)


def show_image(ax: Any, image: NDArray) -> None:
    """Show a photograph in the range of its own grey levels, without axes of its own."""
    levels = as_picture("image", image)
    low, high = levels.min(), levels.max()
    grey = np.uint8(255 * (levels - low) / (high - low or 1))
    ax.imshow(grey, cmap="gray", vmin=0, vmax=255, origin="upper")
    ax.set_axis_off()


def rounded_down(value: float) -> float:
    """Return the next smaller of 1, 2, 5, 10, 20, …"""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1, 2, 5) if step * power <= value))
