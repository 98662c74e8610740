"""The map from the thesis' equations, figures and tables to this book, and links along it.

- ``{map}`` with ``equation``, ``figure`` or ``table``: the map's rows of that kind, each linked to
  its place in the chapter and to the function behind it.
- Every displayed formula with a ``\\tag`` of the thesis gets an anchor and a link to its function.
- The page of a function that the map names links back to its equations, figures and tables.
- The page of a function that returns a class without a page of its own lists what it holds.
- A figure whose data were kept gets a link to them.
"""

from __future__ import annotations

import inspect
import re
import shutil
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, get_args, get_type_hints

import nbformat
from docutils import nodes
from numpydoc.docscrape import NumpyDocString
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from compendium import ledger

ROOT = Path(__file__).resolve().parents[2]
FIGURES = ROOT / "build" / "figures"
CAPTION = re.compile(r"\*\*(Figures?|Tables?) ([^*]+)\*\*")
INITIAL = re.compile(r"^(\s*(?:\.\. \[[\w-]+\] )?)([A-Z]\. [A-Z])")
TAG = re.compile(r"\\tag\{(\d\.\d+)\}")
TABLE = re.compile(r"^\(table-(\d)-(\d)\)=", flags=re.M)
# A number of an equation in brackets, or of a figure or table with its word.
MENTION = re.compile(
    r"\((?P<bare>\d\.\d+)\)|\b(?P<kind>Figure|Table|figure|table) (?P<number>\d\.\d+)(?!\.?\d)"
)
# Where a link would nest, or change what is quoted.
UNLINKED = (
    nodes.reference,
    nodes.title,
    nodes.caption,
    nodes.literal,
    nodes.literal_block,
    nodes.math,
    nodes.math_block,
    nodes.raw,
    nodes.comment,
    nodes.target,
    addnodes.desc_signature,
    addnodes.pending_xref,
)
# What an item of each kind can be said to be; a table's numbers have verdicts of their own.
STATES = {
    "equation": ("holds", "corrected", "definition"),
    "figure": ("redrawn", "stand-in"),
    "table": ("",),
}


@dataclass(frozen=True)
class Item:
    """An equation, figure or table of the thesis, as ``map.toml`` describes it."""

    id: str
    what: str
    functions: list[str]
    status: str = ""
    erratum: str = ""

    def __post_init__(self) -> None:
        if self.kind not in STATES or self.status not in STATES[self.kind]:
            raise ValueError(f"status of {self.id} cannot be {self.status!r}")
        if (self.status == "corrected") != bool(self.erratum):
            raise ValueError(f"{self.id} must name an erratum if and only if it is corrected")
        if self.erratum and self.erratum not in ledger.errata():
            raise ValueError(f"erratum of {self.id} must be one of errata.toml: {self.erratum!r}")

    @property
    def kind(self) -> str:
        return self.id.split("-")[0]

    @property
    def number(self) -> str:
        return self.id.partition("-")[2]


@cache
def read_map() -> dict[str, Item]:
    with (ROOT / "data" / "thesis" / "map.toml").open("rb") as file:
        return parse_map(tomllib.load(file))


def parse_map(entries: dict[str, dict[str, Any]]) -> dict[str, Item]:
    """Return the items by their ids; refuse a field that nothing here reads."""
    known = {field.name for field in fields(Item)} - {"id"}
    for name, entry in entries.items():
        if unknown := entry.keys() - known:
            raise ValueError(f"{name} has {', '.join(unknown)}; known are {', '.join(known)}")
    return {name: Item(id=name, **entry) for name, entry in entries.items()}


@cache
def find_items(notebooks: Path) -> dict[str, tuple[str, str]]:
    """Return where each item stands in the notebooks: its id, the notebook's stem, the anchor."""
    found: dict[str, tuple[str, str]] = {}
    for path in sorted(notebooks.glob("0[1-6]_*.ipynb")):
        for cell in nbformat.read(path, as_version=4).cells:
            figure = cell.metadata.get("mystnb", {}).get("figure", {})
            for number in captioned(figure.get("caption", "")):
                found.setdefault(f"figure-{number}", (path.stem, figure["name"]))
            if cell.cell_type == "markdown":
                items = [f"equation-{number}" for number in TAG.findall(cell.source)]
                items += [f"table-{a}.{b}" for a, b in TABLE.findall(cell.source)]
                for item in items:
                    found.setdefault(item, (path.stem, nodes.make_id(item)))
    return found


def captioned(caption: str) -> list[str]:
    """Return the thesis' figures that a caption names: ``Figures 5.6 to 5.8`` gives three."""
    match = CAPTION.match(caption)
    if not match or not match[1].startswith("Figure"):
        return []
    numbers = re.findall(r"\d\.\d+", match[2])
    if re.search(r"to|–", match[2]) and len(numbers) == 2:
        chapter, first = numbers[0].split(".")
        last = numbers[1].split(".")[1]
        return [f"{chapter}.{n}" for n in range(int(first), int(last) + 1)]
    return numbers


def link_to_function(name: str, docname: str) -> addnodes.pending_xref:
    shown = name.removeprefix("microlib.")
    reference = addnodes.pending_xref(
        "", refdomain="py", reftype="obj", reftarget=name, refdoc=docname, refwarn=True
    )
    reference += nodes.literal(shown, shown)
    return reference


class Map(SphinxDirective):
    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        kind = self.arguments[0]
        if kind not in STATES:
            raise self.error(f"the map has {', '.join(STATES)}, not {kind!r}")
        from thesis import table

        places = find_items(ROOT / "build" / "notebooks")
        rows = []
        for item in read_map().values():
            if item.kind != kind:
                continue
            label: nodes.Node = nodes.Text(
                f"({item.number})" if kind == "equation" else item.number
            )
            if item.id in places:
                stem, anchor = places[item.id]
                label = self.link(label, f"notebooks/{stem}", anchor)
            functions = nodes.inline()
            for k, name in enumerate(item.functions):
                functions += [nodes.Text(", ")] if k else []
                functions += link_to_function(name, self.env.docname)
            verdict: nodes.Node = nodes.Text(verdict_of(item))
            if item.erratum:
                verdict = self.link(verdict, "errata", f"erratum-{item.erratum}")
            rows.append([label, item.what, functions, verdict])
        return [table(["Number", "What", "In the library", "Verdict"], rows, classes=["map"])]

    def link(self, shown: nodes.Node, page: str, anchor: str) -> nodes.reference:
        uri = self.env.app.builder.get_relative_uri(self.env.docname, page)
        link = nodes.reference("", "", internal=True, refuri=f"{uri}#{nodes.make_id(anchor)}")
        link += shown
        return link


def verdict_of(item: Item) -> str:
    """Return an item's status, and for a table how many of its numbers have which verdict."""
    if item.kind != "table":
        return item.status
    chosen = [c.verdict for c in ledger.claims().values() if c.id.startswith(f"{item.id}/")]
    return ", ".join(f"{count} {verdict}" for verdict, count in Counter(chosen).most_common())


def link_formulas(app: Sphinx, doctree: nodes.document) -> None:
    """Give each formula of the thesis an anchor and, under it, a link to its function."""
    thesis = read_map()
    seen: set[str] = set()
    for block in list(doctree.findall(nodes.math_block)):
        numbers = [n for n in TAG.findall(block.astext()) if f"equation-{n}" in thesis]
        fresh = [n for n in numbers if n not in seen]
        if not fresh:
            continue
        seen.update(fresh)
        names = dict.fromkeys(f for n in fresh for f in thesis[f"equation-{n}"].functions)
        note = nodes.paragraph(classes=["equation-link"])
        note += nodes.Text("in code: ")
        for k, name in enumerate(names):
            note += [nodes.Text(", ")] if k else []
            note += link_to_function(name, app.env.docname)
        anchors = [nodes.target("", "", ids=[nodes.make_id(f"equation-{n}")]) for n in fresh]
        place = block.parent.index(block)
        block.parent.insert(place + 1, note)
        for anchor in anchors:
            block.parent.insert(place, anchor)


def link_numbers(app: Sphinx, doctree: nodes.document) -> None:
    """Make each mention of an equation, a figure or a table of the thesis lead to it."""
    places = find_items(ROOT / "build" / "notebooks")
    for text in list(doctree.findall(nodes.Text)):
        if any(isinstance(node, UNLINKED) for node in ancestors(text)):
            continue
        parts, end = [], 0
        plain = text.astext()
        for match in MENTION.finditer(plain):
            kind = (match["kind"] or "equation").lower()
            place = places.get(f"{kind}-{match['bare'] or match['number']}")
            if place is None:
                continue
            page = f"notebooks/{place[0]}"
            uri = app.builder.get_relative_uri(app.env.docname, page)
            address = f"{uri}#{nodes.make_id(place[1])}"
            link = nodes.reference("", "", internal=True, refuri=address, classes=["mention"])
            link += nodes.Text(match[0])
            parts += [nodes.Text(plain[end : match.start()]), link]
            end = match.end()
        if parts:
            text.parent.replace(text, [*parts, nodes.Text(plain[end:])])


def ancestors(node: nodes.Node) -> Iterator[nodes.Node]:
    while node.parent is not None:
        node = node.parent
        yield node


def link_data(app: Sphinx, doctree: nodes.document) -> None:
    """Put a link to the kept numbers under each figure that has them."""
    up = "../" * app.env.docname.count("/")
    for figure in doctree.findall(nodes.figure):
        files = [
            FIGURES / f"{name}{ending}"
            for name in figure.get("names", []) + figure.get("ids", [])
            for ending in (".csv", ".npz")
        ]
        links = dict.fromkeys(path.name for path in files if path.exists())
        captions = list(figure.findall(nodes.caption))
        if not links or not captions:
            continue
        text = ", ".join(f'<a href="{up}_static/figures/{n}" download>{n}</a>' for n in links)
        html = f' <span class="figure-data">Data: {text}</span>'
        captions[0] += nodes.raw("", html, format="html")


def link_back(
    app: Sphinx, what: str, name: str, obj: object, options: Any, lines: list[str]
) -> None:
    """Append to a docstring where in the book its equations, figures and tables stand."""
    items = [item for item in read_map().values() if name in item.functions]
    if not items:
        return
    places = find_items(ROOT / "build" / "notebooks")
    links = []
    for item in items:
        shown = f"({item.number})" if item.kind == "equation" else f"{item.kind} {item.number}"
        if item.id in places:
            stem, anchor = places[item.id]
            links.append(f"`{shown} <../notebooks/{stem}.html#{nodes.make_id(anchor)}>`__")
    if links:
        lines += ["", ".. rubric:: In the thesis", "", ", ".join(links) + ".", ""]


def keep_initials(
    app: Sphinx, what: str, name: str, obj: object, options: Any, lines: list[str]
) -> None:
    """Let a source that begins with an initial be no item of a list from A to Z."""
    lines[:] = [INITIAL.sub(r"\1\\\2", line) for line in lines]


def show_result(
    app: Sphinx, what: str, name: str, obj: object, options: Any, lines: list[str]
) -> None:
    """Append to a function's docstring the attributes of a result that has no page of its own."""
    if inspect.isfunction(obj):
        for result in unlisted_results(obj):
            lines += ["", f".. rubric:: Attributes of {result.__name__}", ""]
            for one in NumpyDocString(inspect.getdoc(result) or "")["Attributes"]:
                lines += [f"**{one.name}** : {one.type}", *(f"    {text}" for text in one.desc), ""]


def unlisted_results(function: Callable[..., Any]) -> list[type]:
    """Return the library's dataclasses that a function returns and no package's face names."""
    hint = get_type_hints(function).get("return")
    found = [
        part
        for part in (hint, *get_args(hint))
        if inspect.isclass(part) and is_dataclass(part) and part.__module__.startswith("microlib.")
    ]
    return [part for part in found if part.__name__ not in face_of(part).__all__]


def face_of(result: type) -> ModuleType:
    """Return the package whose file defines a class."""
    return import_module(".".join(result.__module__.split(".")[:2]))


def copy_figures(app: Sphinx, error: Exception | None) -> None:
    if error is None and app.builder.format == "html" and FIGURES.exists():
        shutil.copytree(FIGURES, Path(app.outdir) / "_static" / "figures", dirs_exist_ok=True)


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("map", Map)
    app.connect("doctree-read", link_formulas)
    app.connect("doctree-read", link_data)
    app.connect("doctree-read", link_numbers)
    # After numpydoc, which rewrites the lines it is given.
    app.connect("autodoc-process-docstring", keep_initials, priority=900)
    app.connect("autodoc-process-docstring", show_result, priority=900)
    app.connect("autodoc-process-docstring", link_back, priority=900)
    app.connect("build-finished", copy_figures)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
