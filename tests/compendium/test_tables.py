"""The tables as printed, against their shape and cells typed from the thesis."""

import json
import re
from dataclasses import replace
from html import unescape
from xml.etree import ElementTree as ET

import pytest
from book_tables import script_json

from compendium import ledger
from compendium.tables import as_printed, verdict_link

#: Rows and columns of each table; row, column and number of a cell, with what leads to it.
PRINTED = {
    "table-5.1": (11, 4, 4, 2, "2.1e-10"),
    "table-5.2": (3, 4, 2, 1, "0.5843"),
    "table-5.3": (2, 4, 1, 2, "1.35"),
    "table-5.4": (2, 6, 0, 4, "4.79"),
    "table-5.5": (8, 3, 6, 1, "169.9"),
    "table-5.6": (7, 1, 5, 0, "197.24"),
    "table-5.7": (1, 2, 0, 1, "0.05"),
    "section-5.5": (10, 1, 5, 0, ">= 2"),  # sentences, with the number that decides each
}


@pytest.mark.parametrize("name", PRINTED)
def test_table_shows_printed_and_found_numbers(name, monkeypatch):
    monkeypatch.setenv(ledger.RECORD_MISMATCHES, "1")
    entries = [*ledger.claims().values(), *ledger.settings().values()]
    entries = [one for one in entries if one.id.startswith(f"{name}/")]
    if name == "section-5.5":
        entries = [one for one in entries if one.compared and not one.printed]
    for k, one in enumerate(entries):
        if one.compared:
            ledger.check(one.id, 1.0 + k, 0.25)
    rows, columns, at, across, printed = PRINTED[name]
    html = as_printed(name).data
    table = [re.findall("<td>(.*?)</td>", row) for row in re.findall("<tr><th .*?</tr>", html)]
    assert [len(row) for row in table] == [columns] * rows
    assert {one.sign for one in entries} <= set(html.partition("<tr")[0])  # the caption's
    texts = [[unescape(re.sub("<.*?>", " ", cell)) for cell in row] for row in table]
    assert re.split("[✓✗?≈•]", texts[at][across])[0].split() == printed.split()
    # Columns differ by the same part of an id in each row, and say the units that rows do not.
    layout = ledger.read_toml("tables.toml")[name]
    ids = [
        [set(re.findall(r"[a-z_]+|\d\w*", one)) for one in row["claims"]] for row in layout["rows"]
    ]
    for column, head in enumerate(layout["columns"]):
        assert len({frozenset(row[column] - row[0]) for row in ids}) == 1, head
        for row in layout["rows"]:
            unit = ledger.claim(f"{name}/{row['claims'][column]}").unit.replace("deg", "°")
            assert not unit or f"({unit})" in f"{layout['title']} {head} {row.get('label')}"
    # Each number stands once, with what was found for it and its own verdict.
    found = ledger.summary(f"{name}/")["recomputed"]
    expected = []
    for one in entries:
        text = f"{one.printed or one.condition} {one.sign} {found.get(one.id, '')}"
        expected.append(text.split())
    cells = [re.sub("^[a-z ]+", "", text).split() for row in texts for text in row]
    assert sorted(cells) == sorted(expected)


def test_unchecked_table_is_refused():
    ledger.open_record("")
    with pytest.raises(ValueError, match=r"missing: \['table-5.7/mean', 'table-5.7/std'\]"):
        as_printed("table-5.7")


def test_texts_of_claims_are_escaped():
    """Neither in HTML nor in a script, which a text may not end."""
    wrong = "</script><b title='x'>\"&"
    claim = replace(ledger.claim("table-5.6/E"), what=wrong)
    link = ET.fromstring(verdict_link(claim, "possible", up="../"))
    assert link.get("title") == f"{wrong}: {claim.label}"
    assert "<" not in script_json({"unit": wrong})
    assert json.loads(script_json({"unit": wrong})) == {"unit": wrong}
