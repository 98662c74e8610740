"""The same measurement on many files, in processes or on a cluster, with a row for each in a table.

A folder of thousands of images takes hours: what is done stays in the table, whatever becomes of
the rest, and a second call goes on where the first one ended.
"""

from __future__ import annotations

import csv
import io
import os
import pickle
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping
from concurrent import futures
from contextlib import closing
from functools import partial
from glob import glob
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from microlib._common import Tidy, end_with_starter, flag, flat_row, of_kind, replace_file

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["process_files"]

#: What a row begins with; the rest is the result's. `modified` tells a file that has changed since.
_OWN = ["file", "error", "modified", "work"]
#: Errors of a file over which a process died: its own fault, or that of one that ran beside it.
_DEATHS = ("BrokenProcessPool", "KilledWorker")

Row = dict[str, Any]


def process_files(
    files: str | Iterable[str | os.PathLike[str]],
    work: Callable[[Path], Any],
    table: str | os.PathLike[str],
    *,
    executor: futures.Executor | None = None,
    retry: bool = False,
    progress: bool = False,
) -> pd.DataFrame:
    """Apply a function to every file and keep a table with a row per file.

    Parameters
    ----------
    files : str or iterable of path-like
        The files, or a pattern such as ``"plates/*.tif"``.
    work : callable
        Takes a `pathlib.Path` and returns a result of this library, a mapping of names to numbers
        and texts, or None. For other processes it must be a function of a module, or
        `functools.partial` of one.
    table : path-like
        The table, a CSV file. If it is there, only files without a row in it are done, and those
        that have changed since.
    executor : concurrent.futures.Executor, optional
        Where the work is done, for example ``dask.distributed.Client(…).get_executor()`` or
        ``mpi4py.futures.MPIPoolExecutor()`` on a cluster. By default a pool with a process for each
        core.
    retry : bool, optional
        Whether files that failed are done again.
    progress : bool, optional
        Whether to show a bar.

    Returns
    -------
    pandas.DataFrame
        One row per file, in the order of `files`: ``file``; ``error``, empty or the reason why it
        failed; ``modified``, the time of the file or folder, ns since 1970; ``work``, what was
        done; then what the result has, missing where it failed. `table` holds the same, as the
        files were done, and the files of earlier calls.

    Raises
    ------
    ValueError
        If there is no file, one stands twice, `table` was made by other `work` or is no such table,
        or `work` cannot be handed to another process. Also if a pool that was given as `executor`
        breaks: what was done is in the table, and a call with a new pool goes on.

    Notes
    -----
    A row is appended as soon as a file is done, and stays there if the process is killed: only what
    was being done is lost. An exception is a row. At most two files for each worker of a pool are
    handed out ahead, and a thousand to a cluster that does not say how many workers it has.

    If a process dies, a new pool goes on; the files that were handed out are done again one by one
    at the end, and the one over which a process dies then is a row with that error. With an
    `executor` all of them are such rows, and ``retry=True`` does them one by one.

    Examples
    --------
    >>> import tempfile
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> from pathlib import Path
    >>> from microlib.batch import process_files
    >>> def count(path):
    ...     return {"words": len(path.read_text().split())}
    >>> with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(2) as threads:
    ...     for name, text in (("a.txt", "one two"), ("b.txt", "three")):
    ...         _ = (Path(folder) / name).write_text(text)
    ...     table = Path(folder) / "words.csv"
    ...     found = process_files(f"{folder}/*.txt", count, table, executor=threads)
    >>> found["words"].tolist()
    [2, 1]
    """
    import pandas as pd  # here, as it takes long to import

    names = _names(files)
    of_kind("work", work, Callable)
    of_kind("table", table, str, os.PathLike)
    of_kind("executor", executor, futures.Executor, type(None))
    again, bar = flag("retry", retry), flag("progress", progress)
    target = Path(table).expanduser()
    if not target.parent.is_dir():
        raise ValueError(f"table must lie in an existing folder, got {target.parent}")
    description = _description(work)
    rows = _read(target, description)
    due, todo, suspects = dict[str, str](), deque[str](), deque[str]()
    for name in names:
        modified = str(os.stat(name).st_mtime_ns) if os.path.exists(name) else "0"
        row = rows.get(name)
        if row is None or row["modified"] != modified or (again and row["error"]):
            due[name] = modified
            (suspects if row and row["error"].startswith(_DEATHS) else todo).append(name)
            rows.pop(name, None)
    columns: list[str] = []
    with closing(_done(executor, work, todo, suspects)) as done:
        for name, future in tqdm(done, total=len(due), disable=not bar):
            row = {"file": name, "error": "", "modified": due[name], "work": description}
            try:
                row |= future.result()
            except Exception as error:  # of the work, or of a process that died
                row["error"] = f"{type(error).__name__}: {' '.join(str(error).split())}"
            rows[name] = row
            if row.keys() <= set(columns):
                _write(columns, [row], target, "a")
            else:  # the first row, or one that brings columns: the table is written anew
                columns = list(dict.fromkeys(column for row in rows.values() for column in row))
                header = dict(zip(columns, columns, strict=True))
                replace_file(target, partial(_write, columns, [header, *rows.values()]))
    # A text such as NA stays one.
    texts: dict[str, Any] = {"dtype": dict.fromkeys(("file", "error", "work"), str)}
    texts |= {"keep_default_na": False, "na_values": [""], "encoding_errors": "surrogateescape"}
    found = pd.read_csv(target, **texts)
    return found.fillna({"error": ""}).set_index("file").loc[names].reset_index()


def _names(files: Any) -> list[str]:
    """Return the files' paths as texts."""
    if isinstance(files, str):
        files = sorted(glob(str(Path(files).expanduser()), recursive=True))
    try:
        names = [str(Path(file).expanduser()) for file in files]
    except TypeError:
        raise ValueError(f"files must be paths or a pattern, got {files!r:.80}") from None
    if len(set(names)) != len(names) or not names:
        raise ValueError(f"files must name at least one file and each once, got {names[:3]}")
    return names


def _description(work: Any) -> str:
    """Name a function and its settings, which a table must not mix."""
    if isinstance(work, partial):
        settings = [*map(repr, work.args), *(f"{k}={v!r}" for k, v in work.keywords.items())]
        return f"{_description(work.func)}({', '.join(settings)})"
    return getattr(work, "__qualname__", type(work).__qualname__)


def _processes(work: object) -> futures.Executor:
    try:
        pickle.dumps(work)
    except Exception as error:
        need = f"work must be a function of a module for other processes, got {_description(work)}"
        raise ValueError(f"{need}: {error}") from error
    # Spawned: a fork of a process with threads may hang.
    spawn = get_context("spawn")
    return futures.ProcessPoolExecutor(mp_context=spawn, initializer=end_with_starter)


def _done(
    executor: futures.Executor | None, work: Callable, todo: deque[str], suspects: deque[str]
) -> Generator[tuple[str, futures.Future[Row]], None, None]:
    """Yield each file as it is done: first those `todo`, then the `suspects` one by one."""
    pool = executor or _processes(work)
    running: dict[futures.Future[Row], str] = {}
    # Threads of several processes that wait for one core make a calibration ten times slower;
    # processes begin as they get work, with the environment of that moment.
    unset = {f"{library}_NUM_THREADS" for library in ("OPENBLAS", "OMP", "MKL")} - os.environ.keys()
    os.environ |= dict.fromkeys(unset, "1")
    try:
        # The scheduler of a cluster does not say how many workers it has.
        for names, most in ((todo, 2 * getattr(pool, "_max_workers", 500)), (suspects, 1)):
            while names or running:
                while names and len(running) < most:
                    try:
                        future = pool.submit(_values, work, names[0])
                        running[future] = names.popleft()
                    except futures.BrokenExecutor as error:
                        if running:  # lost with it, as they tell below
                            break
                        if executor:
                            raise ValueError("executor must work, got a broken one") from error
                        pool = _processes(work)
                futures.wait(running, return_when=futures.FIRST_COMPLETED)
                future = next(future for future in running if future.done())
                name = running.pop(future)
                lost = executor is None and isinstance(future.exception(), futures.BrokenExecutor)
                if lost and names is todo:
                    suspects.append(name)
                else:
                    yield name, future
    finally:
        for name in unset:
            os.environ.pop(name, None)
        for future in running:
            future.cancel()
        if executor is None:
            pool.shutdown()


def _read(path: Path, description: str) -> dict[str, Row]:
    """Return the rows of a table by file; one that was cut off is left out."""
    try:
        text = path.read_text("utf-8", "surrogateescape") if path.exists() else ""
        reader = csv.DictReader(io.StringIO(text[: text.rfind("\n") + 1]))
        rows = {row["file"]: row for row in reader if None not in (*row, *row.values())}
        if text and list(reader.fieldnames or ())[: len(_OWN)] != _OWN:
            raise KeyError
    except (OSError, KeyError, csv.Error):
        raise ValueError(f"table must be one that process_files wrote, got {path}") from None
    if others := {row["work"] for row in rows.values()} - {description}:
        need = f"table must be of the same work, now {description}"
        raise ValueError(f"{need}, got {path} with {min(others)}: name another file")
    return rows


def _write(columns: list[str], rows: Iterable[Row], path: Path, mode: str = "w") -> None:
    with path.open(mode, encoding="utf-8", errors="surrogateescape", newline="") as stream:
        csv.DictWriter(stream, columns, lineterminator="\n").writerows(rows)


def _values(work: Callable[[Path], Any], name: str) -> Row:
    result = work(Path(name))
    of_kind("what work returns", result, Tidy, Mapping, type(None))
    row = result.to_dict() if isinstance(result, Tidy) else flat_row(result or {})
    if clash := sorted(set(row) & set(_OWN)):
        raise ValueError(f"what work returns must not have {', '.join(clash)}: a row has them")
    return row
