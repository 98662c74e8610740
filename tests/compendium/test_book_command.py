"""The book is replaced by a whole one, in one step, or stays."""

from __future__ import annotations

from pathlib import Path

import pytest

from compendium import book, run


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(book, "ROOT", tmp_path)
    monkeypatch.setattr(book, "BUILD", tmp_path / "build")
    monkeypatch.setattr(book, "RENDERED", tmp_path / "build" / "rendered")
    monkeypatch.setattr(run, "BUILD", tmp_path / "build")
    for folder in ("book/notebooks", "book/generated", "build/notebooks"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "book" / "notebooks" / "removed.ipynb").touch()
    (tmp_path / "build" / "notebooks" / "01.ipynb").write_text("new")
    return tmp_path


def render(folder: Path) -> None:
    """Stand in for jupyter-book."""
    html = folder / "_build" / "html"
    html.mkdir(parents=True)
    notebook = book.ROOT / "book" / "notebooks" / "01.ipynb"
    (html / "index.html").write_text(notebook.read_text())


def test_a_new_book_takes_the_place_of_the_old(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(book, "render", render)
    for text in ("first", "second"):
        (tree / "build" / "notebooks" / "01.ipynb").write_text(text)
        assert book.main() == 0
        assert (tree / "build" / "html" / "index.html").read_text() == text
        assert [path.name for path in (tree / "book" / "notebooks").iterdir()] == ["01.ipynb"]
        assert not (tree / "book" / "generated").exists()
    # The one that is shown and, until the next run, the one before.
    assert len(list((tree / "build" / "rendered").iterdir())) == 2
    kept = {path.name for path in (tree / "build").iterdir()}
    assert kept == {".lock", "html", "notebooks", "rendered"}


@pytest.mark.parametrize(
    "fault", [OSError(28, "No space left"), KeyboardInterrupt(), SystemExit(1)]
)
def test_a_book_that_fails_leaves_the_old_one(
    tree: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    fault: BaseException,
) -> None:
    monkeypatch.setattr(book, "render", render)
    assert book.main() == 0

    def fail(folder: Path) -> None:
        render(folder)
        raise fault

    monkeypatch.setattr(book, "render", fail)
    (tree / "build" / "notebooks" / "01.ipynb").write_text("other")
    try:
        status = book.main()
    except SystemExit as end:
        status = end.code
    assert status in (1, 130)
    assert len(capsys.readouterr().err.splitlines()) == (0 if isinstance(fault, SystemExit) else 1)
    assert (tree / "build" / "html" / "index.html").read_text() == "new"


def test_with_a_failed_notebook_the_other_pages_are_rendered_and_it_is_named(
    tree: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    status = tree / "build" / "status"
    status.mkdir()
    (status / "04.json").write_text('{"notebook": "04", "failed": "FAILED in cell a: E: 1"}')

    def warn(folder: Path) -> None:  # of what the failed notebook did not record
        render(folder)
        raise SystemExit(1)

    monkeypatch.setattr(book, "render", warn)
    assert book.main() == 1
    assert (tree / "build" / "html" / "index.html").read_text() == "new"
    assert capsys.readouterr().err.endswith("notebooks failed:\n  04: FAILED in cell a: E: 1\n")
