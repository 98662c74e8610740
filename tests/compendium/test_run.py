"""The runner of the notebooks: what it runs again, in which order, and what it leaves."""

from __future__ import annotations

import errno
import json
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_notebook

from compendium import run

CHECKS = """
import json, pathlib
pathlib.Path(record).write_text(json.dumps([{"verdict": "consistent"}, {"verdict": "result"}]))
"""


def write_notebook(root: Path, name: str, source: str, parameters: str = 'record = ""') -> None:
    """With cells of the same ids each time, as a notebook's own are."""
    cells = [
        new_code_cell(parameters, metadata={"tags": ["parameters"]}, id="parameters"),
        new_code_cell(source, id="source"),
    ]
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
    assert not list((project / "build" / "running").iterdir())


@pytest.mark.parametrize("damage", [None, b"", b"{", b"[]", b"\xff\x00", b"null", b'{"left": 3}'])
@pytest.mark.parametrize(
    "file",
    ["notebooks/01_first.ipynb", "claims/01_first.json", "status/01_first.json", "figures/a.csv"],
)
def test_what_is_damaged_is_not_up_to_date(project: Path, file: str, damage: bytes | None) -> None:
    """A file that is missing, empty, cut off or something else."""
    running = project / "build" / "running" / "01_first"
    for part in ("notebooks", "claims", "status", "figures"):
        (project / "build" / part).mkdir(exist_ok=True)
    (running / "figures").mkdir(parents=True)
    for made in ("notebook.ipynb", "record.json", "figures/a.csv"):
        (running / made).write_text("whole")
    run.publish("01_first", running, {"lock": "same"})
    assert run.up_to_date("01_first", {"lock": "same"})
    path = project / "build" / file
    if damage is None:
        path.unlink()
    else:
        path.write_bytes(damage)
    assert not run.up_to_date("01_first", {"lock": "same"})


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

    def pretend(calls: dict[str, tuple], jobs: int) -> list[tuple[str, str, bool]]:
        batches.append((list(calls), jobs))
        return [(name, "ran", not (name == "01_first" and failing)) for name in calls]

    monkeypatch.setattr(run, "in_workers", pretend)
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
    ("arguments", "status", "message"),
    [
        (["7"], 1, "No notebook is called 7; there are 01_first, 06_last."),
        (["01", "06_lst"], 1, "No notebook is called 06_lst; did you mean 06_last?"),
        (["-p", "seed", "1"], 1, "-p needs one notebook, got 01_first, 06_last."),
        (["01", "-p", "seed", "1"], 1, "01_first has no parameter seed; it has record, width."),
        (["01", "-p", "widht", "1"], 1, "01_first has no parameter widht; did you mean width?"),
        (["01", "-p", "width", "x"], 1, "width must be a finite number, got x"),
        (["01", "-p", "width", "1", "-p", "width", "2"], 1, "width must be given once, got it 2 "),
        (["01", "-p", "width", "1", "--output", "file"], 1, "--output must be a folder that can"),
        (["01", "-p", "width", "1", "--output", "/proc/a"], 1, "--output must be a folder that "),
        (["01", "-p", "width"], 2, "argument -p: expected 2 arguments; --help lists the options"),
        (["01", "--jobs", "x"], 2, "argument --jobs: invalid int value: 'x'; --help lists the "),
    ],
)
def test_a_wrong_call_is_told_in_one_line(
    project: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    status: int,
    message: str,
) -> None:
    write_notebook(project, "01_first", "print(width)", 'record = ""\nwidth = 1.0')
    monkeypatch.chdir(project)
    (project / "file").touch()
    monkeypatch.setattr(sys, "argv", ["run", *arguments])
    monkeypatch.setattr(run, "execute", lambda *_: pytest.fail("a kernel was started"))
    try:
        returned = run.main()
    except SystemExit as end:
        returned = end.code
    assert returned == status
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith(message)
    assert said.err.count("\n") == 1


@pytest.mark.parametrize(("source", "status"), [("print(record)", 0), ("1 / 0", 1)])
def test_a_run_on_own_data_is_kept_apart(
    project: Path, monkeypatch: pytest.MonkeyPatch, source: str, status: int
) -> None:
    write_notebook(project, "01_first", source, 'record = ""\nwidth = 1.0')
    monkeypatch.chdir(project)
    arguments = ["01", "-p", "record", "2.50", "-p", "width", "-5e1", "--output", "mine"]
    monkeypatch.setattr(sys, "argv", ["run", *arguments])
    assert run.main() == status
    done = nbformat.read(project / "mine" / "01_first.ipynb", as_version=4)
    injected = next(c for c in done.cells if "injected-parameters" in c.metadata.get("tags", []))
    assert 'record = "2.50"' in injected.source
    assert "width = -50.0" in injected.source
    assert [path.name for path in (project / "mine").iterdir()] == ["01_first.ipynb"]
    assert not (project / "build" / "status").exists()


def test_a_full_disk_is_told_and_leaves_what_was_there(
    project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run.run("01_first", run.input_hashes("01_first"))[1]
    kept = {path: path.read_bytes() for path in (project / "build").rglob("*") if path.is_file()}
    assert len(kept) == 3

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    for holder, name in ((run.nbformat, "write"), (run.papermill, "execute_notebook")):
        with monkeypatch.context() as patch:
            patch.setattr(holder, name, full)
            message, passed = run.guarded(run.run, "01_first", {"lock": "another"})
        assert not passed
        assert message == "FAILED: [Errno 28] No space left on device"
        now = {path: path.read_bytes() for path in kept}
        assert now == kept
    assert run.up_to_date("01_first", run.input_hashes("01_first"))


def test_a_killed_worker_and_a_killed_kernel_are_told(
    project: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    calls = {"one": (os.kill, os.getpid, 9)}
    monkeypatch.setattr(run, "guarded", suicide)
    assert list(run.in_workers(calls, 1)) == [("one", "FAILED: its process was killed", False)]
    write_notebook(project, "01_first", "import os; os.kill(os.getpid(), 9)")
    message, passed = run.run("01_first", {})
    assert not passed
    assert message.startswith("FAILED: its kernel was killed (build/failed")


def suicide(*_: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_the_same_run_leaves_the_same_bytes(project: Path) -> None:
    source = "import pandas as pd\nobject()\n"
    write_notebook(project, "01_first", source + "pd.DataFrame({'a': [1.5]}).style")
    made = []
    for _ in range(2):
        assert run.run("01_first", {})[1]
        made.append((project / "build" / "notebooks" / "01_first.ipynb").read_bytes())
    assert made[0] == made[1]
    assert b"T_" in made[0]
