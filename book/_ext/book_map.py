"""The map from the thesis' equations, figures and tables to this book, and links along it.

- ``{map}`` with ``equation``, ``figure`` or ``table``: the map's rows of that kind, each linked to
  its place in the chapter and to the function behind it; with ``section``, ``promise`` or
  ``sentence`` each linked to the pages that treat it.
- Every displayed formula with a ``\\tag`` of the thesis gets an anchor and a link to its function;
  every numbered section and every mention of an item gets an anchor or a link, too.
- A figure whose data were kept gets a link to them.
- The search is given where each section, equation, figure and table stands.

Sphinx numbers equations and figures by itself; none of its extensions keeps another text's numbers.
"""

from __future__ import annotations

import re
import shutil
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import nbformat
from book_surfaces import surface_script
from book_tables import add_data, link, table, when_written
from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util.docutils import SphinxDirective

from compendium import ROOT, ledger

FIGURES, PAGES = ROOT / "build" / "figures", ROOT / "book" / "notebooks"
#: Kinds of entries that pages treat, not functions.
TREATED = ("section", "promise", "sentence")
# The numbers with which a caption begins; its title may name other items.
CAPTION = re.compile(r"\*\*Figures? \d\.\d+(?:(?:,| and| )+\d\.\d+)*")
INITIAL = re.compile(r"^(\s*(?:\.\. \[[\w-]+\] )?)([A-Z]\. [A-Z])")
TAG = re.compile(r"\\tag\{(\d\.\d+)\}")
TABLE = re.compile(r"^\(table-(\d)-(\d)\)=", flags=re.M)
HEADING = re.compile(r"^#+ (\d(?:\.\d+)*) ", flags=re.M)
# A number of an equation in brackets, or of a figure or table with its word.
MENTION = re.compile(
    r"\((?P<bare>\d\.\d+)\)|\b(?P<kind>Figure|Table|figure|table) (?P<number>\d\.\d+)(?!\.?\d)"
)
# The index of a symbol in plain text, and not in the id of a claim such as table-5.6/w_d.
SYMBOL = r"(?:(?<=\b[A-Za-zεκζσ])|(?<=\b[uv][XY])|(?<=[2π]σ)|(?<=x′))(?<![A-Za-z.][a-z0-9]/\w)"
INDEX = re.compile(SYMBOL + r"_([xy]{2}|op|[a-zHK])(?![A-Za-z0-9_])")
QUOTED = (nodes.FixedTextElement, nodes.literal, nodes.math)
# Where a link would nest, or change what is quoted.
UNLINKED = (
    *QUOTED,
    nodes.Titular,
    nodes.reference,
    nodes.caption,
    nodes.target,
    addnodes.desc_signature,
    addnodes.pending_xref,
)


@dataclass(frozen=True)
class Item:
    """An item, section, promise or sentence of the thesis, as ``map.toml`` describes it."""

    id: str
    what: str
    functions: list[str] = field(default_factory=list)
    status: str = ""
    erratum: str = ""
    pages: list[str] = field(default_factory=list)
    claims: list[str] = field(default_factory=list)

    @property
    def kind(self) -> str:
        return self.id.split("-")[0]

    @property
    def number(self) -> str:
        return self.id.partition("-")[2]

    @property
    def shown(self) -> str:
        """Its number as the thesis writes it."""
        return f"({self.number})" if self.kind == "equation" else self.number


@cache
def read_map() -> dict[str, Item]:
    return {name: Item(id=name, **entry) for name, entry in ledger.read_toml("map.toml").items()}


@cache
def find_items(notebooks: Path = PAGES) -> dict[str, tuple[str, str]]:
    """Return where each item and each numbered section stands: the notebook's stem, the anchor."""
    found: dict[str, tuple[str, str]] = {}
    for path in sorted(notebooks.glob("0[1-6]_*.ipynb")):
        for cell in nbformat.read(path, as_version=4).cells:
            figure = cell.metadata.get("mystnb", {}).get("figure", {})
            if named := CAPTION.match(figure.get("caption", "")):
                for number in re.findall(r"\d\.\d+", named[0]):
                    found.setdefault(f"figure-{number}", (path.stem, figure["name"]))
            if cell.cell_type == "markdown":
                items = [f"equation-{number}" for number in TAG.findall(cell.source)]
                items += [f"table-{a}.{b}" for a, b in TABLE.findall(cell.source)]
                items += [f"section-{number}" for number in HEADING.findall(cell.source)]
                for item in items:
                    found.setdefault(item, (path.stem, nodes.make_id(item)))
    return found


def link_functions(names: list[str], docname: str) -> nodes.inline:
    """Return links to the pages of functions, with commas between them."""
    result = nodes.inline()
    for k, name in enumerate(names):
        reference = addnodes.pending_xref(
            "", refdomain="py", reftype="obj", reftarget=name, refdoc=docname, refwarn=True
        )
        shown = name.removeprefix("microlib.")
        reference += nodes.literal(shown, shown)
        result += [nodes.Text(", ")] if k else []
        result += reference
    return result


def list_pages(item: Item) -> str:
    """Return links to the pages that treat an item, with its verdicts, in the book's markup."""
    pages = "; ".join(f"{{ref}}`{label}`" for label in item.pages)
    labels = dict.fromkeys(ledger.claim(name).label for name in item.claims)
    verdicts = f" ({', '.join(labels)})" if labels else ""
    return (pages or item.status or "not treated") + verdicts


class Map(SphinxDirective):
    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        places = find_items()
        rows = []
        for item in read_map().values():
            if item.kind != self.arguments[0]:
                continue
            label: nodes.Node = nodes.Text(item.shown)
            if item.id in places:
                stem, anchor = places[item.id]
                label = link(self.env, label, f"notebooks/{stem}", anchor)
            if item.kind in TREATED:
                pages = nodes.inline("", "", *self.parse_inline(list_pages(item))[0])
                rows.append([label, item.what, pages])
                continue
            state: nodes.Node = nodes.Text(state_of(item))
            if item.erratum:
                state = link(self.env, state, "errata", f"erratum-{item.erratum}")
            functions: nodes.Node = nodes.Text("no function")
            if item.functions:
                functions = link_functions(item.functions, self.env.docname)
            rows.append([label, item.what, functions, state])
        if self.arguments[0] in TREATED:
            return [table(["Number", "What it says", "Where this book treats it"], rows)]
        return [table(["Number", "What", "In the library", "State"], rows)]


def state_of(item: Item) -> str:
    """Return an item's status, and for a table how many of its numbers have which verdict."""
    if item.kind != "table":
        return item.status
    entries = (*ledger.claims().values(), *ledger.settings().values())
    found = Counter(c.label for c in entries if c.id.startswith(f"{item.id}/"))
    return ", ".join(f"{count} {label}" for label, count in found.most_common())


def name_sections(app: Sphinx, doctree: nodes.document) -> None:
    """Give each section that carries a number of the thesis an anchor with that number."""
    if re.match(r"notebooks/0[1-6]_", app.env.docname):
        for part in doctree.findall(nodes.section):
            if match := re.match(r"(\d(?:\.\d+)*) ", part.next_node(nodes.title).astext()):
                part["ids"].append(nodes.make_id(f"section-{match[1]}"))


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
        if names:
            note += [nodes.Text("in code: "), link_functions(list(names), app.env.docname)]
        anchors = [nodes.target("", "", ids=[nodes.make_id(f"equation-{n}")]) for n in fresh]
        place = block.parent.index(block)
        block.parent.insert(place + 1, note)
        for anchor in anchors:
            block.parent.insert(place, anchor)


class TaggedFormulas(SphinxPostTransform):
    """Delimit every formula with the thesis' own number, and leave nothing of it to Sphinx.

    Sphinx wraps a formula that holds a line break in ``split``. LaTeX knows no ``\\tag`` inside
    that environment, and MathJax prints such a formula as red source.
    """

    default_priority = 200
    formats: ClassVar[tuple[str, ...]] = ("html",)

    def run(self, **kwargs: object) -> None:
        for node in self.document.findall(nodes.math_block):
            text = node.astext()
            if r"\tag{" in text and not node.get("nowrap"):
                node.children = [nodes.Text(rf"\[{text}\]")]
                node["nowrap"] = True


def link_numbers(app: Sphinx, doctree: nodes.document) -> None:
    """Make each mention of an equation, a figure or a table of the thesis lead to it."""
    if app.env.docname.startswith("benchmarks"):
        return  # where numbers in brackets are settings
    places = find_items()
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
            mention = link(app.env, nodes.Text(match[0]), f"notebooks/{place[0]}", place[1])
            mention["classes"].append("mention")
            parts += [nodes.Text(plain[end : match.start()]), mention]
            end = match.end()
        if parts:
            text.parent.replace(text, [*parts, nodes.Text(plain[end:])])


def lower_indices(app: Sphinx, doctree: nodes.document) -> None:
    """Write the index of a symbol such as T_z below its line, except in code."""
    if app.env.docname.startswith("generated"):
        return  # where T_z may be a parameter
    for text in list(doctree.findall(nodes.Text)):
        pieces = INDEX.split(text.astext())
        if len(pieces) > 1 and not isinstance(text.parent, QUOTED):
            kinds = (nodes.Text, lambda index: nodes.subscript(index, index))
            text.parent.replace(text, [kinds[k % 2](one) for k, one in enumerate(pieces)])


def ancestors(node: nodes.Node) -> Iterator[nodes.Node]:
    while node.parent is not None:
        node = node.parent
        yield node


def link_data(app: Sphinx, doctree: nodes.document) -> None:
    """Put a link to the kept numbers under each figure that has them."""
    up = "../" * app.env.docname.count("/")
    for figure in doctree.findall(nodes.figure):
        names = figure.get("names", []) + figure.get("ids", [])
        files = [f"{name}{ending}" for name in names for ending in (".csv", ".npz")]
        links = dict.fromkeys(file for file in files if (FIGURES / file).exists())
        caption = figure.next_node(nodes.caption)
        if not links or caption is None:
            continue
        text = ", ".join(f'<a href="{up}_static/figures/{n}" download>{n}</a>' for n in links)
        html = f' <span class="figure-data">Data: {text}</span>'
        html += "".join(surface_script(FIGURES / file) for file in links if file.endswith(".npz"))
        caption += nodes.raw("", html, format="html")


def escape_initials(
    app: Sphinx, what: str, name: str, obj: object, options: Any, lines: list[str]
) -> None:
    """Let a source that begins with an initial be no item of a list from A to Z."""
    lines[:] = [INITIAL.sub(r"\1\\\2", line) for line in lines]


def copy_figures(app: Sphinx) -> None:
    if FIGURES.exists():
        shutil.copytree(FIGURES, Path(app.outdir) / "_static" / "figures", dirs_exist_ok=True)


def list_numbers(app: Sphinx) -> dict[str, list[list[str]]]:
    """Return kind, text and address of what each number may mean, sections first.

    The search of Sphinx knows no numbers such as 5.6 or 1.3237. ``_static/search_numbers.js`` puts
    what this list and the cards of the claims say of a number before the other results.
    """
    numbers: dict[str, list[list[str]]] = {}
    places = find_items()
    for item in sorted(read_map().values(), key=lambda item: item.kind != "section"):
        if item.id in places:
            stem, anchor = places[item.id]
            text = f"{item.kind.capitalize()} {item.shown}: {item.what}"
            page = app.builder.get_target_uri(f"notebooks/{stem}")
            address = f"{page}#{nodes.make_id(anchor)}"
            numbers.setdefault(item.number, []).append([item.kind, text, address])
    return numbers


def setup(app: Sphinx) -> None:
    add_data(app, "thesisNumbers", list_numbers, lambda page, text: page == "search")
    app.add_directive("map", Map)
    app.add_post_transform(TaggedFormulas)
    app.connect("doctree-read", lower_indices, priority=100)  # before titles are collected
    app.connect("doctree-read", name_sections)
    app.connect("doctree-read", link_formulas)
    app.connect("doctree-read", link_data)
    app.connect("doctree-read", link_numbers)
    # After numpydoc, which rewrites the lines it is given.
    app.connect("autodoc-process-docstring", escape_initials, priority=900)
    when_written(app, copy_figures)
