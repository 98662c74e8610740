"""Many files: a row each, kept through failures, dead processes, kills and second runs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest

from microlib import batch
from microlib.batch import process_files
from microlib.microscope import Microscope

ROOT = Path(__file__).parents[1]


def measure(path: Path, *, factor: float = 1.0, log: Path | None = None) -> dict[str, object]:
    """Read a number; fail, die or wait where the file says so."""
    if log is not None:
        with log.open("a") as file:
            file.write(f"{path.name}\n")
    text = path.read_text()
    if text == "die":
        os._exit(3)
    if text.startswith("wait"):
        time.sleep(0.15)
        text = text[4:]
    return {"value": factor * float(text), "name": path.stem, "odd": float(text) % 2 == 1}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    place = tmp_path / "files"
    place.mkdir()
    for k, text in enumerate(["3.5", "1e-3", "no number", "7"]):
        (place / f"f{k}.txt").write_text(text)
    return place


@pytest.mark.parametrize("workers", [1, 2])
def test_a_row_per_file_and_failures_among_them(folder: Path, workers: int) -> None:
    table, told = folder.parent / "t.csv", []
    found = process_files(
        f"{folder}/*.txt",
        partial(measure, factor=2.0),
        table,
        workers=workers,
        progress=lambda *counts: told.append(counts),
    )
    assert found["file"].tolist() == [str(folder / f"f{k}.txt") for k in range(4)]
    assert found["value"].dropna().tolist() == [7.0, 2e-3, 14.0]
    assert found["odd"].dropna().tolist() == [False, False, True]
    assert found["error"].tolist()[:2] + found["error"].tolist()[3:] == ["", "", ""]
    assert found["error"][2].startswith("ValueError: could not convert string to float")
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]
    kept = pd.read_csv(table).fillna({"error": ""})
    pd.testing.assert_frame_equal(kept, found)
    assert sorted(p.name for p in folder.parent.iterdir()) == ["files", "t.csv"]


def threads(path: Path) -> dict[str, str]:
    return {name: os.environ.get(name, "") for name in THREADS}


THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def test_processes_do_not_share_a_core_among_threads_unless_told(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in THREADS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    found = process_files(folder.glob("f0*"), threads, folder / "t.csv", workers=2)
    row = found.iloc[0]
    assert [int(row[name]) for name in THREADS] == [1, 2, 1]
    assert [os.environ.get(name) for name in THREADS] == [None, "2", None]


def test_only_what_is_missing_or_has_changed_is_done(folder: Path) -> None:
    log = folder.parent / "log"
    work = partial(measure, log=log)
    run = partial(process_files, work=work, table=folder.parent / "t.csv")
    first = run(sorted(folder.iterdir())[:3])
    assert len(first) == 3
    (folder / "f1.txt").write_text("22")
    found = run(sorted(folder.iterdir()))
    assert found["value"].dropna().tolist() == [3.5, 22.0, 7.0]
    assert log.read_text().split() == ["f0.txt", "f1.txt", "f2.txt", "f1.txt", "f3.txt"]
    run(sorted(folder.iterdir()), retry=True)
    assert log.read_text().split()[5:] == ["f2.txt"]
    # Fewer files: the others' rows stay in the table, and are not what was asked for.
    assert len(run([folder / "f3.txt"])) == 1
    assert len(pd.read_csv(folder.parent / "t.csv")) == 4


def test_a_folder_changes_with_its_files(tmp_path: Path) -> None:
    stack = tmp_path / "stack"
    stack.mkdir()
    (stack / "1.txt").write_text("1")
    calls = []

    def count(path: Path) -> dict[str, int]:
        calls.append(path)
        return {"files": len(list(path.iterdir()))}

    for _ in range(2):
        assert process_files([stack], count, tmp_path / "t.csv")["files"].tolist() == [1]
    (stack / "1.txt").write_text("longer")
    process_files([stack], count, tmp_path / "t.csv")
    assert len(calls) == 2


def test_a_result_of_the_library_is_a_row(folder: Path) -> None:
    def scope(path: Path) -> Microscope:
        return Microscope(2e5, 1e5, 5e4, pixel_size=9.9, image_size=(656, 491))

    found = process_files(f"{folder}/f0*", scope, folder.parent / "t.csv")
    assert found["image_size_width"].tolist() == [656]
    assert found["focal_length"].tolist() == [1e5]


def test_a_process_that_dies_costs_one_row(folder: Path) -> None:
    (folder / "f2.txt").write_text("die")
    found = process_files(f"{folder}/*", measure, folder.parent / "t.csv", workers=2)
    assert found["value"].dropna().tolist() == [3.5, 1e-3, 7.0]
    assert found["error"][2] == "BrokenProcessPool: the process ended while it did this file"


SCRIPT = """
import sys
from functools import partial
from pathlib import Path
from microlib.batch import process_files
from tests.test_batch import measure
if __name__ == "__main__":
    folder = Path(sys.argv[1])
    work = partial(measure, log=folder.parent / "log")
    process_files(f"{folder}/*", work, folder.parent / "t.csv", workers=2)
"""


def test_a_killed_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    folder = tmp_path / "files"
    folder.mkdir()
    for k in range(24):
        (folder / f"{k:02d}.txt").write_text(f"wait{k}")
    script = tmp_path / "run.py"
    script.write_text(SCRIPT)
    command = [sys.executable, str(script), str(folder)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    run = subprocess.Popen(command, env=environment)
    table = tmp_path / "t.csv"
    while not table.exists() or table.read_text().count("\n") < 6:
        assert run.poll() is None
        time.sleep(0.01)
    run.send_signal(signal.SIGKILL)
    run.wait()
    with table.open("a") as file:  # as if it had been killed while it wrote
        file.write(str(folder / "23.txt") + ",,0.1")
    time.sleep(1.0)
    calls = (tmp_path / "log").read_text().split()
    assert len(calls) < 24  # nobody goes on
    subprocess.run(command, env=environment, check=True)
    found = pd.read_csv(table)
    assert found["value"].tolist() == list(range(24))
    calls = (tmp_path / "log").read_text().split()
    assert set(calls) == {f"{k:02d}.txt" for k in range(24)}
    assert len(calls) - 24 <= 4  # what the two processes had in hand


def test_other_settings_and_other_tables_are_refused(folder: Path) -> None:
    table = folder.parent / "t.csv"
    process_files(f"{folder}/*", partial(measure, factor=1.0), table)
    before = table.read_bytes()
    with pytest.raises(ValueError, match=r"table must be of the same work, .*factor=1\.0"):
        process_files(f"{folder}/*", partial(measure, factor=2.0), table)
    assert table.read_bytes() == before
    other = folder.parent / "mine.csv"
    other.write_text("a,b\n1,2\n")
    with pytest.raises(ValueError, match="table must be one that process_files wrote"):
        process_files(f"{folder}/*", measure, other)
    assert other.read_text() == "a,b\n1,2\n"


def test_two_calls_do_not_write_one_table(folder: Path) -> None:
    table = folder.parent / "t.csv"

    def nested(path: Path) -> None:
        process_files(f"{folder}/*", nested, table)

    found = process_files(f"{folder}/f0*", nested, table)
    assert found["error"][0].startswith("ValueError: table must be written by one call")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"files": "none/*.tif"}, "files must name at least one"),
        ({"files": "a.tif"}, "files must be a list of paths or a pattern"),
        ({"files": ["a", "a"]}, "files must name each file once, got a twice"),
        ({"files": [3]}, "files must be paths, got int"),
        ({"files": None}, "files must be paths or a pattern, got NoneType"),
        ({"work": 3}, "work must be a function of a path, got int"),
        ({"work": lambda path: {}, "workers": 2}, "work must be a function of a module"),
        ({"workers": 0}, "workers"),
        ({"progress": 3}, "progress must be a function"),
        ({"table": "nowhere/t.csv"}, "table must lie in an existing folder"),
    ],
)
def test_what_cannot_work_is_refused(folder: Path, change: dict, match: str) -> None:
    given = {"files": f"{folder}/*", "work": measure, "table": folder.parent / "t.csv"}
    with pytest.raises(ValueError, match=match):
        process_files(**(given | change))
    assert not (folder.parent / "t.csv").exists()


@pytest.mark.parametrize("wrong", [3, {"file": 1}, [1]])
def test_what_work_returns_wrongly_is_its_row(folder: Path, wrong: object) -> None:
    found = process_files(f"{folder}/f0*", lambda path: wrong, folder.parent / "t.csv")
    assert found["error"][0].startswith("TypeError: work must")


def test_progress_counts_what_is_done_already(folder: Path) -> None:
    table, told = folder.parent / "t.csv", []
    process_files([folder / "f0.txt", folder / "f3.txt"], measure, table)
    process_files(f"{folder}/*", measure, table, progress=lambda *counts: told.append(counts))
    assert told == [(3, 4), (4, 4)]


def test_the_file_that_is_named_twice_is_told(folder: Path) -> None:
    files = [folder / "f3.txt", folder / "f0.txt", folder / "f0.txt"]
    with pytest.raises(ValueError, match=r"each file once, got .*f0\.txt twice"):
        process_files(files, measure, folder.parent / "t.csv")


def test_seconds_are_those_of_the_file(folder: Path) -> None:
    (folder / "f0.txt").write_text("wait5")
    begun = time.perf_counter()
    found = process_files(f"{folder}/*", measure, folder.parent / "t.csv")
    assert found["seconds"][0] >= 0.15
    assert found["seconds"].sum() <= time.perf_counter() - begun + 0.002  # four are rounded
    assert found["bytes"].tolist() == [5, 4, 9, 1]
    assert found["modified"].tolist() == [f.stat().st_mtime_ns for f in sorted(folder.iterdir())]


def test_an_empty_table_is_a_new_one(folder: Path) -> None:
    table = folder.parent / "t.csv"
    table.touch()
    assert len(process_files(f"{folder}/*", measure, table)) == 4


@pytest.mark.parametrize("row", [1, 2, 4])
def test_a_row_with_fields_missing_is_done_again(folder: Path, row: int) -> None:
    table, log = folder.parent / "t.csv", folder.parent / "log"
    work = partial(measure, log=log)
    whole = process_files(f"{folder}/*", work, table)
    lines = table.read_text().splitlines()
    lines[row] = ",".join(lines[row].split(",")[:3])
    table.write_text("\n".join(lines) + "\n")
    again = process_files(f"{folder}/*", work, table)
    assert again["value"].dropna().tolist() == whole["value"].dropna().tolist()
    assert log.read_text().split()[4:] == [f"f{row - 1}.txt"]


def test_no_more_is_begun_than_processes_soon_need(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two files a process: more would be lost with one that dies, fewer would leave it idle."""
    held: list[int] = []

    class Pool:
        def __init__(self, *_: object, **__: object) -> None:
            self.shutdown = lambda **_: None

        def submit(self, _: object, path: Path, *__: object) -> Future:
            future: Future = Future()
            future.set_result({"file": str(path)})
            return future

    def wait(begun: dict, return_when: str) -> SimpleNamespace:
        held.append(len(begun))
        return SimpleNamespace(done={next(iter(begun))})

    monkeypatch.setattr(batch, "ProcessPoolExecutor", Pool)
    monkeypatch.setattr(batch, "wait", wait)
    files = [Path(f"{k}.tif") for k in range(20)]
    rows = list(batch._pooled(files[::-1], len, "len", 3, []))
    assert [row["file"] for row in rows] == [str(path) for path in files]
    assert held == [6] * 15 + [5, 4, 3, 2, 1]
