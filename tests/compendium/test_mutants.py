"""`MUTANTS.md` says of the samples what `mutants.csv` holds."""

from __future__ import annotations

import csv
import re
from collections import Counter

from tests.mutants import NONE, RESULT, SAMPLE, Verdict, count, find_packages

TEXT = (RESULT.parent / "MUTANTS.md").read_text(encoding="utf-8")


def rows() -> list[Verdict]:
    with RESULT.open(newline="", encoding="utf-8") as file:
        head, *body = csv.reader(file)
    assert tuple(head) == Verdict._fields
    return [Verdict(row[0], row[1], row[2], int(row[3]), row[4], row[5]) for row in body]


def test_the_table_ends_with_the_samples_that_are_kept() -> None:
    told = {}
    for name, cells in re.findall(r"^\| `(\w+)` \|(.*)\|$", TEXT, flags=re.MULTILINE):
        found = re.findall(r"(\d+) of (\d+)", cells)
        if found:  # not one of the faults, which are named by their modules
            told[name] = tuple(map(int, found[-1]))
    every = Counter(row.package for row in rows())
    caught = Counter(row.package for row in rows() if row.caught != NONE)
    assert told == {name: (caught[name], every[name]) for name in every}
    assert min(every.values()) >= min(20, SAMPLE)
    assert set(every) <= set(find_packages())
    caught_all, total = caught.total(), every.total()
    least = min(100 * caught[name] // every[name] for name in every)
    line = re.search(
        r"The last samples together: (\d+) of (\d+), (\d+) %, at least (\d+) % in a\s+package", TEXT
    )
    assert line is not None
    assert tuple(map(int, line.groups())) == (
        caught_all, total, round(100 * caught_all / total), least,
    )  # fmt: skip


def test_every_fault_that_passed_is_explained() -> None:
    """Of the last samples each module with a fault that passed has a line."""
    named = set(re.findall(r"`((?:\w+/)?\w+)`", TEXT))
    for row in rows():
        if row.caught == NONE:
            path = row.module.removesuffix(".py").split("/", 1)[1]
            short = path.removeprefix("experiments/").removeprefix("figures/")
            assert {path, short, f"figures/{short}", f"compendium/{short}"} & named, row


def test_counts_are_told_with_their_share() -> None:
    given = [Verdict("a", "m", "f", 1, "", word) for word in ("no", "by its own tests")]
    given.append(Verdict("a", "m", "f", 1, "", "by the library's"))
    assert count(given) == "2 of 3 caught, 67 %, 1 of them by its own tests"
