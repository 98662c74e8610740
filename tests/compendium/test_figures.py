"""Every figure: it is drawn without a warning, keeps the data that it shows, and names its axes."""

from __future__ import annotations

import csv
import importlib
import pkgutil
import re
import warnings
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest
from matplotlib.axis import Axis

import compendium.figures
from compendium.figures import use_style
from compendium.figures.data import keep_data
from tests.compendium.figure_cases import CASES

#: What has no unit, as an axis names it.
PURE = (
    "grey value", "step", "frame", "loop gain g", "recomputed / printed",
    "modulus of the slowest pole",
)  # fmt: skip


def has_numbers(axis: Axis) -> bool:
    texts = [tick.label1.get_text() for tick in axis.get_major_ticks() if tick.label1.get_visible()]
    shown = axis.axes.axison and axis.get_visible()
    return shown and any(re.fullmatch(r"[−\d.,]+|\$.*\$", text) for text in texts)


@pytest.mark.parametrize("name", CASES)
def test_a_figure_keeps_what_it_shows_and_names_its_axes(name: str, tmp_path: Path) -> None:
    with mpl.rc_context(), warnings.catch_warnings():
        warnings.simplefilter("error")
        use_style()
        figure = CASES[name]()
        figure.canvas.draw()
    kept = {path.suffix: path for path in keep_data(figure, tmp_path / "kept")}
    assert (".npz" in kept) == any(axes.images for axes in figure.axes)
    # Panels with curves are in the table, by their numbers.
    curves = {
        str(k)
        for k, axes in enumerate(figure.axes, 1)
        if any(line.get_transform() == axes.transData for line in axes.lines)
    }
    if curves:
        with kept[".csv"].open(newline="", encoding="utf-8") as file:
            assert curves <= {row["panel"] for row in csv.DictReader(file)}
    for side in "xyz":
        axes = [one for each in figure.axes if (one := getattr(each, f"{side}axis", None))]
        names = {one.get_label().get_text() for one in axes} - {""}  # beside each other they share
        wrong = {one for one in names if not re.search(r"\(.+\)", one) and one not in PURE}
        assert not wrong, f"without a unit: {wrong}"
        assert names or not any(map(has_numbers, axes))
    plt.close("all")


def test_every_figure_has_a_case() -> None:
    # Of which others are made, or whose film, legend or rays test_figures_truth.py reads.
    parts = {"calibration.draw_detection", "servoing.draw_track", "surfaces.draw_labels"}
    names = set()
    for module in pkgutil.iter_modules(compendium.figures.__path__):
        made = vars(importlib.import_module(f"compendium.figures.{module.name}"))
        own = {name: made[name].__module__ for name in made if name.startswith("draw_")}
        names |= {f"{module.name}.{name}" for name in own if own[name].endswith(module.name)}
    drawn = {name.partition("-")[0] for name in CASES}
    assert names - drawn == parts | {"surfaces.draw_surface"}
