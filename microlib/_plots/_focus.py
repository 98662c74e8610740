"""The picture of a height map."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._plots._axes import given_axes, new_axes, rounded_down, show_image


def maps(result: Any, ax: Any = None) -> Any:
    """Draw a FocusResult: all-in-focus image, height and uncertainty.

    With `ax` only the height is drawn. Lengths along the image are in px where the pixel size is
    not known. Return the figure.
    """
    depth = np.asarray(result.depth)
    rows, columns = depth.shape
    if given_axes(ax) is None:
        axes = new_axes(1, 3, 5.5, 0.4 + 5 * rows / columns)[0]
        show_image(axes[0], result.all_in_focus)
        axes[0].set_title("all in focus")
        uncertainty = np.asarray(result.uncertainty)
        _map(axes[2], uncertainty, "magma", f"uncertainty ({result.unit})", logarithmic=True)
        ax = axes[1]
    _map(ax, depth, "viridis", f"height ({result.unit})")
    if result.pixel_size:
        _scale_bar(ax, result.pixel_size, columns)
    return ax.figure


def _map(ax: Any, values: NDArray, colors: str, label: str, logarithmic: bool = False) -> None:
    """Draw a map with its color bar; unknown pixels are grey."""
    from matplotlib import colormaps
    from matplotlib.colors import LogNorm, Normalize

    known = values[np.isfinite(values)]
    # Outliers would use up the colors.
    low, high = np.quantile(known, [0.005, 0.995]) if len(known) else (0, 1)
    norm = LogNorm(low, high) if logarithmic and low > 0 else Normalize(low, high)
    cmap = colormaps[colors].with_extremes(bad="0.8")
    picture = ax.imshow(values, cmap=cmap, norm=norm, interpolation="nearest", origin="upper")
    ax.figure.colorbar(picture, ax=ax, label=label, extend="both", shrink=0.8)
    unknown = 1 - len(known) / values.size
    ax.set_title(f"{label.split()[0]}{f', grey: {100 * unknown:.3g} % unknown' if unknown else ''}")
    ax.set_axis_off()


def _scale_bar(ax: Any, pixel_size: float, columns: int) -> None:
    from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

    length = rounded_down(pixel_size * columns / 4)
    text = f"{length / 1000:g} mm" if length >= 1000 else f"{length:g} µm"
    bar = AnchoredSizeBar(ax.transData, length / pixel_size, text, "lower left", size_vertical=1)
    bar.patch.set_alpha(0.7)
    ax.add_artist(bar)
