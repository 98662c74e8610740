"""Drawings of chapters 3 and 4: solids and surface types by their labels, cells and an egg."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from compendium.figures.cells import PIXEL_SIZE, render_cells
from compendium.figures.embryo import add_scale_bar, show_image
from compendium.figures.panels import legend_below, letter
from compendium.figures.style import COLORS
from compendium.figures.surfaces import draw_labels, draw_surface, label_patches
from microlib import synthetic
from microlib.curvature import hk_labels, surface_curvature


def draw_solids() -> Figure:
    """Draw figure 3.3: a ball on a plane, a cylinder and a cone, with the labels of `hk_labels`."""
    shape, radius, ticks = (121, 121), 45.0, [0, 120]
    across = np.arange(121) - 60.0
    solids = {
        "ball": synthetic.sphere_on_plane(shape, radius, 1.0),
        "cylinder": np.sqrt(np.maximum(radius**2 - across**2, 0)) * np.ones((121, 1)),
        "cone": synthetic.cone(shape, radius, 50.0),
    }
    figure = plt.figure(figsize=(6.4, 6.0))
    found = []
    for place, (name, height) in enumerate(solids.items(), 1):
        bend = surface_curvature(height, 1.0)
        labels = hk_labels(bend.mean, bend.gaussian, h_zero=4e-3, k_zero=1e-4)
        found.append(labels)
        axes: Any = figure.add_subplot(2, 2, place, projection="3d")
        draw_surface(axes, height, 1.0, labels=labels, turned=name != "cylinder")
        axes.set(title=name, xticks=ticks, yticks=ticks, zticks=[0, 80])
        axes.set_box_aspect((1, 1, 0.7))
    letter(figure.axes)
    key = figure.add_subplot(2, 2, 4)
    untyped = Patch(facecolor="white", edgecolor=COLORS["grey"], label="no type")
    key.legend(handles=[*label_patches(np.stack(found)), untyped], loc="center")
    key.axis("off")
    return figure


def draw_types(patches: Mapping[str, tuple[NDArray, int]]) -> Figure:
    """Draw figure 3.4: a patch of each surface type with the label that was found in its middle."""
    figure = plt.figure(figsize=(6.4, 4.4))
    for place, (name, (height, label)) in enumerate(patches.items(), 1):
        axes = figure.add_subplot(2, 4, place, projection="3d")
        labels = np.full(height.shape, label, np.uint8)
        draw_surface(axes, height - height.mean(), 1.0, labels=labels)
        axes.set(xlabel="", ylabel="", zlabel="", xticks=[], yticks=[], zticks=[], zlim=(-8, 8))
        axes.set_title(f"{label} {name}")
        axes.set_box_aspect((1, 1, 0.8))
    return figure


def draw_label_maps(maps: Mapping[str, NDArray[np.uint8]]) -> Figure:
    """Draw maps of surface types side by side, with one legend."""
    figure, row = plt.subplots(1, len(maps), figsize=(6.4, 3.8), sharey=True)
    for axes, (title, labels) in zip(row, maps.items(), strict=True):
        draw_labels(axes, labels, legend=False)
        axes.set(title=title)
        axes.label_outer()
    letter(row)
    legend_below(figure, label_patches(np.stack([*maps.values()])))
    return figure


def draw_cells(rng: np.random.Generator) -> Figure:
    """Draw figure 4.1: rendered cells, spread on glass and floating."""
    figure, row = plt.subplots(1, 2, figsize=(6.4, 3.0))
    for axes, kind in zip(row, ("293T", "Jurkat"), strict=True):
        image, _ = render_cells(kind, rng)
        show_image(axes, image)
        add_scale_bar(axes, 20, PIXEL_SIZE)
        axes.set_title(f"{kind}, rendered")
    letter(row)
    return figure


def draw_egg(rng: np.random.Generator) -> Figure:
    """Draw figure 4.2: a rendered zebrafish egg that nothing touches."""
    embryo = synthetic.Embryo(modulus=1.3, force=0.0, dimple_radius=1.0)
    egg = synthetic.embryo_image(embryo, rng=rng, probe=False)
    figure, axes = plt.subplots(figsize=(5.2, 3.9))
    show_image(axes, egg.image)
    add_scale_bar(axes, 500, egg.pixel_size)
    places = {"chorion": (424, -176, 150), "fluid": (520, -560, 330), "yolk": (250, -750, 480)}
    for name, (x, y, row) in places.items():
        point = egg.to_pixels(np.array([[x, y]], float))[0]
        line = {"arrowstyle": "-", "lw": 1.2, "color": "black"}
        axes.annotate(name, point, (760, row), arrowprops=line, va="center", color="black")
    return figure
