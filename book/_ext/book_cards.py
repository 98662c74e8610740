"""The cards of recomputed numbers: what ``_static/cards.js`` shows beside a number, and on paper.

A card holds what the list of claims has of a number, and the lines of code that made it. All cards
are in one script, which the pages with such numbers load.
"""

from __future__ import annotations

import ast
import re
from functools import cache
from typing import Any

import nbformat
from book_tables import add_data
from book_test_sources import place_of_test
from book_verdicts import CLAIMS, every_entry, grounds, printed, records
from docutils import nodes
from sphinx.application import Sphinx

from compendium import ledger

RECORDS = ("ledger.check", "ledger.report")


@cache
def statements(notebook: str) -> list[tuple[int, ast.stmt, str]]:
    """Return each statement of a notebook: the number of its cell, the statement, and its lines."""
    found: list[tuple[int, ast.stmt, str]] = []
    for cell in nbformat.read(CLAIMS.parent / "notebooks" / f"{notebook}.ipynb", 4).cells:
        if cell.cell_type == "code" and cell.execution_count:
            lines = cell.source.splitlines()
            for part in ast.parse(cell.source).body:
                code = "\n".join(lines[part.lineno - 1 : part.end_lineno])
                found.append((cell.execution_count, part, code))
    return found


def names_in(part: ast.AST, kind: type[ast.expr_context]) -> set[str]:
    return {n.id for n in ast.walk(part) if isinstance(n, ast.Name) and isinstance(n.ctx, kind)}


def likeness(part: ast.AST, name: str) -> int:
    """Return how many letters of a number's name a statement that records it writes; else -1.

    The others are filled in when it runs, by an f-string or a variable.
    """
    found = [-1]
    for call in ast.walk(part):
        if isinstance(call, ast.Call) and ast.unparse(call.func) in RECORDS:
            text = call.args[0]
            pieces = text.values if isinstance(text, ast.JoinedStr) else [text]
            known = [str(one.value) if isinstance(one, ast.Constant) else "" for one in pieces]
            if re.fullmatch("".join(re.escape(one) or ".+" for one in known), name):
                found.append(len("".join(known)))
    return max(found)


def code_of(record: ledger.Record) -> str:
    """Return the statement that records a number, below those that assign what it uses."""
    every = statements(record.notebook)
    cell = [(likeness(s, record.id), k) for k, (n, s, _) in enumerate(every) if n == record.cell]
    if not cell:  # the notebook has failed since
        return ""
    last = max(cell)[1]
    _, made, code = every[last]
    used = names_in(made, ast.Load) - names_in(made, ast.Store)
    given: dict[str, str] = {}
    for _, part, lines in every[:last]:
        if isinstance(part, ast.Assign):
            names = set().union(*(names_in(target, ast.Store) for target in part.targets))
            given |= dict.fromkeys(names & used, lines)
    return "\n".join(dict.fromkeys([*given.values(), code]))


def read_cards(app: Sphinx) -> dict[str, dict[str, Any]]:
    """Return the cards by the anchors of their numbers; rows have a name, a text, an address."""

    def lead(text: str, page: str, anchor: str) -> list[str]:
        return [text, f"{app.builder.get_target_uri(page)}#{nodes.make_id(anchor)}"]

    entries: dict[str, ledger.Entry] = {entry.id: entry for entry in every_entry()}
    cards: dict[str, dict[str, Any]] = {}
    for name in entries | records():
        entry, record = entries.get(name), records().get(name)
        rows = {"Printed": [printed(entry) if entry else "the thesis prints no such number"]}
        if record:
            rows["Recomputed"] = [str(record)]
        if entry:
            rows["The thesis says"] = [entry.says]
            rows["Verdict"] = lead(f"{entry.sign} {entry.label}", "claims", f"claim-{name}")
            rows["Rests on"] = [" ".join(part.astext() for part in grounds(entry))]
            rows["Note"] = [entry.note]
        if record:
            rows["Made by"] = [code_of(record)]
            cell = f"cell {record.cell} of {record.notebook}"
            rows["Cell"] = lead(cell, f"notebooks/{record.notebook}", f"number-{name}")
        if entry and entry.test:
            rows["Test"] = lead(entry.test, *place_of_test(entry.test))
        cards[nodes.make_id(f"number-{name}").removeprefix("number-")] = {
            "title": f"{entry.what} ({entry.where})" if entry else f"Number {name} of this book",
            "label": entry.label if entry else "result",
            "rows": [[row, *texts] for row, texts in rows.items() if texts[0]],
        }
    return cards


def shows_numbers(page: str, text: str) -> bool:
    return page == "search" or re.search(r'href="[^"]*#(number|claim)-', text) is not None


def setup(app: Sphinx) -> None:
    add_data(app, "numberCards", read_cards, shows_numbers)
