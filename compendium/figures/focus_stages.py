"""How depth from focus finds a height, stage after stage, by functions that a reader can call."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from compendium.figures.panels import letter
from compendium.figures.style import COLORS
from microlib import synthetic
from microlib.focus import (
    correct_spikes,
    depth_from_focus,
    smooth_depth,
    sum_modified_laplacian,
    three_point_peak,
)

__all__ = ["draw_focus_stages"]


def draw_focus_stages() -> Figure:
    """Draw a slope beside a step, with a patch of no texture, from its frames to its error."""
    rng = np.random.default_rng(3)
    texture = synthetic.mixed_texture((160, 208), rng)
    y, x = np.mgrid[:160, :208]
    texture[np.hypot(x - 156, y - 80) < 44] = texture.mean()
    z = np.arange(0.0, 260.0, 20.0)
    height = np.where(x < 104, 40 + 1.4 * x, 60.0)
    stack = synthetic.focal_stack(texture, height, z, blur_rate=0.05, noise=2.0, rng=rng)
    sharpness = np.array([sum_modified_laplacian(frame, window=9) for frame in stack])
    best = sharpness.argmax(axis=0)
    around = np.clip(best + np.arange(-1, 2)[:, None, None], 0, len(z) - 1)
    fitted = three_point_peak(np.take_along_axis(sharpness, around, axis=0), best, z)
    smooth = smooth_depth(correct_spikes(fitted), jump=30.0)
    found = depth_from_focus(stack, z)
    row, col = 40, 60  # of the pixel whose profile is shown

    figure, grid = plt.subplots(4, 2, figsize=(6.4, 12.4))
    heights: dict[str, Any] = {"cmap": "viridis", "vmin": z[0], "vmax": 200}
    pictures = {
        "a frame": (stack[6], "grey level", {}),
        "its sharpness": (sharpness[6], "focus measure (grey levels)", {"cmap": "magma"}),
        "a pixel: its peak": None,
        "best frame": (z[best], "height (µm)", heights),
        "between the frames": (fitted, "height (µm)", heights),
        "without spikes": (smooth, "height (µm)", heights),
        "edges, rules, relief": (found.depth, "height (µm)", heights),
        "its uncertainty": (found.uncertainty, "error (µm)", {"cmap": "magma", "vmax": 10}),
    }
    for axes, (title, shown) in zip(grid.flat, pictures.items(), strict=True):
        axes.set_title(title)
        axes.grid(False)
        if shown is None:
            axes.plot(z, sharpness[:, row, col], "o-", color=COLORS["blue"])
            axes.axvline(fitted[row, col], color=COLORS["orange"], ls="--")
            axes.set(xlabel="position (µm)", ylabel="focus measure (grey levels)")
            continue
        image, unit, look = shown
        drawn = axes.imshow(image, **look)
        axes.set(xticks=[], yticks=[])
        figure.colorbar(drawn, ax=axes, label=unit, location="bottom")
    letter(grid.flat)
    return figure
