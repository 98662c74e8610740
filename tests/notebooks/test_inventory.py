"""What the notebooks check, counted: a check, assert, cell or claim that is taken out is missed."""

from __future__ import annotations

import ast
import math
from collections import Counter
from pathlib import Path

import nbformat
import pytest

from compendium import ledger

ROOT = Path(__file__).resolve().parents[2]

#: Cells, calls of `ledger.check`, calls of `ledger.report`, and asserts of each notebook. A number
#: changes only with what the notebook shows; lower it with the reason in the commit.
INVENTORY = {
    "01_introduction": (5, 0, 0, 0),
    "02_microsystems_and_vision": (49, 2, 13, 13),
    "03_visual_reconstruction_and_classification": (43, 3, 2, 8),
    "04_mechanical_characterization": (29, 0, 8, 2),
    "05_experimental_results": (134, 28, 92, 9),
    "06_conclusion": (28, 0, 16, 4),
    "07_guide_calibration": (13, 0, 0, 0),
    "07_guide_embryo": (14, 0, 0, 0),
    "07_guide_focus_stack": (14, 0, 0, 0),
    "07_guide_modulus": (15, 0, 0, 0),
    "07_guide_servoing": (17, 0, 0, 1),
    "07_guide_tracking": (12, 0, 0, 0),
}

#: Claims of each kind and verdict.
CLAIMS = {
    ("bound", "bounded"): 12,
    ("exact", "differs"): 6,
    ("exact", "erratum"): 3,
    ("exact", "reproduced"): 34,
    ("given", "given"): 40,
    ("lost", "lost"): 27,
    ("simulated", "consistent"): 42,
    ("simulated", "differs"): 7,
    ("simulated", "inconclusive"): 3,
    ("stated", "consistent"): 14,
    ("stated", "differs"): 9,
}


def count(path: Path) -> tuple[int, int, int, int]:
    cells = nbformat.read(path, as_version=4).cells
    calls: Counter[str] = Counter()
    asserts = 0
    for cell in cells:
        if cell.cell_type != "code":
            continue
        lines = [line for line in cell.source.splitlines() if not line.startswith("%")]
        for node in ast.walk(ast.parse("\n".join(lines))):
            asserts += isinstance(node, ast.Assert)
            function = getattr(node, "func", None)
            if getattr(getattr(function, "value", None), "id", "") == "ledger":
                calls[function.attr] += 1
    return len(cells), calls["check"], calls["report"], asserts


def test_nothing_was_taken_out_of_a_notebook() -> None:
    found = {path.stem: count(path) for path in sorted((ROOT / "notebooks").glob("*.ipynb"))}
    assert found == INVENTORY


def test_no_claim_was_taken_out() -> None:
    found = Counter((claim.kind, claim.verdict) for claim in ledger.claims().values())
    assert dict(found) == CLAIMS


@pytest.mark.parametrize("wrong", [1e9, -1e9, 1e12, -1e12])
def test_no_judged_claim_accepts_the_absurd(wrong: float, claims_folder: Path) -> None:
    """As a bare value, and as an interval so wide that everything lies in it."""
    records = ledger.read_records(claims_folder)
    for claim in ledger.claims().values():
        if claim.id not in records:
            continue
        width = abs(wrong) if claim.kind == "simulated" else 0.0
        verdict, objection = ledger.appraise(claim, wrong, wrong - width, wrong + width)
        down, up = ledger.turning_points(claim, records[claim.id])
        one_sided = claim.kind in ("stated", "bound") and (down == 0 or math.isinf(up))
        if claim.kind == "simulated" and claim.verdict == "inconclusive":
            continue  # the verdict is that nothing is said
        assert objection or (one_sided and verdict == claim.verdict), claim.id
