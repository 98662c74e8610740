"""Many files: a row each, kept through failures, dead processes, kills and second runs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from threading import Event

import pandas as pd
import pytest

from microlib.batch import process_files
from microlib.microscope import Microscope
from tests.running import THREADS, alive, measure, until

ROOT = Path(__file__).parents[1]
LAWS = {"batch.process_files": "it computes nothing; its laws of a second use are below"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    place = tmp_path / "files"
    place.mkdir()
    for k, text in enumerate(["3.5", "1e-3", "no number", "7"]):
        (place / f"f{k}.txt").write_text(text)
    return place


@pytest.fixture
def run(tmp_path: Path):
    """Do the work in a thread, into one table."""
    with ThreadPoolExecutor(1) as executor:
        yield partial(process_files, table=tmp_path / "t.csv", executor=executor)


def test_a_row_per_file_and_failures_among_them(folder: Path, monkeypatch) -> None:
    table = folder.parent / "t.csv"
    monkeypatch.delenv(THREADS[0], raising=False)
    monkeypatch.setenv(THREADS[1], "2")
    found = process_files(f"{folder}/*.txt", partial(measure, factor=2.0), table)
    assert found["file"].tolist() == [str(folder / f"f{k}.txt") for k in range(4)]
    assert found["value"].dropna().tolist() == [7.0, 2e-3, 14.0]
    assert found["odd"].dropna().tolist() == [False, False, True]
    assert found["error"].drop(2).tolist() == ["", "", ""]
    assert set(found["threads"].dropna()) == {"1-2"}
    assert THREADS[0] not in os.environ
    assert found["error"][2].startswith("ValueError: could not convert string to float")
    assert found["modified"].tolist() == [f.stat().st_mtime_ns for f in sorted(folder.iterdir())]
    kept = pd.read_csv(table).fillna({"error": ""}).sort_values("file", ignore_index=True)
    pd.testing.assert_frame_equal(kept, found[kept.columns])
    assert sorted(p.name for p in folder.parent.iterdir()) == ["files", "t.csv"]


def test_only_what_is_missing_or_has_changed_is_done(folder: Path, run) -> None:
    log = folder.parent / "log"
    work = partial(measure, log=log)
    assert len(run(sorted(folder.iterdir())[:3], work)) == 3
    (folder / "f1.txt").write_text("22")
    found = run(sorted(folder.iterdir()), work)
    assert found["value"].dropna().tolist() == [3.5, 22.0, 7.0]
    assert log.read_text().split() == ["f0.txt", "f1.txt", "f2.txt", "f1.txt", "f3.txt"]
    run(sorted(folder.iterdir()), work, retry=True)
    assert log.read_text().split()[5:] == ["f2.txt"]
    # Fewer files: the others' rows stay in the table, and are not what was asked for.
    assert len(run([folder / "f3.txt"], work)) == 1
    assert len(pd.read_csv(folder.parent / "t.csv")) == 4


def test_a_result_of_the_library_is_a_row(folder: Path, run) -> None:
    found = run(f"{folder}/f0*", lambda path: Microscope(2e5, 1e5, 5e4, image_size=(656, 491)))
    assert found[["image_size_width", "focal_length"]].to_numpy().tolist() == [[656, 1e5]]
    results = {"f1.txt": 3, "f2.txt": {"file": 1}, "f3.txt": [1]}
    found = run(f"{folder}/f[123]*", lambda path: results[path.name])
    assert found["error"].str.startswith("ValueError: what work returns must").all()


def test_columns_may_come_later_and_names_in_any_encoding(folder: Path, run) -> None:
    """A table that begins with a failure, and a name that no text can be."""
    (folder / "f0.txt").write_text("no number either")
    odd = os.fsdecode(bytes(folder) + b"/\xe9.txt")
    Path(odd).write_text("5")
    found = run([folder / "f0.txt", odd, folder / "f3.txt"], measure)
    assert found["value"].tolist()[1:] == [5.0, 7.0]
    assert found["file"][1] == odd


def test_only_the_file_over_which_a_process_dies_is_an_error(folder: Path) -> None:
    """Those that ran beside it are done, in this call and in one that tries again."""
    log, table = folder.parent / "log", folder.parent / "t.csv"
    for k in range(4, 20):
        (folder / f"f{k}.txt").write_text(f"wait{k}")
    (folder / "f2.txt").write_text("die")
    for retry in (False, True):
        found = process_files(f"{folder}/*", partial(measure, log=log), table, retry=retry)
        died = found["error"].str.startswith("BrokenProcessPool")
        assert found["file"][died].tolist() == [str(folder / "f2.txt")]
        assert (found["error"] == "").sum() == 19
    # Beside the guilty one, tried twice and once more, only what was handed out is done again.
    calls = log.read_text().split()
    assert calls.count("f2.txt") == 3
    assert len(calls) - 22 <= 2 * (os.cpu_count() or 1) - 1


def test_a_broken_executor_is_refused_and_a_new_one_goes_on(folder: Path) -> None:
    table = folder.parent / "t.csv"
    for k in range(20):
        (folder / f"f{k:02d}.txt").write_text("die" if k < 2 else f"wait{k}")
    spawn = get_context("spawn")
    with (
        ProcessPoolExecutor(2, mp_context=spawn) as pool,
        pytest.raises(ValueError, match="executor must work, got a broken one"),
    ):
        process_files(f"{folder}/f??.txt", measure, table, executor=pool)
    kept = pd.read_csv(table).fillna({"error": ""})
    assert len(kept) <= 6  # what two processes had in hand twice over; the first one dies at once
    assert kept["error"].str.startswith("BrokenProcessPool").sum() <= 4
    with ThreadPoolExecutor(1) as threads:  # one by one, and no process to die
        for k in range(2):
            (folder / f"f{k:02d}.txt").write_text(f"{k}")
        found = process_files(f"{folder}/f??.txt", measure, table, executor=threads, retry=True)
    assert found["value"].tolist() == list(range(20))


def test_few_files_are_handed_out_ahead_and_suspects_one_by_one(folder: Path) -> None:
    most = []

    class Counting(ThreadPoolExecutor):
        handed = 0

        def submit(self, function, *arguments):
            future = super().submit(function, *arguments)
            self.handed += 1
            most.append(self.handed)
            future.add_done_callback(lambda _: setattr(self, "handed", self.handed - 1))
            return future

    table = folder.parent / "t.csv"
    for k in range(12):
        (folder / f"g{k:02d}.txt").write_text(f"wait{k}")
    with Counting(3) as pool:
        found = process_files(f"{folder}/g*", measure, table, executor=pool)
    assert 3 < max(most) <= 6
    found.loc[[2, 5, 9], "error"] = "KilledWorker: of a cluster"
    found.to_csv(table, index=False)
    most.clear()
    with Counting(3) as pool:
        found = process_files(f"{folder}/g*", measure, table, executor=pool, retry=True)
    assert most == [1, 1, 1]
    assert found["value"].tolist() == list(range(12))


def test_a_cluster_of_which_a_process_is_killed(folder: Path) -> None:
    """Dask does what the killed worker had in hand on the other."""
    distributed = pytest.importorskip("distributed", reason="dask is not installed")
    for k in range(12):
        (folder / f"g{k:02d}.txt").write_text(f"wait{k}")
    table, log = folder.parent / "t.csv", folder.parent / "log"
    killed = []

    def kill() -> None:
        until(lambda: table.exists() and table.read_text().count("\n") >= 3)
        killed.append(int(pd.read_csv(table)["pid"][0]))
        os.kill(killed[0], signal.SIGKILL)

    with (
        distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=":0") as cluster,
        distributed.Client(cluster) as client,
        ThreadPoolExecutor(1) as killer,
    ):
        future = killer.submit(kill)
        work = partial(measure, log=log)
        found = process_files(f"{folder}/g*", work, table, executor=client.get_executor())
        future.result()
    assert found["value"].tolist() == list(range(12))
    assert (found["error"] == "").all()
    assert killed[0] in set(found["pid"])


def measure_all(folder: Path) -> None:
    work = partial(measure, log=folder.parent / "log")
    process_files(f"{folder}/*", work, folder.parent / "t.csv")


def test_a_killed_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    folder, table, log = (tmp_path / name for name in ("files", "t.csv", "log"))
    folder.mkdir()
    for k in range(24):
        (folder / f"{k:02d}.txt").write_text(f"wait{k}")
    script = f"from tests.test_batch import *; measure_all(Path({str(folder)!r}))"
    run = subprocess.Popen([sys.executable, "-c", script], cwd=ROOT)
    until(lambda: table.exists() and table.read_text().count("\n") >= 6)
    run.send_signal(signal.SIGKILL)
    run.wait()
    done = pd.read_csv(table)
    assert len(done) >= 5
    until(lambda: not any(map(alive, done["pid"])))  # the workers end, too
    measure_all(folder)
    assert pd.read_csv(table).sort_values("file")["value"].tolist() == list(range(24))
    calls = log.read_text().split()
    assert len(calls) - 24 <= (os.cpu_count() or 1) + 1  # what the processes had in hand


def test_other_settings_and_other_tables_are_refused(folder: Path, run) -> None:
    table = folder.parent / "t.csv"
    run(f"{folder}/*", partial(measure, factor=1.0))
    before = table.read_bytes()
    for other in (partial(measure, factor=2.0), partial(measure, 7, factor=1.0), measure):
        with pytest.raises(ValueError, match=r"table must be of the same work, .*factor=1\.0"):
            run(f"{folder}/*", other)
    assert table.read_bytes() == before
    for text in ("a,b\n1,2\n", "a note", "file,error\n", "\0"):
        table.write_text(text)
        with pytest.raises(ValueError, match="table must be one that process_files wrote"):
            run(f"{folder}/*", measure)
        assert table.read_text() == text


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"files": "none/*.tif"}, "files must name at least one"),
        ({"files": ["a", "a"]}, "files must name at least one file and each once, got"),
        ({"files": None}, "files must be paths or a pattern, got None"),
        ({"work": 3}, "work must be of the kind Callable, got int"),
        ({"work": lambda path: {}, "executor": None}, "work must be a function of a module"),
        ({"table": "nowhere/t.csv"}, "table must lie in an existing folder"),
    ],
)
def test_what_cannot_work_is_refused(folder: Path, change: dict, match: str, run) -> None:
    with pytest.raises(ValueError, match=match):
        run(**({"files": f"{folder}/*", "work": measure} | change))
    assert not (folder.parent / "t.csv").exists()


def test_what_has_not_begun_is_taken_back_from_an_interrupted_run(folder: Path, run) -> None:
    calls, ended = [], Event()

    def work(path: Path) -> None:
        calls.append(path.name)
        if path.name == "f0.txt":
            raise KeyboardInterrupt
        ended.wait(30)

    with ThreadPoolExecutor(2) as executor:  # is handed four files, of which three may have begun
        with pytest.raises(KeyboardInterrupt):
            run(f"{folder}/*", work, executor=executor)
        ended.set()
    assert "f3.txt" not in calls


CUTS = [lambda text, n=n: text[:-n] for n in (1, 8, 36)]


@pytest.mark.parametrize("cut", [*CUTS, lambda text: text.rpartition(",")[0] + "\n"])
def test_a_table_that_is_cut_off_is_gone_on_with(folder: Path, run, cut) -> None:
    work = partial(measure, log=folder.parent / "log")
    run(f"{folder}/*", work)
    table = folder.parent / "t.csv"
    table.write_text(cut(table.read_text()))
    again = run(f"{folder}/*", work)
    assert again["value"].dropna().tolist() == [3.5, 1e-3, 7.0]
    assert (folder.parent / "log").read_text().split()[4:] == ["f3.txt"]
    assert len(pd.read_csv(table)) == 4
