"""Write down what a figure draws, and compare it with what it drew before.

``tests/compendium/drawn`` holds one text for each drawing of ``compendium.figures``, drawn from the
small inputs of ``tests/compendium/figure_cases.py``: every artist in the order in which it is
drawn, with its data, place, color and words. ``make drawn`` writes the texts anew, and pictures of
the same drawings into ``build/drawn``: what changed is to be looked at there.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import Collection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import FancyBboxPatch, Patch, StepPatch
from matplotlib.patheffects import withStroke
from matplotlib.spines import Spine
from matplotlib.text import Annotation, Text
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from tests.snapshots import FEW, compare, numbers

FOLDER = Path(__file__).parent / "compendium" / "drawn"
PICTURES = Path("build") / "drawn"


def describe(figure: Figure) -> str:
    """Return a text of everything that a figure draws."""
    size = " ".join(map(_plain, figure.get_size_inches()))
    lines = [f"figure of {size} inches, {_plain(figure.dpi)} dpi"]
    for number, axes in enumerate(figure.axes, 1):
        lines += ["", f"panel {number}: {axes.name} {_place(axes)}", *_indent(_panel(axes))]
    rest = [one for one in figure.get_children() if one not in figure.axes]
    if own := [line for one in rest if one is not figure.patch for line in _artist(one)]:
        lines += ["", "around the panels", *_indent(own)]
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _indent(lines: Iterable[str]) -> list[str]:
    return [f"  {line}" for line in lines]


def _place(axes: Axes) -> str:
    spec = axes.get_subplotspec()
    if spec is None:
        return "at a place of its own"
    grid = spec.get_gridspec()
    ratios = [grid.get_height_ratios(), grid.get_width_ratios()]
    rows, cols = ([_plain(each) for each in one] for one in ratios)
    place = f"{spec.rowspan.start}-{spec.rowspan.stop}, {spec.colspan.start}-{spec.colspan.stop}"
    return f"at {place} of rows {' '.join(rows)} and columns {' '.join(cols)}"


def _panel(axes: Axes) -> Iterator[str]:
    for side, title in (("left", axes._left_title), ("", axes.title), ("right", axes._right_title)):  # type: ignore[attr-defined]
        if title.get_text():
            pad = _plain(axes.titleOffsetTrans.transform((0, 0))[1] / axes.figure.dpi * 72)  # type: ignore[attr-defined]
            yield f"title {side} {title.get_text()!r} size={_plain(title.get_fontsize())} pad={pad}"
    ground = _color(axes.get_facecolor())
    yield f"ground {ground} aspect={axes.get_aspect()} {axes.get_adjustable()}"
    if isinstance(axes, Axes3D):
        yield numbers("view", [axes.elev, axes.azim, *axes.get_box_aspect()])  # type: ignore[attr-defined]
    if axes.axison or isinstance(axes, Axes3D):
        yield from _axis("x", axes.xaxis)
        yield from _axis("y", axes.yaxis)
        if isinstance(axes, Axes3D):
            yield from _axis("z", axes.zaxis)
        seen = [name for name, spine in axes.spines.items() if spine.get_visible()]
        yield f"spines {' '.join(seen) or 'none'}"
    else:
        yield numbers("without axes, x", axes.get_xlim())
        yield numbers("without axes, y", axes.get_ylim())
    titles = (axes.title, axes._left_title, axes._right_title)  # type: ignore[attr-defined]
    furniture = (Spine, Axis)
    drawn = [
        one
        for one in axes.get_children()
        if not isinstance(one, furniture) and one not in titles and one is not axes.patch
    ]
    for one in sorted(drawn, key=lambda one: one.get_zorder()):  # as matplotlib draws them
        yield from _artist(one)


def _axis(name: str, axis: Axis) -> Iterator[str]:
    low, high = axis.get_view_interval()
    ends = axis.axes.__getattribute__(f"get_{name}lim")()
    label = axis.get_label()
    yield numbers(f"{name} {axis.get_scale()} from", ends)
    if not axis.get_visible():
        return
    yield f"  named {label.get_text()!r} size={_plain(label.get_fontsize())}"
    ticks = axis.get_major_ticks(len(axis.get_majorticklocs()))
    axis.get_majorticklabels()  # brings the texts up to date
    shown = [tick for tick in ticks if min(low, high) <= tick.get_loc() <= max(low, high)]
    yield numbers("  ticks", [tick.get_loc() for tick in shown], few=40)
    labels = [tick.label1 for tick in shown if tick.label1.get_visible()]
    looks = {f"{_plain(t.get_fontsize())} {_plain(t.get_rotation())}" for t in labels}
    texts = " ".join(repr(text.get_text()) for text in labels)
    yield f"  texts {texts} size, turn: {'; '.join(sorted(looks))}"
    minor = axis.get_minorticklocs()
    yield f"  minor {len(minor)} grid {any(line.get_visible() for line in axis.get_gridlines())}"


def _artist(one: Artist) -> Iterator[str]:
    if not one.get_visible():
        return
    if isinstance(one, Line2D):
        yield from _line(one)
    elif isinstance(one, Text):
        yield from _text(one)
    elif isinstance(one, Legend):
        yield from _legend(one)
    elif isinstance(one, AxesImage):
        yield from _image(one)
    elif isinstance(one, Collection):
        yield from _collection(one)
    elif isinstance(one, Patch):
        yield from _patch(one)
    else:
        yield type(one).__name__


def _frame(one: Artist) -> str:
    """Tell in what coordinates an artist stands, if not in those of its data."""
    if one.axes is None:
        return ""
    on_x, on_y = one.get_transform().contains_branch_seperately(one.axes.transData)
    return "" if on_x and on_y else f" data-x={on_x} data-y={on_y}"


def _name(one: Artist) -> str:
    label = str(one.get_label())
    return "" if label.startswith("_") or not label else f" {label!r}"


def _line(one: Line2D) -> Iterator[str]:
    look = f"{_color(one.get_color())} {one.get_linestyle()} {_plain(one.get_linewidth())}"
    look += f" {one.get_drawstyle()} {one.get_solid_capstyle()}"
    if str(one.get_marker()) != "None":
        look += f" marker={one.get_marker()} {_plain(one.get_markersize())}"
        look += f" {_color(one.get_markerfacecolor())} {_color(one.get_markeredgecolor())}"
        look += f" {_plain(one.get_markeredgewidth())}"
    yield f"line{_name(one)} {look} {_alpha(one)}{_frame(one)}"
    yield numbers("  x", one.get_xdata(orig=False))
    yield numbers("  y", one.get_ydata(orig=False))


def _text(one: Text) -> Iterator[str]:
    if not one.get_text() and not isinstance(one, Annotation):
        return
    look = f"{_color(one.get_color())} {_plain(one.get_fontsize())} {one.get_fontweight()}"
    look += f" {one.get_ha()} {one.get_va()} {_plain(one.get_rotation())} {_alpha(one)}"
    yield f"text {one.get_text()!r} {look}{'' if isinstance(one, Annotation) else _frame(one)}"
    for effect in one.get_path_effects():
        if isinstance(effect, withStroke):
            yield f"  stroke {sorted(effect._gc.items())}"  # type: ignore[attr-defined]
    if not isinstance(one, Annotation):
        yield numbers("  at", one.get_position())
        return
    yield numbers(f"  to ({one.xycoords})", one.xy)
    yield numbers(f"  from ({one.anncoords})", one.xyann)
    if one.arrowprops is not None:
        yield f"  arrow {sorted((key, str(value)) for key, value in one.arrowprops.items())}"


def _legend(one: Legend) -> Iterator[str]:
    place = f"{one._outside_loc or ''} {one._loc} of {one._ncols}"  # type: ignore[attr-defined]
    title = one.get_title().get_text()
    frame = one.get_frame_on()
    yield f"legend {title!r} at {place} columns, frame={frame} {one._alignment}"  # type: ignore[attr-defined]
    anchor = one.get_bbox_to_anchor()
    if anchor is not None and one.axes is not None:
        yield numbers("  anchor", one.axes.transAxes.inverted().transform(anchor.p0))
    yield f"  gaps {_plain(one.borderaxespad)} {_plain(one.columnspacing)}"  # type: ignore[attr-defined]
    for handle, text in zip(one.legend_handles, one.get_texts(), strict=True):
        look = next(iter(_artist(handle)), "nothing") if handle is not None else "nothing"
        yield f"  {text.get_text()!r} {_plain(text.get_fontsize())}: {look}"


def _image(one: AxesImage) -> Iterator[str]:
    array = np.ma.asarray(one.get_array())
    shape = "x".join(map(str, np.shape(array)))
    yield f"image of {shape} {one.cmap.name} {one.get_interpolation()} {one.origin} {_alpha(one)}"
    yield numbers("  levels", one.get_clim())
    yield numbers("  extent", one.get_extent())
    yield numbers("  values", np.ma.filled(np.ma.asarray(array, float), np.nan))
    if array.ndim == 2 and len(levels := np.unique(np.ma.compressed(array))) <= FEW:
        yield f"  in {' '.join(_color(color) for color in one.cmap(one.norm(levels)))}"


def _collection(one: Collection) -> Iterator[str]:
    if isinstance(one, Poly3DCollection):
        # As they were given: the projected ones are sorted by their distance.
        faces = np.asarray(one._faces)
        yield f"solid of {len(faces)} faces {_alpha(one)}{_name(one)}"
        for axis, values in zip("xyz", np.moveaxis(faces, -1, 0), strict=True):
            yield numbers(f"  {axis}", values)
        yield numbers("  colors", one._facecolor3d)  # type: ignore[attr-defined]
        if one.get_array() is not None:
            yield numbers(f"  {one.cmap.name}", np.asarray(one.get_array()))
        return
    colors, edges = (
        " ".join(dict.fromkeys(map(_color, each)))
        for each in (one.get_facecolor(), one.get_edgecolor())
    )
    widths = " ".join(map(_plain, np.atleast_1d(one.get_linewidth())))
    look = f"fill {colors} edge {edges} {widths} {_alpha(one)}"
    yield f"{type(one).__name__}{_name(one)} {look}{_frame(one)}"
    if one.get_array() is not None:
        yield numbers(f"  {one.cmap.name} of", one.get_clim())
        yield numbers("  values", np.ma.filled(np.ma.asarray(one.get_array(), float), np.nan))
    if one.get_offset_transform().is_affine and np.any(one.get_offsets()):
        for axis, values in zip("xy", np.asarray(one.get_offsets()).T, strict=True):
            yield numbers(f"  {axis}", values)
        yield numbers("  sizes", getattr(one, "get_sizes", list)())
        return
    paths = [path.vertices for path in one.get_paths() if len(path.vertices)]
    if len(paths) > FEW:
        paths = [np.concatenate(paths)]
    for vertices in paths:
        for axis, values in zip("xy", vertices.T, strict=True):
            yield numbers(f"  path {axis}", values)


def _patch(one: Patch) -> Iterator[str]:
    look = f"{_color(one.get_facecolor())} {_color(one.get_edgecolor())} fill={one.get_fill()}"
    look += f" {_plain(one.get_linewidth())} {one.get_linestyle()} {one.get_hatch() or ''}"
    yield f"{type(one).__name__}{_name(one)} {look} {_alpha(one)}{_frame(one)}"
    if isinstance(one, FancyBboxPatch):
        style = one.get_boxstyle()
        kind = sorted((key, _plain(value)) for key, value in vars(style).items())
        yield numbers(f"  {type(style).__name__} {kind}", one.get_bbox().bounds)
    elif isinstance(one, StepPatch):
        yield numbers("  values", one.get_data().values)
        yield numbers("  edges", one.get_data().edges)
    else:
        corners = one.get_patch_transform().transform(one.get_path().vertices)
        for axis, values in zip("xy", np.asarray(corners).T, strict=True):
            yield numbers(f"  {axis}", values)


def _alpha(one: Artist) -> str:
    alpha = one.get_alpha()
    return "" if alpha is None else f"alpha={_plain(float(alpha))}"


def _color(color: object) -> str:
    return (
        str(color) if isinstance(color, str) and color in ("none", "auto") else to_hex(color, True)
    )  # type: ignore[arg-type]


def _plain(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float | int | np.number) else str(value)


def main() -> int:
    from tests.compendium.figure_cases import CASES, draw

    mpl.use("agg")
    FOLDER.mkdir(exist_ok=True)
    for old in FOLDER.glob("*.txt"):
        if old.stem not in CASES:
            old.unlink()
    for name in CASES:
        text = draw(name, PICTURES)
        path = FOLDER / f"{name}.txt"
        if not path.exists() or compare(path.read_text(encoding="utf-8"), text):
            path.write_text(text, encoding="utf-8")
            print(f"drawn anew, to be looked at: {name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
