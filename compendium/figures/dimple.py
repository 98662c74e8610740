"""Drawings of chapter 4 and section 5.6: the dimple, of the model, printed and rendered."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from compendium import thesis
from compendium.experiments.section_5_6 import Outline, Scene
from compendium.figures.panels import legend_below, length, letter
from compendium.figures.style import COLORS
from microlib.embryo import GaussianSum, dimple_geometry
from microlib.membrane import dimple_profile


def draw_dimple_section(radius: float, depth: float, half_width: float) -> Figure:
    """Draw figure 4.3: a section through the dimple of the model, with its lengths.

    Parameters
    ----------
    radius, depth, half_width : float
        a, w_d and c, µm.

    Returns
    -------
    Figure
        To scale, with heights above the rim.
    """
    a, c = radius, half_width
    r = np.linspace(c, a, 400)
    w = dimple_profile(r, a, depth, probe_half_width=c)
    bend = 80.0  # µm, the radius R outside the rim; the model does not use it
    turn = np.linspace(0, np.pi / 2, 60)
    outside, above = a + bend * np.sin(turn), bend * (np.cos(turn) - 1)
    figure, axes = plt.subplots(figsize=(6.4, 4.0))
    for side in (-1, 1):
        axes.plot(side * r, -w, color=COLORS["blue"], lw=3)
        axes.plot(side * outside, above, color=COLORS["sky"], lw=3)
    axes.plot([-c, c], [-depth, -depth], color=COLORS["blue"], lw=3)
    axes.fill_between([-c, c], -depth, 75, color=COLORS["grey"], alpha=0.35, lw=0)
    axes.annotate("", (0, -depth), (0, 70), arrowprops={"arrowstyle": "->", "lw": 2})
    axes.text(8, 50, "F", fontsize=14)
    length(axes, (0, 20), (a, 20), "a", (0, 14))
    length(axes, (0, -depth - 18), (c, -depth - 18), "c", (0, -20))
    length(axes, (-a, 0), (-a, -depth), "$w_d$", (22, 0))
    axes.plot([-a, -c], [-depth, -depth], color=COLORS["ink"], lw=0.8, ls=":")
    rim = (a + bend * np.sin(0.7), bend * (np.cos(0.7) - 1))
    axes.annotate("", (a, -bend), rim, arrowprops={"arrowstyle": "->", "lw": 1.3})
    axes.text(a + 6, -bend + 30, "R", fontsize=14)
    axes.set(xlabel="distance from the axis r (µm)", ylabel="height (µm)")
    axes.set(ylim=(-175, 80), aspect="equal")
    return figure


def draw_rendered_outline(
    scene: Scene, boundary: Outline, columns: NDArray, smooth: GaussianSum, profile: NDArray
) -> Figure:
    """Draw figures 5.18 and 5.19 from the rendered image.

    Parameters
    ----------
    scene : Scene
        Says where the dimple is.
    boundary : Outline
        Its outline.
    columns : ndarray, shape (N,)
        Where the curves are drawn, px; heights count from the lowest outline among them.
    smooth : GaussianSum
        The thesis' curve.
    profile : ndarray, shape (N,)
        The fitted profile (4.2) at `columns`, px.
    """
    base = np.interp(columns, boundary.x, boundary.y).min()
    (x1, y1), (x2, y2) = _rim_and_bottom(smooth)
    figure, (whole, bottom) = plt.subplots(2, 1, figsize=(6.4, 4.9))
    for axes in (whole, bottom):
        axes.plot(columns, smooth(columns), color=COLORS["yellow"], label="eight Gaussians")
        axes.plot(columns, profile - base, color=COLORS["blue"], lw=3, label="profile (4.2)")
        axes.plot(boundary.x, boundary.y - base, ".", color=COLORS["ink"], ms=4, label="outline")
        axes.set(xlabel="x (px)", ylabel="y, up (px)", aspect="equal", title="the dimple")
    length(whole, (x1, y1 + 4), (x2, y1 + 4), "a", (0, 6))
    length(whole, (x2, y1), (x2, y2), "$w_d$", (8, 8))
    near = 1.5 * scene.embryo.dimple_radius / scene.pixel_size
    middle = scene.center[0]
    whole.set(xlim=(middle - near, middle + near), ylim=(-6, y1 + 18))
    # The two curves differ within four widths of the probe.
    reach = 4 * thesis.MEMBRANE["probe_half_width"] / scene.pixel_size
    bottom.set(
        xlim=(middle - reach, middle + reach), ylim=(-2, reach / 2), title="its bottom, enlarged"
    )
    letter((whole, bottom))
    legend_below(figure)
    return figure


def _rim_and_bottom(curve: GaussianSum) -> tuple[tuple[float, float], tuple[float, float]]:
    dimple = dimple_geometry(curve, pixel_size=thesis.EMBRYO_PIXEL)
    return dimple.rim, dimple.bottom
