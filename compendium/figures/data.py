"""Keep the numbers behind a figure beside it, so that a reader can download and redraw them."""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.container import BarContainer
from matplotlib.figure import Figure

from microlib._common import replace_file

__all__ = ["FOLDER_VARIABLE", "keep_data", "show"]

#: Environment variable that names the folder for the data; nothing is kept without it.
FOLDER_VARIABLE = "MICROLIB_FIGURES"
#: Significant digits of the data: a drawing shows three or four.
DIGITS = 6
#: Those of its images, where a color stands for one of 256 levels and there are many more numbers.
IMAGE_DIGITS = 5


def show(name: str) -> None:
    """Show the current figure; keep its data (`name`.csv, `name`.npz) where a folder is named."""
    folder = os.environ.get(FOLDER_VARIABLE)
    if folder:
        keep_data(plt.gcf(), Path(folder) / name)
    plt.show()


def keep_data(figure: Figure, stem: Path) -> list[Path]:
    """
    Write the curves of a figure to a CSV file and its images to an NPZ file.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Figure whose axes are labelled with units.
    stem : pathlib.Path
        Path of the files without their ending.

    Returns
    -------
    list of pathlib.Path
        The files written: none for a drawing without data.

    Notes
    -----
    The CSV holds one point a row: panel, series, x, y, and the axes' own labels, which carry the
    units. The NPZ holds each image as drawn, its extent, and a text array of what it is.
    """
    rows = [row for number, axes in enumerate(figure.axes, 1) for row in _points(number, axes)]
    images = {
        f"panel{number}_image{k}": _rounded(np.asarray(image.get_array()), IMAGE_DIGITS)
        for number, axes in enumerate(figure.axes, 1)
        for k, image in enumerate(axes.images, 1)
    }
    written = []
    stem.parent.mkdir(parents=True, exist_ok=True)
    if rows:
        path = stem.with_suffix(".csv")
        text = io.StringIO()
        writer = csv.writer(text)
        writer.writerow(["panel", "series", "x", "y", "x_label", "y_label"])
        writer.writerows(rows)
        content = text.getvalue().encode("utf-8")
        replace_file(path, lambda file: file.write_bytes(content))
        written.append(path)
    if images:
        path = stem.with_suffix(".npz")
        images["panel_titles"] = np.array([axes.get_title() for axes in figure.axes])
        replace_file(path, lambda file: np.savez_compressed(file, **images))  # type: ignore[arg-type]
        written.append(path)
    return written


def _points(panel: int, axes: Axes) -> list[list[object]]:
    labels = [axes.get_xlabel(), axes.get_ylabel()]
    series: list[tuple[str, np.ndarray]] = []
    for line in axes.lines:
        # Straight helper lines (axvline) are given in mixed coordinates and are no data.
        if line.get_transform() == axes.transData:
            series.append((str(line.get_label()), np.asarray(line.get_xydata())))
    for collection in axes.collections:
        offsets = np.asarray(collection.get_offsets())
        if offsets.ndim == 2 and len(offsets) > 1 and offsets.shape[1] == 2:
            series.append((str(collection.get_label()), offsets))
    for container in axes.containers:
        if isinstance(container, BarContainer):
            series.append((str(container.get_label()), _bars(container)))
    scales = (axes.get_xscale(), axes.get_yscale())
    return [
        [panel, name, x, y, *labels]
        for name, points in series
        for x, y in zip(*map(_texts, points.reshape(-1, 2).T, scales), strict=True)
    ]


def _bars(container: BarContainer) -> np.ndarray:
    """Return the middle of each bar and how long it is, the length where the axis measures it."""
    if container.orientation == "horizontal":
        ends = [(b.get_width(), b.get_y() + b.get_height() / 2) for b in container.patches]
    else:
        ends = [(b.get_x() + b.get_width() / 2, b.get_height()) for b in container.patches]
    return np.array(ends)


def _texts(values: np.ndarray, scale: str) -> list[str]:
    """Write numbers as far as they mean something: to `DIGITS` of the largest, or on a logarithmic
    axis of each. Another machine's last bits are left out."""
    if scale == "linear":
        values = _rounded(values, DIGITS)
    return [f"{value:.{DIGITS}g}" for value in values]


def _rounded(values: np.ndarray, digits: int) -> np.ndarray:
    """Round to digits of the largest number; whole numbers are left as they are."""
    known = np.abs(values[np.isfinite(values)])
    if values.dtype.kind != "f" or not known.size or known.max() == 0:
        return values
    return np.round(values, digits - 1 - int(np.floor(np.log10(known.max())))) + 0.0  # no -0
