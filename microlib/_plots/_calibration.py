"""The picture of a calibration: marks on their photographs, and their residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._plots._axes import FOUND, OFF, given_axes, new_axes, rounded_down, show_image


def marks(
    detections: Sequence[Any],
    images: Sequence[NDArray] | None = None,
    residuals: NDArray | None = None,
    ax: Any = None,
) -> Any:
    """Draw the points of detections with their grid coordinates, and magnified residuals in red.

    One panel per view; with `ax` only the first view is drawn there. Return the figure.
    """
    width, height = detections[0].image_size
    columns = ceil(sqrt(len(detections)))
    rows = ceil(len(detections) / columns)
    panel = max(2.5, 8 / columns)
    if given_axes(ax) is None:
        ax = new_axes(rows, columns, panel, 0.6 + panel * height / width)
    axes = np.ravel(ax)
    for unused in axes[len(detections) :]:
        unused.set_axis_off()
    ends = np.cumsum([len(detection.points) for detection in detections])[:-1]
    parts = [None] * len(detections) if residuals is None else np.split(residuals, ends)
    factor = 1.0
    if residuals is not None:  # which makes large residuals as long as marks lie apart
        large = np.quantile(np.hypot(*residuals.T), 0.95)
        apart = np.sqrt(np.ptp(detections[0].points, axis=0).prod() / len(detections[0].points))
        factor = rounded_down(apart / large) if large > 0 else 1.0
    photographs = [None] * len(detections) if images is None else images
    panels = zip(axes, detections, photographs, parts, strict=False)
    for panel_ax, detection, image, part in panels:
        if image is None:
            panel_ax.set(xlim=(0, width), ylim=(height, 0), aspect="equal")
        else:
            show_image(panel_ax, image)
        _draw_view(panel_ax, detection, part, factor, 5 if len(axes) == 1 else 2)
    return axes[0].figure


def micrometers(scales: Mapping[str, Any], images: Mapping[str, NDArray]) -> Any:
    """Draw the lines of stage micrometers on their photographs, each by its name."""
    (axes,) = new_axes(1, len(scales), 4.0, 3.5)
    for ax, (name, scale) in zip(axes, scales.items(), strict=True):
        show_image(ax, images[name])
        ax.plot(*scale.points.T, "o", ms=4, mfc="none", color=FOUND)
        ax.set_title(f"{name}: {len(scale.points)} lines")
    return axes[0].figure


def _draw_view(ax: Any, view: Any, residuals: NDArray | None, factor: float, labels: int) -> None:
    """Draw the marks of one detection, their grid coordinates and their magnified residuals."""
    ax.plot(*view.points.T, "o", ms=3, mfc="none", mew=0.7, color=FOUND)
    every = ceil((np.ptp(view.grid, axis=0).max() + 1) / labels)
    labeled = (view.grid % every == 0).all(axis=1)
    box = {"color": "white", "alpha": 0.6, "pad": 0.5}
    for (x, y), (i, j) in zip(view.points[labeled], view.grid[labeled], strict=True):
        ax.annotate(f"{i},{j}", (x, y), (4, 4), textcoords="offset points", color="black", bbox=box)
    title = f"{len(view.points)} points"
    if residuals is not None:
        scale = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.004}
        ax.quiver(*view.points.T, *(factor * residuals).T, **scale, color=OFF)
        rms = np.sqrt((residuals**2).sum(axis=1).mean())
        title += f"\n{rms:.2g} px rms (red, × {factor:g})"
    ax.set_title(title)
