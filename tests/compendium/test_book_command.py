"""The book is replaced by a whole one, in one step, or stays."""

import json
from pathlib import Path

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

from compendium import book, run
from tests.compendium.test_run import write_notebook


@pytest.fixture
def tree(tmp_path, monkeypatch):
    monkeypatch.setattr(book, "ROOT", tmp_path)
    monkeypatch.setattr(run, "ROOT", tmp_path)
    monkeypatch.setattr(run, "BUILD", tmp_path / "build")
    made = ("book/notebooks", "book/generated", "build/notebooks", "build/status", "notebooks")
    for folder in made:
        (tmp_path / folder).mkdir(parents=True)
    write_notebook(tmp_path, "01", "1")
    (tmp_path / "build" / "status" / "01.json").write_text('{"failed": ""}')
    (tmp_path / "book" / "notebooks" / "removed.ipynb").touch()
    (tmp_path / "build" / "notebooks" / "01.ipynb").write_text("new")
    return tmp_path


def render(folder: Path) -> None:
    """Stand in for jupyter-book."""
    html = folder / "_build" / "html"
    html.mkdir(parents=True)
    notebook = book.ROOT / "book" / "notebooks" / "01.ipynb"
    (html / "index.html").write_text(notebook.read_text())


def test_new_book_replaces_old_book(tree, monkeypatch):
    monkeypatch.setattr(book, "render", render)
    for text in ("first", "second"):
        (tree / "build" / "notebooks" / "01.ipynb").write_text(text)
        assert book.main() == 0
        assert (tree / "build" / "html" / "index.html").read_text() == text
        assert [path.name for path in (tree / "book" / "notebooks").iterdir()] == ["01.ipynb"]
        assert not (tree / "book" / "generated").exists()
    # The one that is shown and, until the next run, the one before.
    assert len(list((tree / "build" / "rendered").iterdir())) == 2


@pytest.mark.parametrize("fault", [OSError(28, "No space left"), KeyboardInterrupt()])
def test_failed_book_leaves_old_book(tree, monkeypatch, capsys, fault):
    monkeypatch.setattr(book, "render", render)
    assert book.main() == 0

    def fail(folder: Path) -> None:
        render(folder)
        raise fault

    monkeypatch.setattr(book, "render", fail)
    (tree / "build" / "notebooks" / "01.ipynb").write_text("other")
    assert book.main() in (1, 130)
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert (tree / "build" / "html" / "index.html").read_text() == "new"


@pytest.mark.parametrize("executed", [True, False])
def test_page_of_failed_notebook_names_failure(tree, monkeypatch, capsys, executed):
    """It shows as much as was executed, and nothing of an earlier run."""
    figure = {"mystnb": {"figure": {"name": "fig-4", "caption": "One."}}}
    cells = [new_markdown_cell("(four)=\n# 4 Four\n\nText.", id="a")]
    cells.append(new_code_cell("show()", id="b", metadata=figure))
    nbformat.write(new_notebook(cells=cells), tree / "notebooks" / "04.ipynb")
    if executed:
        cells[0].source += " As far as it came."
        nbformat.write(new_notebook(cells=cells), tree / "build" / "notebooks" / "04.ipynb")
        status = {"when": "2026-11-26 18:40", "failed": "FAILED in cell b: E: <1>"}
        (tree / "build" / "status" / "04.json").write_text(json.dumps(status))
    monkeypatch.setattr(book, "render", render)
    assert book.main() == 1
    reason = "FAILED in cell b: E: <1>" if executed else "it was not run"
    assert capsys.readouterr().err.endswith(f"notebooks failed:\n  04: {reason}\n")
    page = nbformat.read(tree / "book" / "notebooks" / "04.ipynb", as_version=4)
    head = page.cells[0].source
    assert head.startswith("(four)=\n# 4 Four\n\n:::{error}\n")
    assert reason in head
    assert ("2026-11-26 18:40" in head) == ("As far as it came." in head) == executed
    assert "not computed in this build" in page.cells[1].outputs[0].data["image/svg+xml"]
