"""Where each numbered section, equation, figure and table stands, for the search.

The search of Sphinx knows words and no numbers such as 5.6. ``_static/search_numbers.js`` reads the
list that is written here and puts what a number leads to before the other results.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from thesis_map import find_items, read_map

ROOT = Path(__file__).resolve().parents[2]
TITLE = re.compile(r"(\d(?:\.\d+)*) \S")


def find_sections(app: Sphinx) -> list[tuple[str, str, str]]:
    """Return number, title and address of each section that carries a number of the thesis."""
    found = []
    for page in sorted(app.env.found_docs):
        if not re.match(r"notebooks/0[1-6]_", page):
            continue
        for section in app.env.get_doctree(page).findall(nodes.section):
            title = section.next_node(nodes.title)
            if title is not None and (match := TITLE.match(title.astext())):
                uri = app.builder.get_target_uri(page)
                # A chapter's own title is the page's beginning.
                anchor = f"#{section['ids'][0]}" if "." in match[1] else ""
                found.append((match[1], title.astext(), uri + anchor))
    return found


def list_numbers(app: Sphinx) -> dict[str, list[list[str]]]:
    """Return kind, text and address of what each number may mean, sections first."""
    numbers: dict[str, list[list[str]]] = {}
    for number, title, address in find_sections(app):
        numbers.setdefault(number, []).append(["section", f"Section {title}", address])
    places = find_items(ROOT / "build" / "notebooks")
    for item in read_map().values():
        stem, anchor = places[item.id]
        address = app.builder.get_target_uri(f"notebooks/{stem}") + "#" + nodes.make_id(anchor)
        number = f"({item.number})" if item.kind == "equation" else item.number
        text = f"{item.kind.capitalize()} {number}: {item.what}"
        numbers.setdefault(item.number, []).append([item.kind, text, address])
    return numbers


def write_numbers(app: Sphinx, error: Exception | None) -> None:
    if error is None and app.builder.format == "html":
        text = json.dumps(list_numbers(app), ensure_ascii=False)
        path = Path(app.outdir) / "_static" / "numbers.js"
        path.write_text(f"globalThis.thesisNumbers = {text};\n", encoding="utf-8")


def load_numbers(app: Sphinx, page: str, template: str, context: Any, doctree: Any) -> None:
    if page == "search":
        app.add_js_file("numbers.js", loading_method="defer")


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("html-page-context", load_numbers)
    app.connect("build-finished", write_numbers)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
