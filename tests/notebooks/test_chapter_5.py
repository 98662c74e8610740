"""Chapter 5 reads as an article: little code, short cells, and each name with one meaning."""

from __future__ import annotations

import ast
from pathlib import Path

import nbformat
import pytest

CHAPTER = Path(__file__).resolve().parents[2] / "notebooks" / "05_experimental_results.ipynb"
CELLS = [c for c in nbformat.read(CHAPTER, as_version=4).cells if c.cell_type == "code"]


def bound(source: str) -> list[str]:
    """Return the names that a cell's own lines bind, as often as they do."""
    found = []
    todo: list[ast.AST] = [*ast.parse(source).body]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.append(node.name)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found += [(a.asname or a.name).split(".")[0] for a in node.names]
        elif not isinstance(node, ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id != "_":
                found.append(node.id)
            todo += ast.iter_child_nodes(node)
    return found


def test_the_chapter_has_little_code() -> None:
    assert sum(len(cell.source.splitlines()) for cell in CELLS) <= 500


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: cell.id)
def test_cells_are_short(cell: nbformat.NotebookNode) -> None:
    assert len(cell.source.splitlines()) <= 25


def test_a_name_means_one_thing() -> None:
    """No name is bound twice, in one cell or in two."""
    every = [name for cell in CELLS for name in bound(cell.source)]
    twice = sorted({name for name in every if every.count(name) > 1})
    assert not twice, twice


def test_names_are_seen_as_bound() -> None:
    source = (
        "import a.b as c, d.e\nfor f, _ in g:\n    h = [i for i in j]\ndef k(): l = 1\nm: int = 1"
    )
    assert sorted(bound(source)) == ["c", "d", "f", "h", "k", "m"]
