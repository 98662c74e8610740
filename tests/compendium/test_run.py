"""The runner of the notebooks: what it runs again, in which order, and what it leaves.

`.ci/hostile.py` kills kernels and runs, fills the disk, and has settings of a user in the way.
"""

import json
import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from threading import Event
from types import SimpleNamespace

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_notebook, new_output

from compendium import execution, run

ROOT = Path(__file__).resolve().parents[2]

CHECKS = """
import json, pathlib
path = pathlib.Path(record)
found = [{"verdict": "follows", "notebook": path.stem}, {"verdict": "result"}]
path.write_text(json.dumps(found)) if record else None
"""


def write_notebook(root: Path, name: str, source: str, parameters: str = 'record = ""') -> None:
    """With cells of the same ids each time, as a notebook's own are."""
    cells = [
        new_code_cell("other = 1", id="other"),
        new_code_cell(parameters, metadata={"tags": ["parameters"]}, id="parameters"),
        new_code_cell(source, id="source"),
        new_code_cell("", id="end"),
    ]
    spec = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook = new_notebook(cells=cells, metadata={"kernelspec": spec})
    nbformat.write(notebook, root / "notebooks" / f"{name}.ipynb")


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A project of two small notebooks, in place of this one.

    The name of its folder for temporary files is longer than the 107 bytes that a socket may have.
    """
    (tmp_path / ("a" * 120)).mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / ("a" * 120)))
    for folder in ("notebooks", "microlib/focus", "compendium", "data/thesis", "build/claims"):
        (tmp_path / folder).mkdir(parents=True)
    for file in ("microlib/focus/_a.py", "compendium/b.py", "data/thesis/c.toml"):
        (tmp_path / file).write_text("one")
    write_notebook(tmp_path, "01_first", CHECKS)
    write_notebook(tmp_path, "06_last", CHECKS)
    monkeypatch.setattr(run, "ROOT", tmp_path)
    monkeypatch.setattr(run, "BUILD", tmp_path / "build")
    monkeypatch.setattr(os, "environ", dict(os.environ))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def start(monkeypatch):
    """Start the runner with some arguments; return the exit status."""

    def start(*arguments: str) -> int:
        monkeypatch.setattr(sys, "argv", ["run", *arguments])
        try:
            return run.main()
        except SystemExit as end:
            return end.code

    return start


def test_changed_file_changes_cache_key(project):
    keys = [run.key_of("01_first")]
    for file in ("notebooks/01_first.ipynb", "microlib/focus/_a.py", "compendium/b.py"):
        (project / file).write_text("two")
        keys.append(run.key_of("01_first"))
        assert keys[-1] not in keys[:-1], file
    # The records of the others are an input of the last chapter alone.
    last = run.key_of("06_last")
    (project / "build" / "claims" / "01_first.json").write_text("of another")
    assert run.key_of("01_first") == keys[-1]
    assert run.key_of("06_last") != last
    (project / "data" / "thesis" / "c.toml").write_text("two")
    assert run.key_of("01_first") != keys[-1]


def injected(path: Path) -> nbformat.NotebookNode:
    """Return the cell with the parameters of a run."""
    cells = nbformat.read(path, as_version=4).cells
    (found,) = (c for c in cells if "injected-parameters" in c.metadata.get("tags", []))
    return found


def test_checks_are_folded_and_say_whether_they_passed() -> None:
    cells = [new_code_cell("assert True", metadata={"tags": ["check"]}) for _ in range(3)]
    cells[0].execution_count = cells[1].execution_count = 1
    cells[1].outputs = [new_output("error", ename="ClaimError", evalue="", traceback=[])]
    execution.clean(new_notebook(cells=cells))
    shown = [cell.metadata["mystnb"]["code_prompt_show"] for cell in cells]
    assert shown == ["Check: passed", "Check: failed", "Check: not run"]
    assert all("hide-cell" in cell.metadata.tags for cell in cells)


def test_only_changed_or_missing_notebooks_run_again(project, start, capsys):
    figure = "import os\n(pathlib.Path(os.environ['MICROLIB_FIGURES']) / 'fig.csv').touch()"
    write_notebook(project, "01_first", CHECKS + figure)
    assert start() == 0
    status = json.loads((project / "build" / "status" / "01_first.json").read_text())
    assert status.items() >= {"checks": 1, "failed": ""}.items()
    tags = injected(project / "build" / "notebooks" / "01_first.ipynb").metadata.tags
    assert tags == ["injected-parameters", "remove-cell"]
    claims = json.loads((project / "build" / "claims" / "01_first.json").read_text())
    assert claims[0]["notebook"] == "01_first"  # as `ledger.open_record` takes it from the path
    assert start() == 0
    assert "01_first: up to date" in capsys.readouterr().out
    for file, damage in (
        ("build/status/01_first.json", "{"),
        ("build/notebooks/01_first.ipynb", None),
        ("build/figures/fig.csv", None),
        ("notebooks/01_first.ipynb", (project / "notebooks/01_first.ipynb").read_text() + " "),
    ):
        before = (project / file).read_text()
        assert run.up_to_date("01_first", run.key_of("01_first"))
        (project / file).write_text(damage) if damage else (project / file).unlink()
        assert not run.up_to_date("01_first", run.key_of("01_first")), file
        (project / file).write_text(before)


def test_failed_notebook_is_listed_and_others_run(project, start, capsys):
    """It is named with cell and message; what it computed before stays, and it runs again."""
    write_notebook(project, "08_first", CHECKS + "1 / 0")
    write_notebook(project, "02_second", CHECKS)
    assert start() == 1
    failure = "08_first: FAILED in cell source: ZeroDivisionError: division by zero"
    assert capsys.readouterr().err.endswith(f"These notebooks failed:\n  {failure}\n")
    assert [*run.failures()] == ["08_first"]
    assert json.loads((project / "build" / "claims" / "08_first.json").read_text())
    page = nbformat.read(project / "build" / "notebooks" / "08_first.ipynb", as_version=4)
    assert [c.id for c in page.cells] == [
        "other",
        "parameters",
        "injected-parameters",
        "source",
        "end",
    ]
    assert start("--failures") == 1
    assert failure in capsys.readouterr().err
    assert not run.up_to_date("08_first", run.key_of("08_first"))
    # A run of another notebook says that this failure is older.
    assert start("02") == 1
    assert "08_first (earlier, 20" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("import os; print(os.getcwd())", "FAILED: an output names a path of this machine"),
        ("import time; time.sleep(60)", "FAILED in cell source: CellTimeoutError: A cell timed"),
        ("import sys; sys.exit(0)", "FAILED in cell source: SystemExit: 0"),
        ("%nothing", "FAILED in cell source: UsageError: Line magic function `%nothing` not found"),
    ],
)
def test_failures_are_reported_with_reason(project, monkeypatch, source, message):
    monkeypatch.setattr(run, "CELL_LIMIT", 5)
    write_notebook(project, "01_first", source)
    run.build(["01_first"], 1, force=False)
    assert run.failures()["01_first"].startswith(message)


def test_packages_in_pythonpath_are_rejected(project, start, monkeypatch, capsys):
    about = project / "own" / "numpy-1.0.dist-info" / "METADATA"
    about.parent.mkdir(parents=True)
    about.write_text("Metadata-Version: 2.1\nName: numpy\nVersion: 1.0\n")
    monkeypatch.setenv("PYTHONPATH", f"{project / 'own'}{os.pathsep}")
    assert start() == 1
    assert "PYTHONPATH must not replace installed packages, got one with numpy." in (
        capsys.readouterr().err
    )


def test_kernels_are_interrupted_again_but_not_by_a_second_press(monkeypatch):
    sent, timers = [], []
    kernel = SimpleNamespace(has_kernel=True, provisioner=SimpleNamespace(pid=7))
    monkeypatch.setattr(execution.Kernel, "started", [kernel])
    monkeypatch.setattr(execution, "interrupted", Event())
    timer = "Timer", lambda seconds, call: SimpleNamespace(start=partial(timers.append, call))
    monkeypatch.setattr(execution, *timer)
    monkeypatch.setattr(os, "killpg", lambda group, number: sent.append((group, number)))
    execution.interrupt_kernels(signal.SIGINT)
    execution.interrupt_kernels(signal.SIGINT)
    assert sent == [(7, signal.SIGINT)]
    timers.pop()()
    assert sent == 2 * [(7, signal.SIGINT)]


def test_second_run_waits_for_lock(project):
    code = "import sys, pathlib; from compendium import run; "
    code += f"run.BUILD = pathlib.Path({str(project / 'build')!r})\n"
    code += "with run.build_lock(): print('holds', flush=True)"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with run.build_lock():
        second = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, **pipes)
        assert second.stderr
        assert second.stderr.readline().startswith("Another run is at work in ")
    assert second.communicate()[0] == "holds\n"


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["-p", "seed", "1"], 1, "-p needs one notebook, got 01_first, 06_last."),
        (["01", "-p", "width", "1", "--output", "/proc/a"], 1, "--output must be a folder that "),
        (["-p", "width", "x", "--output", "a", "01"], 1, "width must be a finite number, got x"),
        (["01", "-p", "width"], 2, "argument -p: expected 2 arguments; --help lists the options"),
    ],
)
def test_wrong_arguments_give_one_line(
    project, start, monkeypatch, capsys, arguments, status, message
):
    write_notebook(project, "01_first", "print(width)", 'record = ""\nwidth = 1.0')
    monkeypatch.setattr(run, "execute", lambda *_: pytest.fail("a kernel was started"))
    assert start(*arguments) == status
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert said.err.startswith(message)


@pytest.mark.parametrize(("source", "status"), [("print(record)", 0), ("1 / 0", 1)])
def test_run_on_own_data_writes_to_its_own_folder(project, start, source, status):
    write_notebook(project, "01_first", source, 'record = ""\nwidth = 1.0')
    own = ("-p", "record", "2.50", "-p", "width", "-5e1")
    (project / "mine").mkdir()
    (log := project / "mine" / "01_first.log.txt").write_text("an error of the run before")
    assert start("01", *own, "--output", "mine") == status
    given = injected(project / "mine" / "01_first.ipynb").source
    assert 'record = "2.50"' in given
    assert "width = -50.0" in given
    files = {path.name for path in (project / "mine").iterdir()}
    assert files == {"01_first.ipynb", log.name}
    assert "of the run before" not in log.read_text()
    assert not (project / "build" / "status").exists()
