"""The picture of a track."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._plots._axes import BESIDE, FOUND, OFF, given_axes, new_axes, show_image


def path(table: Any, image: NDArray, ax: Any = None) -> Any:
    """Draw the path over a frame, and the position against time.

    With `ax` only the path is drawn. Return the figure.
    """
    seen = table[~table["lost"].to_numpy(bool)]
    points = seen[["center_x", "center_y"]].to_numpy(np.float64)
    if given_axes(ax) is None:
        axes = new_axes(1, 2, 6, 0.8 + 5 * image.shape[0] / image.shape[1])[0]
        _against_time(axes[1], table, points[0])
        ax = axes[0]
    show_image(ax, image)
    # Frames in which the part was lost are gaps.
    ax.plot(*table[["center_x", "center_y"]].to_numpy(np.float64).T, color=FOUND, lw=1)
    boxes = seen.filter(like="corners_").to_numpy(np.float64).reshape(-1, 4, 2)
    for corners, color, name in ((boxes[-1], FOUND, "last"), (boxes[0], BESIDE, "first")):
        ax.plot(*corners[[0, 1, 2, 3, 0]].T, color=color, label=f"{name} position")
    ax.legend(loc="best")
    # A short path is shown enlarged, with twice the template's sides around it.
    near, ends = 2 * np.ptp(corners, axis=0), np.array(image.shape[1::-1]) - 0.5
    left, top = np.maximum(points.min(axis=0) - near, -0.5)
    right, bottom = np.minimum(points.max(axis=0) + near, ends)
    ax.set(xlim=(left, right), ylim=(bottom, top))
    share = table["lost"].mean()
    lost = f", lost in {100 * share:.3g} % of the frames" if share else ""
    ax.set_title(f"path on the first frame{lost}")
    return ax.figure


def _against_time(ax: Any, table: Any, start: NDArray) -> None:
    timed, micrometers = "time_s" in table, "x_um" in table
    time = table["time_s"] if timed else np.arange(len(table))
    for axis, color, first in zip("xy", (FOUND, BESIDE), start, strict=True):
        values = table[f"{axis}_um" if micrometers else f"center_{axis}"].astype(float)
        label = f"{axis}{' (down)' * (axis == 'y')}"
        ax.plot(time, values - (0 if micrometers else first), color=color, label=label)
    lost = table["lost"].to_numpy(dtype=bool)
    if lost.any():
        ax.plot(time[lost], np.zeros(lost.sum()), "|", color=OFF, label="lost")
    unit = "µm" if micrometers else "px"
    ax.set(xlabel="time (s)" if timed else "frame", ylabel=f"displacement from the start ({unit})")
    ax.grid(alpha=0.3)
    ax.legend()
