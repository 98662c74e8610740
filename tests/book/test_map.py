"""The map of the thesis is whole, has no dead end, and is linked both ways."""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from pathlib import Path

import pytest

from compendium import ledger

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "book" / "_ext"))
from thesis_map import Item, captioned, find_items, read_map  # noqa: E402

THESIS = read_map()
# How many numbered items each chapter of the thesis has.
EQUATIONS = {2: 28, 3: 25, 4: 7, 5: 3}
FIGURES = {2: 4, 3: 4, 4: 3, 5: 19}
TABLES = {3: 1, 5: 7}
STATES = {
    "equation": ("holds", "corrected", "definition"),
    "figure": ("redrawn", "same drawing, data of this book", "stand-in for a photograph"),
    "table": ("",),
}


def named(text: str) -> set[str]:
    """Return the equation numbers that a text names, ranges such as (3.20)–(3.23) included."""
    found = set()
    pattern = r"(\d)\.(\d+)\)?(?:\s*(?:–|-|to)\s*\(?(\d)\.(\d+))?"
    for chapter, first, last_chapter, last in re.findall(pattern, text):
        end = int(last) if last and last_chapter == chapter else int(first)
        found |= {f"{chapter}.{n}" for n in range(int(first), end + 1)}
    return found


@pytest.mark.parametrize(
    ("kind", "counts"), [("equation", EQUATIONS), ("figure", FIGURES), ("table", TABLES)]
)
def test_the_map_is_whole(kind: str, counts: dict[int, int]) -> None:
    want = {f"{kind}-{chapter}.{n}" for chapter, last in counts.items() for n in range(1, last + 1)}
    assert {item for item in THESIS if item.startswith(kind)} == want


def test_every_item_stands_in_its_chapter() -> None:
    found = find_items(ROOT / "notebooks")
    for name, item in THESIS.items():
        assert name in found, f"no notebook shows {name}"
        chapter = f"0{item.number[0]}_"
        assert found[name][0].startswith(chapter), f"{name} stands in {found[name][0]}"


@pytest.mark.parametrize("item", THESIS.values(), ids=lambda item: item.id)
def test_functions_exist_and_name_their_equation(item: Item) -> None:
    for name in item.functions:
        module_name, attribute = name.rsplit(".", 1)
        module = importlib.import_module(module_name)
        function = getattr(module, attribute)
        assert attribute in module.__all__, f"{name} is not public"
        if item.kind == "equation":
            docs = inspect.getdoc(function) or ""
            assert item.number in named(docs), f"{name} does not name {item.number}"


def test_tables_lead_to_claims_and_corrections_to_errata() -> None:
    for item in THESIS.values():
        if item.kind == "table":
            assert any(c.startswith(f"{item.id}/") for c in ledger.claims()), item.id
        if item.erratum:
            erratum = ledger.errata()[item.erratum]
            assert item.number in named(erratum["where"]), f"{item.erratum} is not of {item.number}"


@pytest.mark.parametrize("item", THESIS.values(), ids=lambda item: item.id)
def test_the_entry_is_sound(item: Item) -> None:
    assert item.status in STATES[item.kind]
    assert (item.status == "corrected") == bool(item.erratum)
    assert not item.erratum or item.erratum in ledger.errata()


def test_captions_name_ranges() -> None:
    assert captioned("**Figures 5.6 to 5.8** show") == ["5.6", "5.7", "5.8"]
    assert captioned("**Figures 5.18 and 5.19** from") == ["5.18", "5.19"]
    assert captioned("**Figure 4.3**, to scale") == ["4.3"]
    assert captioned("Two **bold** words") == []
