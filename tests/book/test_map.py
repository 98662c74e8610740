"""The map of the thesis is whole and has no dead end; that of the library is read from the code."""

import importlib
import inspect
import re
from pathlib import Path

from book_map import TREATED, find_items, read_map

from compendium import ledger

ROOT = Path(__file__).resolve().parents[2]
WHOLE = read_map()
THESIS = {name: item for name, item in WHOLE.items() if item.kind not in TREATED}
#: How many numbered items each chapter of the thesis has, and sentences that chapters 1 and 6 have;
#: a list of chapters with a colon is one sentence.
COUNTS = {
    "equation": {2: 28, 3: 25, 4: 7, 5: 3},
    "figure": {2: 4, 3: 4, 4: 3, 5: 19},
    "table": {3: 1, 5: 7},
    "sentence": {1: 33, 6: 25},
}
SECTIONS = {
    *("1", "1.1", "1.2", "2.1", "2.2", "2.2.1", "2.2.2", "2.2.3"),
    *("3.1", "3.1.1", "3.1.2", "3.2", "3.2.1", "4", "4.1"),
    *("5.1", "5.2", "5.3", "5.4", "5.5", "5.5.1", "5.5.2", "5.6", "6"),
}
PROMISES = 9


def named(text: str) -> set[str]:
    """Return the equation numbers that a text names, ranges such as (3.20)–(3.23) included."""
    found = set()
    pattern = r"(\d)\.(\d+)\)?(?:\s*(?:–|-|to)\s*\(?(\d)\.(\d+))?"
    for chapter, first, last_chapter, last in re.findall(pattern, text):
        end = int(last) if last and last_chapter == chapter else int(first)
        found |= {f"{chapter}.{n}" for n in range(int(first), end + 1)}
    return found


def test_map_lists_every_item_section_promise_and_sentence() -> None:
    want = {f"section-{number}" for number in SECTIONS}
    want |= {f"promise-{k}" for k in range(1, PROMISES + 1)}
    for kind, counts in COUNTS.items():
        want |= {f"{kind}-{part}.{k}" for part, last in counts.items() for k in range(1, last + 1)}
    assert set(WHOLE) == want


def test_numbered_items_are_in_their_chapter() -> None:
    found = find_items(ROOT / "notebooks")
    for name, item in THESIS.items():
        assert name in found, f"no notebook shows {name}"
        chapter = f"0{item.number[0]}_"
        assert found[name][0].startswith(chapter), f"{name} stands in {found[name][0]}"


def test_functions_name_their_equations_and_corrected_equations_have_an_erratum() -> None:
    for item in THESIS.values():
        for name in item.functions if item.kind == "equation" else []:
            module, _, attribute = name.rpartition(".")
            docs = inspect.getdoc(getattr(importlib.import_module(module), attribute)) or ""
            assert item.number in named(docs), f"{name} does not name {item.number}"
        assert (item.status == "corrected") == bool(item.erratum), item.id
        where = ledger.errata()[item.erratum]["where"] if item.erratum else item.number
        assert item.number in named(where), item.id
