"""Each exercise has a title with its kind and time, and a folded solution; checks are folded."""

import re
from pathlib import Path

import nbformat
import pytest
from book_exercises import read_exercises

ROOT = Path(__file__).resolve().parents[2]
CHAPTERS = sorted((ROOT / "notebooks").glob("0[1-5]_*.ipynb"))
#: Calls that compare or record a number and show nothing.
CHECKS = re.compile(r"\b(check_equation|ledger\.check|ledger\.report)\(")


def by_stem(path: Path) -> str:
    return path.stem


@pytest.mark.parametrize("path", CHAPTERS, ids=by_stem)
def test_exercises_have_kind_time_and_folded_solution(path: Path) -> None:
    cells = nbformat.read(path, as_version=4).cells
    text = "\n".join(c.source for c in cells if c.cell_type == "markdown")
    found = read_exercises(path)
    labels = [one.label for one in found]
    assert len(found) == len(set(labels)) == len(re.findall(r"\{exercise(?:-start)?\}", text)) > 1
    form = r"\{solution(?:-start)?\} (\S+)\n:class: dropdown$"
    assert re.findall(form, text, re.M) == labels
    assert text.count("{solution-start}") == text.count("{solution-end}")


@pytest.mark.parametrize("path", CHAPTERS, ids=by_stem)
def test_cells_that_check_are_folded(path: Path) -> None:
    for cell in nbformat.read(path, as_version=4).cells:
        if cell.cell_type == "code" and CHECKS.search(cell.source):
            assert "check" in cell.metadata.get("tags", []), cell.id
