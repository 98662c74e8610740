"""Drawings of the microscope model, of detected patterns, and of what a plane tells about f."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from compendium.figures.panels import SYMBOL, length, photograph
from compendium.figures.style import COLORS
from microlib.calibration import Detection
from microlib.microscope import Microscope

#: How much longer X and Y are drawn than Z.
STRETCH = 20


def draw_detection(ax: Axes, image: NDArray, detection: Detection, *, label_every: int) -> None:
    """Show an image with the detected points on it and, for some, their grid coordinates.

    Parameters
    ----------
    ax : matplotlib Axes
        Where to draw.
    image : ndarray, shape (height, width)
        Grey levels, shown from 0 to 255.
    detection : Detection
        Its points are drawn, px.
    label_every : int
        Write the grid coordinates of points whose two coordinates are multiples of this.
    """
    photograph(ax, np.rint(image).astype(np.uint8))
    ax.plot(*detection.points.T, "+", color=COLORS["yellow"], ms=7, mew=1.4)
    rows, columns = image.shape
    chosen = (detection.grid % label_every == 0).all(axis=1)
    look: dict[str, Any] = {"color": "black", "va": "top", "textcoords": "offset points"}
    look["path_effects"] = [withStroke(linewidth=2.5, foreground="white")]
    for place, (i, j) in zip(detection.points[chosen], detection.grid[chosen], strict=True):
        text = f"{i},{j}"
        # A letter takes up to 0.045 of the width; a label that the border would cut is left out.
        if place[0] < (1 - 0.045 * len(text)) * columns and place[1] < 0.92 * rows:
            ax.annotate(text, place, (3, -3), **look)
    ax.set(xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5))
    ax.set(xlabel="", ylabel="", xticks=[], yticks=[])


def draw_microscope(ax: Axes, microscope: Microscope, world: NDArray) -> None:
    """The frames, the pattern plane and the virtual image plane of a microscope, seen from the
    side.

    Parameters
    ----------
    ax : matplotlib Axes
        Where to draw. Lengths along the optical axis are in mm; the other two directions are drawn
        :data:`STRETCH` times too large, X obliquely.
    microscope : Microscope
        Its lengths and pose are drawn as they are.
    world : ndarray, shape (N, 2)
        Pattern points to project, µm.
    """
    m = microscope

    def screen(points: NDArray) -> NDArray:
        """Oblique view of points of the objective frame, (N, 3) µm."""
        x, y, z = np.atleast_2d(points).T / 1000
        return np.stack([z + 0.5 * STRETCH * x, -STRETCH * (y + 0.35 * x)])

    image_depth = m.tube_length + m.focal_length
    points = m.to_objective(world)
    images = points * (image_depth / points[:, 2:])
    for image in images:
        ax.plot(*screen(np.stack([np.zeros(3), image])), color=COLORS["grey"], lw=0.8)
    ax.plot(*screen(np.array([[0, 0, 0], [0, 0, 1.08 * image_depth]])), color=COLORS["ink"], lw=1)
    ax.plot(*screen(points), "o", color=COLORS["blue"], ms=5, zorder=3)
    ax.plot(*screen(images), "o", color=COLORS["orange"], ms=5, zorder=3)

    # The sensor's outline, magnified onto the virtual image plane, and what it sees of the pattern.
    width, height = (np.array(m.image_size) - 1).tolist()
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height], [0, 0]], dtype=np.float64)
    sensor = (corners - m.principal_point) * m.pitch
    magnified = np.column_stack([sensor, np.full(len(sensor), image_depth)])
    seen = m.to_objective(m.back_project(corners))
    for outline, color in ((seen, "blue"), (magnified, "orange")):
        ax.plot(*screen(outline), color=COLORS[color], lw=1.5)
        ax.fill(*screen(outline), color=COLORS[color], alpha=0.08, lw=0)

    size = 0.5 * np.abs(sensor).max()
    frames = (
        ("$C_o$", np.zeros(3), np.eye(3), COLORS["ink"]),
        ("$C_w$", m.translation, m.rotation, COLORS["blue"]),
        ("$C_i$", np.array([0, 0, image_depth]), np.eye(3), COLORS["orange"]),
    )
    for name, origin, axes, color in frames:
        start = screen(origin)[:, 0]
        for letter, axis in zip("xy", axes.T[:2], strict=True):
            end = screen(origin + size * axis)[:, 0]
            arrow = {"arrowstyle": "-|>", "color": color, "lw": 2}
            ax.annotate("", tuple(end), tuple(start), arrowprops=arrow)
            x, y = start + 1.18 * (end - start)
            ax.text(x, y, letter, ha="center", va="center")
        ax.text(start[0] - 4, start[1] + 14, name, fontsize=SYMBOL, ha="right")

    floor = -STRETCH * 1.25 * np.abs(sensor).max() / 1000
    spans = (
        ("f", 0, m.focal_length, 0),
        ("d", m.focal_length, m.focal_length + m.distance, 0),
        ("$T_{op} + f$", 0, image_depth, 1),
    )
    for name, low, high, row in spans:
        y = floor * (1 + 0.3 * row)
        length(ax, (low / 1000, y), (high / 1000, y), name, (0, 8))
    ax.set(xlabel="along the optical axis Z (mm)", yticks=[], ylim=(1.5 * floor, None))
    ax.spines["left"].set_visible(False)
    ax.set_aspect("equal")
    ax.grid(False)
