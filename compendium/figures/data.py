"""Keep the numbers behind a figure beside it, so that a reader can download and redraw them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from IPython.display import display
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from compendium.figures.style import to_svg
from microlib._common import replace_file

#: Environment variable that names the folder for the data; nothing is kept without it.
FOLDER_VARIABLE = "MICROLIB_FIGURES"


def show(name: str) -> None:
    """Show the current figure; keep its data (`name`.csv, `name`.npz) where a folder is named."""
    figure, folder = plt.gcf(), os.environ.get(FOLDER_VARIABLE)
    if folder:
        keep_data(figure, Path(folder) / name)
    display({"image/svg+xml": to_svg(figure)}, raw=True)
    plt.close(figure)


def keep_data(figure: Figure, stem: Path) -> None:
    """
    Write the curves of a figure to a CSV file and its images to an NPZ file.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Figure whose axes are labelled with units.
    stem : pathlib.Path
        Path of the files without their ending. A drawing without data leaves none.

    Notes
    -----
    The CSV holds one point a row: panel, series, x, y, and the axes' own labels, which carry the
    units. The NPZ holds each image as drawn, maps to
    1/10000 of their range, its extent, and a text array of what it is.
    """
    rows: list[list[object]] = []
    images: dict[str, Any] = {}
    for number, axes in enumerate(figure.axes, 1):
        for series, points in _series(axes):
            labels = [axes.get_xlabel(), axes.get_ylabel()]
            rows += [[number, series, f"{x:.6g}", f"{y:.6g}", *labels] for x, y in points]
        for k, image in enumerate(axes.images, 1):
            values = np.asarray(image.get_array())
            if values.dtype.kind == "f":  # to 1/10000 of the range, which packs well
                digits = 4 - int(np.ceil(np.log10(np.nanmax(values) - np.nanmin(values) or 1)))
                values = values.astype(np.float32).round(digits)
            images[f"panel{number}_image{k}"] = values
    stem.parent.mkdir(parents=True, exist_ok=True)
    if rows:
        table = pd.DataFrame(rows, columns=["panel", "series", "x", "y", "x_label", "y_label"])
        path = stem.with_suffix(".csv")
        replace_file(path, lambda file: table.to_csv(file, index=False, lineterminator="\n"))
    if images:
        titles = [axes.get_title("left") or axes.get_title() for axes in figure.axes]
        images["panel_titles"] = np.array(titles)
        replace_file(stem.with_suffix(".npz"), lambda file: np.savez_compressed(file, **images))


def _series(axes: Axes) -> Iterator[tuple[str, np.ndarray]]:
    """Yield name and points of each curve and cloud of points."""
    for line in axes.lines:
        # Straight helper lines (axvline) are given in mixed coordinates and are no data.
        if line.get_transform() == axes.transData:
            yield str(line.get_label()), np.asarray(line.get_xydata(), dtype=float)
    for collection in axes.collections:
        offsets = np.asarray(collection.get_offsets(), dtype=float)
        if offsets.ndim == 2 and len(offsets) > 1 and offsets.shape[1] == 2:
            yield str(collection.get_label()), offsets
