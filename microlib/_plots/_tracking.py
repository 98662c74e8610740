"""The picture of a track."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from microlib._plots._axes import BESIDE, FOUND, OFF, new_axes, show_image

if TYPE_CHECKING:
    import pandas as pd


def path(table: pd.DataFrame, image: NDArray, ax: Any = None) -> Any:
    """Draw the way over the first frame, and the position against time.

    With `ax` the way alone is drawn. Return the figure.
    """
    if ax is None:
        axes = new_axes(1, 2, 6, 0.8 + 5 * image.shape[0] / image.shape[1])[0]
        _against_time(axes[1], table)
        ax = axes[0]
    show_image(ax, image)
    ax.plot(table["center_x"], table["center_y"], color=FOUND, lw=1)
    names = [
        f"corners_{corner}" for corner in ("top_left", "top_right", "bottom_right", "bottom_left")
    ]
    box = [[table[f"{name}_{axis}"].iloc[0] for name in (*names, names[0])] for axis in "xy"]
    ax.plot(*box, color=BESIDE)
    last = table[["center_x", "center_y"]].astype(float).dropna().iloc[-1]
    ax.plot(*last, "o", color=FOUND)
    # What moves little is looked at from near.
    way = table[["center_x", "center_y"]].astype(float)
    size = np.ptp(box, axis=1)
    for limits, low, high, end in zip(
        ("set_xlim", "set_ylim"),
        way.min() - 2 * size,
        way.max() + 2 * size,
        image.shape[1::-1],
        strict=True,
    ):
        near = max(low, -0.5), min(high, end - 0.5)
        getattr(ax, limits)(near if limits == "set_xlim" else near[::-1])
    lost = table["lost"].mean()
    ax.set_title(f"first frame, and the way; lost in {lost:.0%} of the frames")
    return ax.figure


def _against_time(ax: Any, table: pd.DataFrame) -> None:
    micrometers = "x_um" in table
    time = table["time_s"] if "time_s" in table else table["frame"]
    for axis, color in zip("xy", (FOUND, BESIDE), strict=True):
        values = table[f"{axis}_um" if micrometers else f"center_{axis}"].astype(float)
        ax.plot(
            time, values - values.iloc[0], color=color, label=f"{axis}{' (down)' * (axis == 'y')}"
        )
    lost = table["lost"].to_numpy(dtype=bool)
    ax.plot(time[lost], np.zeros(lost.sum()), "|", color=OFF, label="lost" if lost.any() else None)
    ax.set(
        xlabel="time (s)" if "time_s" in table else "frame",
        ylabel=f"way from the start ({'µm' if micrometers else 'px'})",
    )
    ax.grid(alpha=0.3)
    ax.legend()
