"""The rendering for phones: narrow, legible, and with all that the figure has."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from compendium.figures import use_style
from compendium.figures.phone import DPI, LEAST, WIDTH, keep_narrow, narrow


@pytest.fixture(autouse=True)
def style() -> Iterator[None]:
    with plt.rc_context():
        use_style()
        yield
    plt.close("all")


def sizes(figure: Figure) -> list[float]:
    return [text.get_fontsize() for text in figure.findobj(Text) if text.get_text()]


def draw_two() -> tuple[Figure, list[Axes]]:
    figure, axes = plt.subplots(1, 2, figsize=(7.2, 3.4), sharey=True)
    for name, one in zip(("left", "right"), axes, strict=True):
        one.plot([0, 1], [0, 1], label="a curve with a long name")
        one.plot([0, 1], [1, 0], label="another curve")
        one.set(title=name, xlabel="time (s)")
    axes[0].set(ylabel="error (px)")
    axes[0].legend(fontsize=8)
    return figure, list(axes)


def test_panels_are_put_below_each_other_and_legends_below_them() -> None:
    figure, _ = draw_two()
    small = narrow(figure)
    assert small.get_figwidth() == WIDTH
    small.draw_without_rendering()
    assert small.get_tightbbox().width <= WIDTH + 0.06
    left, right = small.axes
    assert [one.get_title() for one in small.axes] == ["left", "right"]
    legend = left.get_legend()
    assert legend is not None
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == ["a curve with a long name", "another curve"]
    # From the top: a panel, the name of its axis, its legend, the title of the next.
    heights = [
        left.bbox.y0,
        left.xaxis.label.get_window_extent().y1,
        legend.get_window_extent().y1,
        right.title.get_window_extent().y1,
        right.bbox.y1,
    ]
    assert heights == sorted(heights, reverse=True)
    assert min(one.bbox.height / small.dpi for one in small.axes) > 1.5
    # What the right panel shared with the left one it has itself now.
    assert right.get_ylabel() == "error (px)"
    assert any(label.get_text() for label in right.get_yticklabels() if label.get_visible())
    assert min(sizes(small)) >= LEAST


def test_the_figure_itself_stays_as_it_is() -> None:
    figure, axes = draw_two()
    before = (figure.get_size_inches().tolist(), sizes(figure), plt.get_fignums())
    narrow(figure)
    assert (figure.get_size_inches().tolist(), sizes(figure), plt.get_fignums()) == before
    assert axes[1].get_subplotspec().get_gridspec().ncols == 2  # type: ignore[union-attr]
    assert axes[1].get_ylabel() == ""


def draw_labels(axes: Axes) -> None:
    axes.set_axis_off()
    for x in range(4):
        axes.text(x / 4, 0.5, "a box of words", fontsize=8)


def draw_crowded(axes: Axes) -> None:
    axes.bar(["fills the range", "small part", "cylinder", "cone", "step"], range(5))


def draw_flat(axes: Axes) -> None:
    axes.plot([0, 10], [0, 1])
    axes.set_title("to scale", fontsize=8)
    axes.set_aspect("equal")


@pytest.mark.parametrize("draw", [draw_labels, draw_crowded, draw_flat])
def test_what_would_be_pressed_together_keeps_its_width(draw: object) -> None:
    figure, axes = plt.subplots(figsize=(9, 3))
    draw(axes)  # type: ignore[operator]
    small = narrow(figure)
    assert small.get_figwidth() == 9
    assert min(sizes(small)) >= LEAST


def test_pictures_in_pairs_stand_side_by_side() -> None:
    figure, axes = plt.subplots(2, 3, figsize=(7.2, 4))
    for k, one in enumerate(axes.flat):
        one.imshow(np.eye(9))
        one.set(xticks=[], yticks=[], title=f"{k}")
    small = narrow(figure)
    small.draw_without_rendering()
    places = {one.get_title(): one.bbox for one in small.axes}
    for above, below in (("0", "3"), ("1", "4"), ("2", "5")):
        assert abs(places[above].y0 - places[below].y0) < 0.1 * small.dpi
        assert places[above].x1 < places[below].x0
    assert places["1"].y1 < places["0"].y0


def test_the_smallest_text_is_as_high_in_the_picture_as_stated(tmp_path: Path) -> None:
    figure, axes = plt.subplots(figsize=(7.2, 3))
    axes.imshow(np.full((3, 8), 255.0), vmin=0, vmax=255)
    axes.text(4, 1, "H", fontsize=6)
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    keep_narrow(figure, tmp_path / "one.webp")
    with Image.open(tmp_path / "one.webp") as picture:
        assert picture.width == round(WIDTH * DPI)
        dark = np.asarray(picture.convert("L")) < 128
    # Capitals of the font, DejaVu Sans, are 0.729 of its size; an edge is known to half a px.
    assert dark.any(axis=1).sum() == pytest.approx(0.729 * LEAST * DPI / 72, abs=1)
