"""Where each section, equation, figure and table of the thesis stands, for the search.

The search of Sphinx knows words and no numbers such as 5.6 or 1.3237. It is given the list that is
written here, and the cards of the claims; ``_static/search_numbers.js`` puts what a number leads to
before the other results.
"""

from __future__ import annotations

from book_map import find_items, read_map
from book_tables import add_data
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


def setup(app: Sphinx) -> None:
    add_data(app, "thesisNumbers", list_numbers, lambda page, text: page == "search")
