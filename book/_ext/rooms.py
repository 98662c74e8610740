"""Who imports whom, read from the code and drawn.

``{rooms} library`` draws the packages of `microlib` with an arrow from each to those it imports,
and lists them with the first line of their docstrings; ``{rooms} house`` draws the folders of the
repository. Nothing is typed here that an import could tell.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from pathlib import Path

import nbformat
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).resolve().parents[2]
COMMON = "_common"
FOLDERS = ("microlib", "compendium", "benchmarks", "notebooks", "book")
# Sizes of the drawing, in units of its own; a phone shows three columns at four fifths.
WIDTH, HEIGHT, GAP, ROW, EDGE = 118, 32, 44, 46, 4

#: Who imports whom.
Graph = dict[str, set[str]]


def library_graph() -> Graph:
    """Return the packages of the library, each with those that it imports."""
    graph: Graph = {}
    for path in sorted((ROOT / "microlib").rglob("*.py")):
        package = path.relative_to(ROOT / "microlib").with_suffix("").parts[0]
        if package == "__init__":
            continue
        parts = [name.split(".") for name in imported(path.read_text(encoding="utf-8"))]
        others = {part[1] for part in parts if part[0] == "microlib" and len(part) > 1}
        graph.setdefault(package, set()).update(others - {package})
    return graph


def house_graph() -> Graph:
    """Return the folders that hold code, each with those whose code it imports."""
    graph: Graph = {}
    for folder in FOLDERS:
        sources = [p.read_text(encoding="utf-8") for p in (ROOT / folder).rglob("*.py")]
        sources += [code_of(p) for p in (ROOT / folder).glob("[0-9]*.ipynb") if folder != "book"]
        first = {name.split(".")[0] for source in sources for name in imported(source)}
        graph[folder] = first & set(FOLDERS) - {folder}
    return graph


def imported(source: str) -> set[str]:
    """Return the dotted names that a source imports, as module.name for a name of a module."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found


def code_of(notebook: Path) -> str:
    """Return the Python of a notebook, without the commands to IPython."""
    cells = nbformat.read(notebook, as_version=4).cells
    lines = "\n".join(cell.source for cell in cells if cell.cell_type == "code").splitlines()
    return "\n".join(line for line in lines if not line.startswith("%"))


@dataclass(frozen=True)
class Layout:
    """Where the boxes stand and through which points the arrows go: (column, row)."""

    boxes: dict[str, tuple[float, float]]
    arrows: list[list[tuple[float, float]]]
    columns: int
    rows: int


def lay_out(graph: Graph) -> Layout:
    """Put each name one column to the left of what it imports, so that all arrows point right."""
    linked = {name for name, others in graph.items() if others} | set().union(*graph.values())
    level: dict[str, int] = {}
    while len(level) < len(linked):
        ready = {name for name in linked - level.keys() if graph[name] <= level.keys()}
        if not ready:
            raise ValueError(f"these import each other: {sorted(linked - level.keys())}")
        level |= {name: 1 + max((level[o] for o in graph[name]), default=-1) for name in ready}
    top = max(level.values(), default=0)
    columns: list[list[str]] = [[] for _ in range(top + 1)]
    for name in sorted(linked):
        columns[top - level[name]].append(name)
    # An arrow that passes a column is given a place of its own there, so that it crosses no box.
    paths = []
    for name in sorted(linked):
        for other in sorted(graph[name]):
            between = range(top - level[name] + 1, top - level[other])
            passing = [f"{name}→{other}→{column}" for column in between]
            for column, place in zip(between, passing, strict=True):
                columns[column].append(place)
            paths.append([name, *passing, other])
    steps = [pair for path in paths for pair in pairwise(path)]
    rows = max((len(column) for column in columns), default=0)
    place: dict[str, tuple[float, float]] = {}
    for sweep in range(8):
        for x, column in list(enumerate(columns))[:: 1 if sweep % 2 else -1]:
            beside: dict[str, list[float]] = {name: [] for name in column}
            for pair in steps:
                for name, other in (pair, pair[::-1]):
                    if name in beside and other in place:
                        beside[name].append(place[other][1])
            # Each as high as the mean of its neighbors, which leaves the fewest crossings.
            column.sort(key=lambda n: sum(beside[n]) / len(beside[n]) if beside[n] else 0.0)
            for row, name in enumerate(column):
                place[name] = (x, row + (rows - len(column)) / 2)
    alone = sorted(graph.keys() - linked)
    for k, name in enumerate(alone):
        place[name] = (k % len(columns), rows + k // len(columns))
    return Layout(
        boxes={name: place[name] for name in graph},
        arrows=[[place[name] for name in path] for path in paths],
        columns=len(columns),
        rows=rows - (-len(alone) // len(columns)),
    )


def draw(graph: Graph, *, below: str = "") -> str:
    """Return the drawing as SVG in the color of the text around it; `below` is one wide box."""
    layout = lay_out(graph)
    width = layout.columns * (WIDTH + GAP) - GAP + 2 * EDGE
    height = (layout.rows + bool(below)) * ROW - (ROW - HEIGHT) + 2 * EDGE
    parts = [
        f'<svg class="rooms" viewBox="0 0 {width:g} {height:g}" role="img" '
        f'style="width: 100%; max-width: {1.3 * width:g}px; margin-bottom: 1rem" '
        f'aria-label="{escape(describe(graph))}">',
        '<g fill="none" stroke="currentColor">',
    ]
    for path in layout.arrows:
        x, y = corner(path[-1])
        tip = f"M{x:g} {y + HEIGHT / 2:g}l-8 -4v8z"
        parts.append(f'<path d="{curve(path)}"/><path d="{tip}" fill="currentColor"/>')
    texts = []
    for name, place in layout.boxes.items():
        x, y = corner(place)
        parts.append(f'<rect x="{x:g}" y="{y:g}" width="{WIDTH}" height="{HEIGHT}" rx="5"/>')
        texts.append(f'<text x="{x + WIDTH / 2:g}" y="{y + HEIGHT / 2:g}">{escape(name)}</text>')
    if below:
        x, y = corner((0, layout.rows))
        parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width - 2 * EDGE:g}" height="{HEIGHT}" rx="5" '
            'stroke-dasharray="5 3"/>'
        )
        texts.append(f'<text x="{width / 2:g}" y="{y + HEIGHT / 2:g}">{escape(below)}</text>')
    style = 'fill="currentColor" font-size="15" text-anchor="middle" dominant-baseline="central"'
    return "".join([*parts, f"</g><g {style}>", *texts, "</g></svg>"])


def corner(place: tuple[float, float]) -> tuple[float, float]:
    return EDGE + place[0] * (WIDTH + GAP), EDGE + place[1] * ROW


def curve(path: list[tuple[float, float]]) -> str:
    """Return an arrow as SVG: from a box's right side, straight past boxes, to a left side."""
    x, y = corner(path[0])
    text = f"M{x + WIDTH:g} {y + HEIGHT / 2:g}"
    for step, place in enumerate(path[1:], 1):
        before, x, y = x + WIDTH, *corner(place)
        middle = (before + x) / 2
        start = corner(path[step - 1])[1] + HEIGHT / 2
        text += f"C{middle:g} {start:g} {middle:g} {y + HEIGHT / 2:g} {x:g} {y + HEIGHT / 2:g}"
        if step < len(path) - 1:
            text += f"H{x + WIDTH:g}"
    return text


def describe(graph: Graph) -> str:
    """Return the drawing in words, for those who do not see it."""
    said = [f"{name} imports {listed(others)}" for name, others in graph.items() if others]
    alone = [name for name, others in graph.items() if not others]
    return "; ".join([*said, f"{listed(alone)}: no import of another"]) + "."


def listed(names: Iterable[str]) -> str:
    *others, last = sorted(names)
    return f"{', '.join(others)} and {last}" if others else last


class Rooms(SphinxDirective):
    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        if self.arguments[0] == "house":
            return [nodes.raw("", draw(house_graph()), format="html")]
        graph = library_graph()
        users = {name for name, others in graph.items() if COMMON in others}
        subjects = {n: others - {COMMON} for n, others in graph.items() if n != COMMON}
        without = subjects.keys() - users
        below = f"{COMMON}, for all" + (f" except {listed(without)}" if without else "")
        drawing = nodes.raw("", draw(subjects, below=below), format="html")
        from thesis import table

        rows = [self.row(name, subjects[name]) for name in sorted(subjects)]
        head = ["Package", "What it is for", "Imports"]
        return [drawing, table(head, rows, classes=["whole-names"])]

    def row(self, name: str, others: set[str]) -> list[nodes.Node | str]:
        uri = self.env.app.builder.get_relative_uri(self.env.docname, "api")
        link = nodes.reference("", "", internal=True, refuri=f"{uri}#microlib-{name}")
        link += nodes.literal("", name)
        path = ROOT / "microlib" / name
        path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        return [link, text.splitlines()[0], ", ".join(sorted(others))]


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("rooms", Rooms)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
