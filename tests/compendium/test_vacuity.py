"""What `make vacuity` wrote: every check that agrees was seen to fail, or it says why not."""

from __future__ import annotations

import csv
import re
import tomllib
from pathlib import Path

import pytest

from compendium import ledger

ROOT = Path(__file__).resolve().parents[2]
RESULT = ROOT / "data" / "thesis" / "vacuity.csv"
AGREES = ("reproduced", "consistent", "bounded")


@pytest.fixture(scope="module")
def rows() -> dict[str, dict[str, str]]:
    with RESULT.open(newline="", encoding="utf-8") as file:
        return {row["claim"]: row for row in csv.DictReader(file)}


@pytest.fixture(scope="module")
def faults() -> set[str]:
    text = (ROOT / "tests" / "vacuity_faults.toml").read_text(encoding="utf-8")
    return set(tomllib.loads(text))


def explained(heading: str) -> set[str]:
    """Return the claims, or faults, that a table of tests/VACUITY.md explains."""
    text = (ROOT / "tests" / "VACUITY.md").read_text(encoding="utf-8")
    section = text.split(f"## {heading}\n")[1].split("\n## ")[0]
    return {
        name
        for line in section.splitlines()
        if line.startswith("| `")
        for name in re.findall(r"`([^`]+)`", line.split("|")[1])
    }


def test_every_judged_claim_was_tried_as_it_stands(rows) -> None:
    judged = {c.id: c for c in ledger.claims().values() if c.verdict not in ("lost", "given")}
    assert rows.keys() == judged.keys()
    for name, row in rows.items():
        assert row["verdict"] == judged[name].qualified, f"{name}: run `make vacuity` again"


def test_a_fault_in_the_inputs_turns_each_check_that_agrees(rows) -> None:
    idle = {
        name
        for name, row in rows.items()
        if not row["inputs"] and ledger.claim(name).verdict in AGREES
    }
    assert idle == explained("Checks that no input's fault turns") & rows.keys()


def test_another_number_turns_each_check_that_agrees(rows) -> None:
    idle = {
        name
        for name, row in rows.items()
        if not row["numbers"] and ledger.claim(name).verdict in AGREES
    }
    assert idle == explained("Checks that no replaced number turns")


def test_each_planted_fault_turns_a_check(rows, faults) -> None:
    turning = {fault for row in rows.values() for fault in row["inputs"].split()}
    assert turning <= faults, "faults that are not planted any more: run `make vacuity` again"
    assert faults - turning == explained("Faults that no check turns")
