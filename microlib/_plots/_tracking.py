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
    way = table[["center_x", "center_y"]].to_numpy(np.float64)
    way = way[np.isfinite(way).all(axis=1)]
    ax.plot(*way[-1], "o", color=FOUND)
    # What moves little is looked at from near.
    near, ends = 2 * np.ptp(box, axis=1), np.array(image.shape[1::-1]) - 0.5
    low, high = np.maximum(way.min(axis=0) - near, -0.5), np.minimum(way.max(axis=0) + near, ends)
    ax.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]))
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
