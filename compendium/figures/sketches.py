"""Drawings of chapters 3 and 4: solids and surface types by their labels, cells and an egg."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from compendium.figures.panels import letter
from compendium.figures.style import COLORS
from compendium.figures.surfaces import draw_surface, label_patches
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
