"""The runner of the notebooks: what it runs again, in which order, and what it leaves."""

from __future__ import annotations

import base64
import io
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import nbformat
import numpy as np
import pytest
from nbformat.v4 import new_code_cell, new_notebook, new_output
from PIL import Image

from compendium import run

CHECKS = """
import json, pathlib
pathlib.Path(record).write_text(json.dumps([{"verdict": "consistent"}, {"verdict": "result"}]))
"""


def write_notebook(root: Path, name: str, source: str) -> None:
    cells = [new_code_cell('record = ""', metadata={"tags": ["parameters"]}), new_code_cell(source)]
    spec = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook = new_notebook(cells=cells, metadata={"kernelspec": spec})
    nbformat.write(notebook, root / "notebooks" / f"{name}.ipynb")


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A project of two small notebooks, in place of this one."""
    for folder in ("notebooks", "microlib/focus", "compendium", "data/thesis", "build/claims"):
        (tmp_path / folder).mkdir(parents=True)
    for file in ("microlib/focus/_a.py", "compendium/b.py", "data/thesis/c.toml"):
        (tmp_path / file).write_text("one")
    (tmp_path / "environment.txt").write_text("one")
    write_notebook(tmp_path, "01_first", CHECKS)
    write_notebook(tmp_path, "06_last", CHECKS)
    monkeypatch.setattr(run, "ROOT", tmp_path)
    monkeypatch.setattr(run, "BUILD", tmp_path / "build")
    monkeypatch.setattr(os, "environ", dict(os.environ))
    run.shared_key.cache_clear()
    yield tmp_path
    run.shared_key.cache_clear()


@pytest.mark.parametrize(
    ("file", "part"),
    [
        ("notebooks/01_first.ipynb", "notebook_file"),
        ("microlib/focus/_a.py", "library"),
        ("compendium/b.py", "compendium"),
        ("data/thesis/c.toml", "data"),
        ("environment.txt", "lock"),
    ],
)
def test_a_changed_file_changes_its_part_of_the_key(project: Path, file: str, part: str) -> None:
    before = run.input_hashes("01_first")
    assert before["python"] == sys.version.split()[0]
    (project / file).write_text("two")
    run.shared_key.cache_clear()
    after = run.input_hashes("01_first")
    assert {name for name in before if before[name] != after[name]} == {part}


def test_a_renamed_file_and_a_moved_line_change_the_hash(project: Path) -> None:
    one, two = project / "microlib" / "one.py", project / "microlib" / "two.py"
    hashes = set()
    for path, text in ((one, "ab"), (two, "ab"), (one, "ba")):
        path.write_text(text)
        hashes.add(run.files_hash([path]))
    assert len(hashes) == 3
    assert run.files_hash([one, two]) == run.files_hash(iter([two, one]))


def test_only_the_last_chapter_reads_the_records_of_the_others(project: Path) -> None:
    first, last = run.input_hashes("01_first"), run.input_hashes("06_last")
    assert "claims" not in first
    (project / "build" / "claims" / "06_last.json").write_text("own")
    assert run.input_hashes("06_last") == last
    (project / "build" / "claims" / "01_first.json").write_text("of another")
    assert run.input_hashes("06_last")["claims"] != last["claims"]


def test_a_run_leaves_notebook_record_and_status(project: Path) -> None:
    key = run.input_hashes("01_first")
    assert not run.up_to_date("01_first", key)
    message, passed = run.run("01_first", key)
    assert passed, message
    assert message.endswith(" s, 1 check passed")
    status = json.loads((project / "build" / "status" / "01_first.json").read_text())
    assert status["notebook"] == "01_first"
    assert status["checks"] == 1
    assert 0 < status["seconds"] < 100
    assert status.items() >= key.items()
    assert run.up_to_date("01_first", key)
    assert not run.up_to_date("01_first", key | {"lock": "another"})
    assert not list((project / "build" / "failed").iterdir())
    done = nbformat.read(project / "build" / "notebooks" / "01_first.ipynb", as_version=4)
    injected = [c for c in done.cells if "injected-parameters" in c.metadata.get("tags", [])]
    assert [c.metadata.tags for c in injected] == [["injected-parameters", "remove-cell"]]
    assert "papermill" not in {*done.metadata, *(k for c in done.cells for k in c.metadata)}
    for made in ("notebooks/01_first.ipynb", "claims/01_first.json", "status/01_first.json"):
        (project / "build" / made).rename(project / "away")
        assert not run.up_to_date("01_first", key), made
        (project / "away").rename(project / "build" / made)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("1 / 0", "FAILED in cell 2: ZeroDivisionError: division by zero (build/failed/01_"),
        ("import os; print(os.getcwd())", "FAILED: an output names a path of this machine"),
    ],
)
def test_a_failed_run_leaves_nothing_that_the_book_would_show(
    project: Path, source: str, message: str
) -> None:
    assert run.run("01_first", {})[1]
    write_notebook(project, "01_first", source)
    said, passed = run.run("01_first", {})
    assert not passed
    assert message in said
    assert not (project / "build" / "notebooks" / "01_first.ipynb").exists()
    assert not (project / "build" / "status" / "01_first.json").exists()
    assert (project / "build" / "failed" / "01_first.ipynb").exists()


def test_the_last_chapter_waits_for_the_others(
    project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    batches = []

    def pretend(keys: dict[str, dict[str, str]], jobs: int) -> int:
        batches.append((list(keys), jobs))
        return int("01_first" in keys and failing)

    monkeypatch.setattr(run, "run_all", pretend)
    monkeypatch.setattr(sys, "argv", ["run"])
    failing = False
    assert run.main() == 0
    assert batches == [(["01_first"], 2), (["06_last"], 2)]
    batches.clear()
    failing = True
    assert run.main() == 1
    assert batches == [(["01_first"], 2)]
    batches.clear()
    monkeypatch.setattr(run, "up_to_date", lambda name, key: True)
    assert run.main() == 0
    assert batches == [([], 2), ([], 2)]
    assert "01_first: up to date" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", ["run", "06", "--force", "--jobs", "1"])
    batches.clear()
    assert run.main() == 0
    assert batches == [([], 1), (["06_last"], 1)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["7"], "No notebook is called 7; there are 01_first, 06_last."),
        (["-p", "seed", "1"], "-p needs one notebook, not 01_first, 06_last."),
        (["01", "-p", "seed", "1"], "01_first has no parameter seed."),
    ],
)
def test_a_wrong_call_is_told_in_one_line(
    project: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.setattr(sys, "argv", ["run", *arguments])
    assert run.main() == 1
    assert capsys.readouterr().out == message + "\n"


@pytest.mark.parametrize(("source", "status"), [("print(record)", 0), ("1 / 0", 1)])
def test_a_run_on_own_data_is_kept_apart(
    project: Path, monkeypatch: pytest.MonkeyPatch, source: str, status: int
) -> None:
    write_notebook(project, "01_first", source)
    monkeypatch.chdir(project)
    monkeypatch.setattr(sys, "argv", ["run", "01", "-p", "record", "2.5", "--output", "mine"])
    assert run.main() == status
    done = nbformat.read(project / "mine" / "01_first.ipynb", as_version=4)
    assert any("record = 2.5" in cell.source for cell in done.cells)
    assert not (project / "build" / "status").exists()


def test_drawings_get_a_palette_and_photographs_become_jpeg() -> None:
    rng = np.random.default_rng(0)
    ramp = np.linspace(40, 200, 300)[:, None] * [1.0, 0.8, 0.6]
    scene = (ramp + rng.normal(0, 4, (300, 300, 3))).astype(np.uint8)
    drawing = np.full((200, 300, 3), 255, np.uint8)
    drawing[50:60] = (200, 30, 30)
    cells, sizes = [], []
    for picture in (scene, drawing, scene[:60, :60]):
        buffer = io.BytesIO()
        Image.fromarray(picture).save(buffer, "PNG", compress_level=0)
        data = {"image/png": base64.b64encode(buffer.getvalue()).decode()}
        sizes.append(len(data["image/png"]))
        cells.append(new_code_cell(outputs=[new_output("display_data", data=data)]))
    notebook = new_notebook(cells=cells)
    run.lighten(notebook)
    photograph, drawn, small = (cell.outputs[0].data for cell in notebook.cells)
    assert list(photograph) == ["image/jpeg"]
    assert len(photograph["image/jpeg"]) < sizes[0] / 2
    assert list(drawn) == list(small) == ["image/png"]
    assert len(drawn["image/png"]) < sizes[1] / 100
    kept = Image.open(io.BytesIO(base64.b64decode(drawn["image/png"]))).convert("RGB")
    np.testing.assert_array_equal(np.asarray(kept), drawing)
