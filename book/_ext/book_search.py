"""Where each section, equation, figure and table of the thesis stands, for the search.

The search of Sphinx knows words and no numbers such as 5.6 or 1.3237. It is given the list that is
written here, and the cards of the claims; ``_static/search_numbers.js`` puts what a number leads to
before the other results.
"""

from __future__ import annotations

from typing import Any

from book_map import find_items, read_map
from book_tables import write_script
from docutils import nodes
from sphinx.application import Sphinx


def list_numbers(app: Sphinx) -> dict[str, list[list[str]]]:
    """Return kind, text and address of what each number may mean, sections first."""
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


def write_numbers(app: Sphinx, error: Exception | None) -> None:
    if error is None and app.builder.format == "html":
        write_script(app, "numbers.js", "thesisNumbers", list_numbers(app))


def load_numbers(app: Sphinx, page: str, template: str, context: Any, doctree: Any) -> None:
    if page == "search":
        app.add_js_file("numbers.js", loading_method="defer")


def setup(app: Sphinx) -> None:
    app.connect("html-page-context", load_numbers)
    app.connect("build-finished", write_numbers)
