"""Height maps, surface types and a sinking stage, drawn for chapters 3 and 5."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LightSource, ListedColormap, Normalize
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from compendium.figures.data import FOLDER_VARIABLE, show
from compendium.figures.panels import legend_below, photograph
from microlib.curvature import HK_NAMES

#: Convex in blues, concave in oranges, saddles and flats between; label 0 (unknown) is white.
HK_COLORS = (
    "#FFFFFF",
    *("#08519C", "#4292C6", "#9ECAE1"),
    *("#000000", "#D9D9D9", "#009E73"),
    *("#993404", "#EC7014", "#FEC44F"),
)
PALETTE = ListedColormap(HK_COLORS)
#: Points of a surface along each side; the book stores some 60 kB.
MOST_POINTS = 160


def draw_labels(axes: Axes, labels: NDArray[np.uint8]) -> None:
    """Show a map of surface types."""
    photograph(axes, labels, cmap=PALETTE, vmin=0, vmax=9)


def label_patches(labels: NDArray[np.uint8]) -> list[Patch]:
    """Return the entries of a legend of the surface types that occur in `labels`."""
    present = [label for label in HK_NAMES if np.any(labels == label)]
    return [Patch(color=HK_COLORS[k], label=f"{k} {HK_NAMES[k]}") for k in present]


def draw_surface(
    axes: Any,  # Axes3D, which has no types
    height: NDArray,
    pixel_size: float,
    *,
    labels: NDArray[np.uint8] | None = None,
    unit: str = "µm",
    turned: bool = False,
) -> None:
    """Draw a height map as a surface, colored by height or, if given, by surface type.

    Parameters
    ----------
    axes : Axes3D
        Where to draw.
    height : ndarray, shape (rows, cols)
        Heights, µm.
    pixel_size : float
        Distance between pixels, in `unit`.
    labels : ndarray of uint8, optional
        Surface types for the colors; the height otherwise.
    unit : str
        Unit of x and y.
    turned : bool
        The object is round about the middle of the map, and so is the mesh: an upright wall is then
        a smooth ring and not a flight of stairs. Its surface type is not shown, as it has no pixel
        of its own, and the corners of the map are left out.
    """
    rows, cols = np.indices(height.shape, dtype=float)
    points, types = height, labels
    if turned and labels is not None:  # 60 circles about the middle
        middle = (np.array(height.shape) - 1) / 2
        radius, angle = np.mgrid[0 : middle.min() : 60j, 0 : 2 * np.pi : 121j]
        rows, cols = middle[0] + radius * np.sin(angle), middle[1] + radius * np.cos(angle)
        # A ring has one height, and the type of most of it; where it is upright, none.
        points = map_coordinates(height, [rows, cols], order=1)
        types = map_coordinates(labels, [rows, cols], order=0)
        points[:] = points.mean(axis=1, keepdims=True)
        types[:] = [[np.bincount(ring).argmax()] for ring in types]
        types[:-1][np.abs(np.diff(points, axis=0)) > 0.1 * np.ptp(points)] = 0
    if types is None:
        colors = colormaps["viridis"](Normalize(np.nanmin(points), np.nanmax(points))(points))
    else:
        colors = PALETTE(types)
    # Smoothed edges would leave gaps between the faces, which are too many for an SVG.
    look = {"rstride": 1, "cstride": 1, "linewidth": 0, "antialiased": False, "rasterized": True}
    # From the upper left, as maps have it; y points to the viewer, as in the image.
    light = LightSource(azdeg=225, altdeg=45)
    x, y = pixel_size * cols, pixel_size * rows
    axes.plot_surface(x, y, points, facecolors=colors, lightsource=light, **look)
    axes.invert_yaxis()
    axes.set(xlabel=f"x ({unit})", ylabel=f"y ({unit})", zlabel="height (µm)")
    axes.view_init(elev=35, azim=-60)


def vertical_scale(height: NDArray, pixel_size: float, *, known: bool) -> tuple[float, str]:
    """Return the drawn span of the heights as a share of the longer side, and what to say of it.

    The scale is *known* if heights and pixels have the same unit.
    """
    if not known:
        return 0.25, "vertical scale arbitrary"
    span = np.nanmax(height) - np.nanmin(height)
    share = float(span / (max(height.shape) * pixel_size))
    times = max(k for k in (1, 2, 5, 10, 20, 50, 100) if k == 1 or k * share <= 0.5)
    said = "vertical scale as horizontal" if times == 1 else f"heights drawn {times} times larger"
    return times * share, said


def show_surface(
    name: str,
    height: NDArray,
    pixel_size: float,
    *,
    labels: NDArray[np.uint8] | None = None,
    unit: str = "µm",
    height_unit: str = "µm",
) -> None:
    """
    Show a picture of a height map, and keep its data, with which the book lets a reader turn it.

    Parameters
    ----------
    name : str
        Of the figure and its data.
    height : ndarray, shape (rows, cols)
        Heights, µm; NaN leaves a hole. A large map is shown by the medians of square blocks.
    pixel_size, labels, unit
        As for `draw_surface`.
    height_unit : str
        Unit of the heights. If it is also `unit`, heights are drawn to scale, or so many times
        larger as the picture says.
    """
    side = -(-max(height.shape) // MOST_POINTS)
    rows, cols = (count // side for count in height.shape)
    blocks = height[: rows * side, : cols * side].reshape(rows, side, cols, side)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "All-NaN slice")
        height = np.nanmedian(blocks, axis=(1, 3))
    height[np.isnan(blocks).mean(axis=(1, 3)) > 0.5] = np.nan
    if labels is not None:
        labels = labels[side // 2 :: side, side // 2 :: side][:rows, :cols]
    pixel_size *= side
    tall, note = vertical_scale(height, pixel_size, known=unit == height_unit)
    axes: Any  # Axes3D, which has no types
    figure, axes = plt.subplots(figsize=(6.4, 4.4), subplot_kw={"projection": "3d"})
    draw_surface(axes, height, pixel_size, labels=labels, unit=unit)
    axes.set_title(note)
    axes.set_box_aspect((cols, rows, tall * max(rows, cols)), zoom=0.9)
    axes.locator_params(nbins=5)
    if labels is None:
        scale = ScalarMappable(Normalize(np.nanmin(height), np.nanmax(height)), "viridis")
        figure.colorbar(scale, ax=axes, label=f"height ({height_unit})", shrink=0.5)
        axes.set(zlabel="", zticks=[])  # the color bar shows the height
    else:
        axes.set_zlabel(f"height ({height_unit})")
        legend_below(figure, label_patches(labels))
    show(name)
    if folder := os.environ.get(FOLDER_VARIABLE):
        kept: dict[str, Any] = {"height": height.astype(np.float32), "pixel_size": pixel_size}
        kept |= {"unit": unit, "height_unit": height_unit}
        kept |= {} if labels is None else {"labels": labels}
        np.savez_compressed(Path(folder, name), **kept)
