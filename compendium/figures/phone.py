"""A second rendering of a figure for narrow screens, whose text is as large as that of the page."""

from __future__ import annotations

import pickle
import textwrap
import warnings
from collections.abc import Iterator
from io import BytesIO
from itertools import combinations
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec, SubplotSpec
from matplotlib.legend import Legend
from matplotlib.text import Text
from matplotlib.transforms import Bbox, ScaledTranslation
from PIL import Image

from microlib._common import replace_file

__all__ = ["DPI", "LEAST", "keep_narrow", "narrow", "touching_texts"]

#: Smallest text of the second rendering, points, which the page shows as large as its own text.
LEAST = 12.0
#: Resolution, px per inch: one and a half for each px of the page where 12 points are 16 px. With
#: two, chapter 5 would weigh 2 MB.
DPI = 144
#: Width, inches. A phone of 390 px has 358 px beside the margins of the page, which are as many
#: inches at 96 px each.
WIDTH = 3.73
#: How far something may stand out, inches: the layout rounds.
TOO_FAR = 0.03
#: Height of a stacked diagram, inches: three of them are seen at once on a phone of 844 px.
HEIGHT = 2.9
#: A diagram that is drawn to scale and gets lower than this has no room for its texts, inches.
LOWEST = 1.5
#: Mean width of a letter over the size of the text.
_LETTER = 0.53


def keep_narrow(figure: Figure, path: Path) -> None:
    """Write the second rendering of a figure as WebP."""
    drawn = narrow(figure)
    drawn.draw_without_rendering()
    drawn.set_layout_engine("none")  # its panels are where they should be
    drawn.set_dpi(DPI)
    canvas = FigureCanvasAgg(drawn)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    data = BytesIO()
    if any(axes.images for axes in drawn.axes):
        picture.save(data, "WEBP", quality=60, method=3)
    else:  # a drawing has few colors
        few = picture.quantize(64, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
        few.convert("RGB").save(data, "WEBP", lossless=True, method=2)
    replace_file(path, lambda file: file.write_bytes(data.getvalue()))


def narrow(figure: Figure) -> Figure:
    """
    Return a copy of a figure for a narrow screen, with no text below `LEAST`.

    Panels that stand side by side are put below each other and legends below their panels. Where
    texts then overlap or stand out, as in a drawing with labels at fixed places, the copy has the
    panels and the width of the figure: a reader scrolls it from side to side.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        A figure with constrained layout.

    Returns
    -------
    matplotlib.figure.Figure
    """
    wide = _copy(figure)
    if any(not axes.axison and axes.texts and not axes.images for axes in wide.axes):
        return wide
    stacked = _copy(figure)
    _stack(stacked)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)  # of a layout that has no room
        try:
            stacked.draw_without_rendering()
        except UserWarning:
            return wide
    to_scale = [axes for axes in stacked.axes if not _is_bare(axes) and axes.get_aspect() != "auto"]
    if any(axes.bbox.height < LOWEST * stacked.dpi for axes in to_scale):
        return wide
    ink = stacked.get_tightbbox()
    narrow_enough = ink.x0 > -TOO_FAR and ink.x1 < WIDTH + TOO_FAR
    more = len(_overlaps(stacked))
    if narrow_enough and more:
        wide.draw_without_rendering()
        more -= len(_overlaps(wide))
    return stacked if narrow_enough and more <= 0 else wide


def touching_texts(figure: Figure) -> list[tuple[str, str]]:
    """Return the pairs of texts of a figure that lie on each other; it is not drawn itself.

    A figure that was drawn before has other ticks when its size changes.
    """
    copy = _same(figure)
    copy.draw_without_rendering()
    return _overlaps(copy)


def _same(figure: Figure) -> Figure:
    copy: Figure = pickle.loads(pickle.dumps(figure))
    plt.close(copy)  # it is not to be shown
    return copy


def _copy(figure: Figure) -> Figure:
    """Return a copy without small texts."""
    copy = _same(figure)
    for text in copy.findobj(Text):
        if float(text.get_fontsize()) < LEAST:
            text.set_fontsize(LEAST)
    for axes in copy.axes:
        axes.tick_params(which="both", labelsize=LEAST)
    return copy


def _is_bare(axes: Axes) -> bool:
    """Whether a panel is a picture without numbers at its sides."""
    return not axes.axison or not (len(axes.get_xticks()) or len(axes.get_yticks()))


def _stack(figure: Figure) -> None:
    """Put the panels of a figure below each other, and legends below them."""
    panels = [axes for axes in figure.axes if not hasattr(axes, "_colorbar")]
    panels.sort(key=lambda axes: (_place(axes).rowspan.start, _place(axes).colspan.start))
    beside = max(_place(axes).get_gridspec().ncols for axes in panels)
    bare = all(map(_is_bare, panels))
    columns = min(beside, 2 if bare else 1)
    if len(panels) == 2 * beside and all(axes.images for axes in panels):
        # Pictures in pairs, one below the other, are put side by side.
        panels = [
            axes for pair in zip(panels[:beside], panels[beside:], strict=True) for axes in pair
        ]
    if beside > 1:
        for axes in panels:
            _label(axes, panels)
    for legend in figure.legends[:]:
        legend.remove()
        _write_legend(figure, legend, loc="outside lower center")
    for axes in panels:
        _wrap(axes, WIDTH / columns)
        main = axes.get_legend()
        for legend in [one for one in axes.get_children() if isinstance(one, Legend)]:
            legend.remove()
            if legend is main:
                _write_legend(axes, legend, loc="upper center")
            else:
                _write_legend(figure, legend, loc="outside upper center")
    least = HEIGHT if beside > 1 else max(HEIGHT, panels[0].bbox.height / figure.dpi)
    heights = [_height(axes, WIDTH / columns, least) for axes in panels]
    rows = [max(heights[k : k + columns]) for k in range(0, len(panels), columns)]
    grid = GridSpec(len(rows), columns, figure=figure, height_ratios=rows)
    for k, axes in enumerate(panels):
        axes.set_subplotspec(grid[k // columns, k % columns])
    figure.set_size_inches(WIDTH, sum(rows) + sum(map(_inches, figure.legends)))
    figure.draw_without_rendering()
    for axes in panels:
        if below := axes.get_legend():
            _put_below(axes, below)


def _place(axes: Axes) -> SubplotSpec:
    place = axes.get_subplotspec()
    if place is None:
        raise ValueError("axes of a figure must stand in a grid, got axes at a fixed place")
    return place


def _label(axes: Axes, panels: list[Axes]) -> None:
    """Give an axis the numbers and the name that it shares with a panel beside or below it."""
    for name in ("x", "y"):
        shared = getattr(axes, f"get_shared_{name}_axes")()
        others = [one for one in panels if one is not axes and shared.joined(one, axes)]
        if not others:
            continue
        if name == "x":
            axes.tick_params(labelbottom=True)
        else:
            axes.tick_params(labelleft=True)
        if not getattr(axes, f"get_{name}label")():
            names = [text for one in others if (text := getattr(one, f"get_{name}label")())]
            getattr(axes, f"set_{name}label")(names[0] if names else "")


def _height(axes: Axes, width: float, least: float) -> float:
    """Return how high a panel should be with its texts, inches: `least` if it has no scale."""
    names = (axes.title, axes.xaxis.label)
    texts = sum(_inches(text) + 0.05 for text in names if text.get_text()) + 0.25 * axes.axison
    if legend := axes.get_legend():
        texts += _inches(legend)
    if axes.name == "3d":
        return width + texts
    if axes.get_aspect() == "auto":
        return least + texts
    bars = [one for one in axes.figure.axes if hasattr(one, "_colorbar")]
    beside = any(one._colorbar.orientation == "vertical" for one in bars)
    inner = width - 0.75 * (not _is_bare(axes)) - 0.95 * beside
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    return inner * abs(high - low) / abs(right - left) * float(axes.get_aspect()) + texts


def _inches(artist: Artist) -> float:
    """Return how high a text or a legend is."""
    return artist.get_window_extent().height / artist.figure.dpi


def _wrap(axes: Axes, width: float) -> None:
    """Break titles and names of axes that are longer than their panel."""
    letters = int(72 * (width - 0.4) / (_LETTER * LEAST))
    for text in (axes.title, axes.xaxis.label, axes.yaxis.label):
        if "$" not in text.get_text() or len(text.get_text()) > letters:
            lines = [textwrap.fill(line, letters) for line in text.get_text().split("\n")]
            text.set_text("\n".join(lines))


def _write_legend(where: Axes | Figure, legend: Legend, *, loc: str) -> None:
    """Write a legend anew, in as many columns as the width has room for."""
    labels = [text.get_text() for text in legend.get_texts()]
    # Its line and gaps; a legend that is wider than the panel would press it together.
    wide = 0.75 + max(map(len, labels)) * _LETTER * LEAST / 72
    where.legend(  # type: ignore[call-overload]
        handles=legend.legend_handles,
        labels=labels,
        title=legend.get_title().get_text() or None,
        ncols=int(np.clip((WIDTH - 0.7) / wide, 1, len(labels))),
        loc=loc,
        fontsize=LEAST,
        title_fontsize=LEAST,
        columnspacing=1.0,
    )


def _put_below(axes: Axes, legend: Legend) -> None:
    """Put a legend below the numbers and the name of the axis, however high the panel gets."""
    texts = axes.xaxis.get_tightbbox()
    depth = max(0.0, axes.bbox.y0 - texts.y0) / axes.figure.dpi if texts else 0.0
    down = ScaledTranslation(0, -depth, axes.figure.dpi_scale_trans)
    legend.set_loc("upper center")
    legend.set_bbox_to_anchor((0.5, 0), transform=axes.transAxes + down)


def _overlaps(figure: Figure) -> list[tuple[str, str]]:
    """Return the pairs of texts of a drawn figure that lie on each other."""
    # The box of a text is higher than its letters.
    least = 0.25 * LEAST / 72 * figure.dpi
    found = []
    for (one, a), (other, b) in combinations(_text_boxes(figure), 2):
        shared = Bbox.intersection(a, b)
        if shared is not None and min(shared.width, shared.height) > least:
            found.append((one, other))
    return found


def _text_boxes(figure: Figure) -> Iterator[tuple[str, Bbox]]:
    """Yield the texts that are drawn and their places, px."""
    hidden: set[Text] = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
                if not low <= tick.get_loc() <= high:
                    hidden |= {tick.label1, tick.label2}
            if not (axes.axison and axis.get_visible()):
                hidden |= set(axis.findobj(Text))
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip() and text not in hidden:
            box = text.get_window_extent()
            if np.isfinite(box.bounds).all():
                yield text.get_text(), box
