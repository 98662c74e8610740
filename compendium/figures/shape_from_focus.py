"""Drawings of section 5.5: focal stacks, depths, surface types and their thresholds."""

from __future__ import annotations

from collections.abc import Iterable

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from compendium import thesis
from compendium.experiments.section_5_5 import BALL_PIXEL, BALL_RADIUS, BALL_SHAPE, Scene
from compendium.figures.style import COLORS
from compendium.figures.surfaces import draw_labels, draw_surface, label_patches

__all__ = [
    "draw_ball_frames",
    "draw_depth",
    "draw_ridge_frames",
    "draw_thresholds",
    "draw_types",
    "draw_types_by_window",
]


def draw_ridge_frames(ridge: Scene, fused: NDArray) -> Figure:
    """Draw figure 5.9: texture, three frames, the fused image and the true height.

    Bars above and below a frame mark the columns that it shows sharp.
    """
    figure, grid = plt.subplots(2, 3, figsize=(7.2, 5.4), sharex=True, sharey=True)
    chosen = dict(zip("bcd", (0, 10, 18), strict=True))
    images = [(ridge.texture, "(a) texture")]
    images += [
        (ridge.frames[k], f"({letter}) d = {ridge.positions[k]:.0f} µm")
        for letter, k in chosen.items()
    ]
    images += [(fused, "(e) fused"), (ridge.height, "true height")]
    for axes, (image, title) in zip(grid.flat, images, strict=True):
        axes.imshow(image, cmap="viridis" if title == "true height" else "gray")
        axes.set_title(title, pad=12)
        axes.grid(False)
    for axes, k in zip(grid.flat[1:4], chosen.values(), strict=True):
        _mark_sharp_columns(axes, ridge, k)
    for axes in grid[1]:
        axes.set(xlabel="x (px)")
    for axes in grid[:, 0]:
        axes.set(ylabel="y (px)")
    return figure


def _mark_sharp_columns(axes: Axes, ridge: Scene, frame: int) -> None:
    """Draw bars beside a frame along the columns that are sharp in no other frame."""
    away = np.abs(ridge.height[0] - ridge.positions[:, None])
    sharp = np.flatnonzero(away.argmin(axis=0) == frame)
    for stripe in np.split(sharp, np.flatnonzero(np.diff(sharp) > 1) + 1):
        if stripe.size:
            ends = stripe[[0, -1]] + [-0.5, 0.5]
            for side in (-0.03, 1.03):
                axes.plot(
                    ends,
                    [side, side],
                    transform=axes.get_xaxis_transform(),
                    color=COLORS["orange"],
                    lw=5,
                    solid_capstyle="butt",
                    clip_on=False,
                )


def draw_ball_frames(ball: Scene, fused: NDArray) -> Figure:
    """Draw figure 5.11: three frames and the fused image."""
    figure, row = plt.subplots(1, 4, figsize=(7.2, 2.6), sharey=True)
    panels = [
        (ball.frames[k], f"({letter}) {ball.positions[k]:.0f} µm")
        for letter, k in zip("abc", (1, 11, 15), strict=True)
    ]
    for axes, (image, title) in zip(row, [*panels, (fused, "(d) fused")], strict=True):
        axes.imshow(image)
        axes.set(title=title, xlabel="x (px)")
        axes.grid(False)
    row[0].set(ylabel="y (px)")
    return figure


def draw_depth(depth: NDArray, pixel_size: float | None = None, *, turned: bool = False) -> Figure:
    """Draw figures 5.10 and 5.12: a height map (µm) in perspective and from above.

    Parameters
    ----------
    depth : ndarray, shape (rows, cols)
        Height, µm.
    pixel_size : float, optional
        µm; the axes are in px without.
    turned : bool
        As for `draw_surface`.
    """
    unit = "px" if pixel_size is None else "µm"
    size = pixel_size or 1.0
    rows, cols = depth.shape
    figure = plt.figure(figsize=(7.2, 3.8))
    left = figure.add_subplot(1, 2, 1, projection="3d")
    draw_surface(left, depth, size, unit=unit, turned=turned)
    left.set(zlabel="", title="(a) height in µm", box_aspect=(1, 1, 0.7))
    left.tick_params(labelsize=11)
    right = figure.add_subplot(1, 2, 2)
    extent = None if pixel_size is None else (0, cols * size, rows * size, 0)
    shown = right.imshow(depth, cmap="viridis", extent=extent)
    right.set(xlabel=f"x ({unit})", ylabel=f"y ({unit})", title="(b)")
    right.grid(False)
    figure.colorbar(shown, ax=right, label="height (µm)", shrink=0.8)
    return figure


def draw_types(
    labels: dict[str, NDArray[np.uint8]],
    *,
    ball: bool = False,
    enlarged: tuple[int, int, int, int] | None = None,
) -> Figure:
    """Draw figures 5.13 and 5.14: maps of surface types side by side, under one legend.

    Parameters
    ----------
    labels : dict of str to ndarray
        Surface types by title.
    ball : bool
        Show the ball's edge and half its radius.
    enlarged : tuple of int, optional
        Part (x, y, width, height), px, that a second row shows larger.
    """
    rows = 1 if enlarged is None else 2
    # Inches: square maps, a legend below, and labels and a title between two rows.
    size = (7.2, 1.0 + 7.2 / len(labels) * rows + 0.6 * (rows - 1))
    figure, grid = plt.subplots(rows, len(labels), figsize=size, squeeze=False)
    row = grid[0]
    for axes, (title, types) in zip(row, labels.items(), strict=True):
        draw_labels(axes, types, legend=False)
        axes.set(title=title, ylabel="y (px)" if axes is row[0] else "")
        if ball:
            middle = ((BALL_SHAPE[0] - 1) / 2, (BALL_SHAPE[1] - 1) / 2)
            for share, line in ((1.0, "-"), (0.5, "--")):
                radius = share * BALL_RADIUS / BALL_PIXEL
                axes.add_patch(Circle(middle, radius, fill=False, color="black", ls=line))
    if enlarged is not None:
        x, y, width, height = enlarged
        for whole, axes, types in zip(row, grid[1], labels.values(), strict=True):
            whole.add_patch(Rectangle((x, y), width, height, fill=False, ec="black", lw=1.5))
            draw_labels(axes, types, legend=False)
            axes.set(xlim=(x, x + width), ylim=(y + height, y), ylabel=axes.get_ylabel())
        grid[1, 0].set(title="the frames, enlarged")
    for axes in grid[:, 1:].flat:
        axes.set(ylabel="")
    _legend_below(figure, labels.values())
    return figure


def draw_thresholds() -> Figure:
    """Draw the thesis' thresholds in the plane of H and K, and where a ball lies in it."""
    h, k = thesis.H_THRESHOLD, thesis.K_THRESHOLD
    curvature = np.linspace(0, 0.2, 300)
    figure, axes = plt.subplots(figsize=(7.2, 3.4))
    axes.plot(curvature, curvature**2, color=COLORS["blue"], label="a ball: K = H²")
    axes.fill_between(curvature, curvature**2, 0.04, color=COLORS["grey"], alpha=0.25, lw=0)
    axes.text(0.045, 0.03, "no surface lies here", color=COLORS["grey"])
    axes.axvline(h, color=COLORS["orange"], ls="--", label="threshold of H")
    axes.axhline(k, color=COLORS["pink"], ls="--", label="threshold of K")
    between = np.linspace(h, np.sqrt(k), 100)
    axes.fill_between(between, between**2, color=COLORS["yellow"], alpha=0.4, lw=0)
    axes.text(0.1, 0.0012, "a ball is called\na cylinder", fontsize=11, ha="center")
    axes.set(xlabel="|H| (1/unit)", ylabel="K (1/unit²)", xlim=(0, 0.2), ylim=(0, 0.04))
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1))
    return figure


def draw_types_by_window(labels: dict[int, NDArray[np.uint8]]) -> Figure:
    """Draw surface types side by side, by the window of the derivatives in px."""
    figure, row = plt.subplots(1, len(labels), figsize=(7.2, 3.4), sharey=True)
    for axes, (window, types) in zip(row, labels.items(), strict=True):
        draw_labels(axes, types, legend=False)
        axes.set(title=f"windows of {window} px", ylabel="y (px)" if axes is row[0] else "")
    _legend_below(figure, labels.values())
    return figure


def _legend_below(figure: Figure, maps: Iterable[NDArray[np.uint8]]) -> None:
    """Put one legend of the surface types that occur in any map under all of them."""
    present = label_patches(np.stack(list(maps)))
    figure.legend(handles=present, loc="outside lower center", ncols=3, fontsize=11)
