"""Pieces of pages that the other extensions are made of."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.config import Config

#: A cell that holds a number, perhaps with a sign of comparison, is not broken on a phone.
NUMBER = re.compile(r"[≤≥]?\s?[−+-]?\d[\d.,e+-]*")


def table(head: list[str], rows: list[list], *, ids: list[str] | None = None) -> nodes.table:
    """Build a docutils table; cells are text, nodes, or lists of paragraphs."""
    group = nodes.tgroup(cols=len(head))
    group += [nodes.colspec(colwidth=1) for _ in head]

    def across(cells: list, name: str = "") -> nodes.row:
        row = nodes.row(ids=[nodes.make_id(name)] if name else [])
        for cell in cells:
            shown = cell
            if not isinstance(cell, list):
                shown = nodes.paragraph()
                shown += cell if isinstance(cell, nodes.Node) else nodes.Text(cell)
            entry = nodes.entry()
            if isinstance(cell, str) and NUMBER.fullmatch(cell):
                entry["classes"] += ["number"]
            entry += shown
            row += entry
        return row

    header, body = nodes.thead(), nodes.tbody()
    header += across(head)
    body += [across(row, name) for row, name in zip(rows, ids or [""] * len(rows), strict=True)]
    group += [header, body]
    result = nodes.table(classes=["colwidths-auto"])
    result += group
    return result


def link(env: Any, shown: nodes.Node, page: str, anchor: str) -> nodes.reference:
    """Return a link to an anchor of a page of this book."""
    uri = env.app.builder.get_relative_uri(env.docname, page)
    address = f"{uri}#{nodes.make_id(anchor)}" if anchor else uri
    result = nodes.reference("", "", internal=True, refuri=address)
    result += shown
    return result


def section(name: str, title: str) -> nodes.section:
    result = nodes.section(ids=[nodes.make_id(name)])
    result += nodes.title(title, title)
    return result


def line(text: str, kind: str = "") -> nodes.paragraph:
    return nodes.paragraph(text, text, classes=[kind] if kind else [])


def span(text: str, kind: str) -> nodes.inline:
    return nodes.inline(text, text, classes=[kind])


def script_json(data: object) -> str:
    """Return data for an element ``<script type="application/json">``, which no text may end."""
    return json.dumps(data, ensure_ascii=False).replace("<", "\\u003c")


def when_written(app: Sphinx, do: Callable[[Sphinx], None]) -> None:
    """Call a function when all pages are written; the book has no other form than HTML."""
    app.connect("build-finished", lambda app, error: None if error else do(app))


def add_data(
    app: Sphinx, name: str, make: Callable[[Sphinx], object], wanted: Callable[[str, str], object]
) -> None:
    """Write what `make` returns as a script, which is all that a page opened from a file can read.

    The pages load it of whose name and text `wanted` is true.
    """

    def write(app: Sphinx) -> None:
        text = json.dumps(make(app), ensure_ascii=False)
        path = Path(app.outdir) / "_static" / f"{name}.js"
        path.write_text(f"globalThis.{name} = {text};\n", encoding="utf-8")

    def load(app: Sphinx, page: str, template: str, context: dict, doctree: Any) -> None:
        if wanted(page, context.get("body", "")):
            app.add_js_file(f"{name}.js", loading_method="defer")

    when_written(app, write)
    app.connect("html-page-context", load)


def raw_html(text: str) -> nodes.raw:
    return nodes.raw("", text, format="html")


def show(value: object) -> str:
    if value is None or value != value:  # NaN
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def disable_numfig(app: Sphinx, config: Config) -> None:
    # A LaTeX helper of jupyter-book turns Sphinx' own figure numbers on, whatever the settings say.
    config["numfig"] = False


def widen_tables(app: Sphinx, doctree: nodes.document) -> None:
    """Give a table with four columns or more the class by which it takes the margin's room."""
    for one in doctree.findall(nodes.table):
        if one.next_node(nodes.tgroup)["cols"] >= 4 and "claims" not in one["classes"]:
            one["classes"].append("full-width")


def setup(app: Sphinx) -> None:
    app.connect("doctree-read", widen_tables)
    app.connect("config-inited", disable_numfig, priority=900)
