"""Where each number stands, for the search: of sections, equations, figures, tables, and claims.

The search of Sphinx knows words and no numbers such as 5.6 or 1.3237. It is given the list that is
written here; ``_static/search_numbers.js`` puts what a number leads to before the other results.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from book_map import find_items, read_map
from book_verdicts import printed, records
from docutils import nodes
from sphinx.application import Sphinx

from compendium import ledger

NUMBER = re.compile(r"-?\d[\d.]*(?:e[+-]?\d+)?")


def list_numbers(app: Sphinx) -> dict[str, list[list[str]]]:
    """Return kind, text and address of what each number may mean, sections first."""
    numbers: dict[str, list[list[str]]] = {}

    def add(number: str, kind: str, text: str, page: str, anchor: str) -> None:
        address = f"{app.builder.get_target_uri(page)}#{nodes.make_id(anchor)}"
        entry = [kind, text, address]
        if entry not in numbers.setdefault(number, []):
            numbers[number].append(entry)

    places = find_items()
    for item in sorted(read_map().values(), key=lambda item: item.kind != "section"):
        if item.id in places:
            stem, anchor = places[item.id]
            text = f"{item.kind.capitalize()} {item.shown}: {item.what}"
            add(item.number, item.kind, text, f"notebooks/{stem}", anchor)
    for claim in (*ledger.claims().values(), *ledger.settings().values()):
        found = records().get(claim.id)
        text = f"{claim.what} ({claim.where}): printed {printed(claim)}"
        text += f", recomputed {found}" if found else ""
        for number in dict.fromkeys(NUMBER.findall(f"{claim.printed} {found}")):
            add(number, "value", f"{text}: {claim.label}", "claims", f"claim-{claim.id}")
    return numbers


def write_numbers(app: Sphinx, error: Exception | None) -> None:
    if error is None and app.builder.format == "html":
        text = json.dumps(list_numbers(app), ensure_ascii=False)
        path = Path(app.outdir) / "_static" / "numbers.js"
        path.write_text(f"globalThis.thesisNumbers = {text};\n", encoding="utf-8")


def load_numbers(app: Sphinx, page: str, template: str, context: Any, doctree: Any) -> None:
    if page == "search":
        app.add_js_file("numbers.js", loading_method="defer")


def setup(app: Sphinx) -> None:
    app.connect("html-page-context", load_numbers)
    app.connect("build-finished", write_numbers)
