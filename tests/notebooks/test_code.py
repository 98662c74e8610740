"""The notebooks read as articles: short cells, little code, and each name with one meaning."""

from __future__ import annotations

import ast
from pathlib import Path

import nbformat
import pytest

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("[0-9]*.ipynb"))
CHAPTERS = [path for path in NOTEBOOKS if int(path.stem[:2]) <= 6]
#: Words of every drawing, which mean the figure or the panels at hand; chapter 5 needs none.
DRAWING = {"fig", "ax", "axes", "color", "title"}


def code(path: Path) -> list[nbformat.NotebookNode]:
    return [c for c in nbformat.read(path, as_version=4).cells if c.cell_type == "code"]


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


def test_chapter_5_has_little_code() -> None:
    (chapter,) = FOLDER.glob("05_*.ipynb")
    assert sum(len(cell.source.splitlines()) for cell in code(chapter)) <= 540


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_cells_are_short(path: Path) -> None:
    long = {cell.id: n for cell in code(path) if (n := len(cell.source.splitlines())) > 25}
    assert not long, long


@pytest.mark.parametrize("path", CHAPTERS, ids=lambda path: path.stem)
def test_a_name_means_one_thing(path: Path) -> None:
    """No name is bound twice, in one cell or in two, but those of a drawing."""
    allowed = set() if path.stem.startswith("05") else DRAWING
    every = [name for cell in code(path) for name in bound(cell.source)]
    twice = sorted({name for name in every if every.count(name) > 1} - allowed)
    assert not twice, twice
