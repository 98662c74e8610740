"""The same measurement on many files, in processes or on a cluster, with a row for each in a table.

A folder of thousands of images takes hours: what is done stays in the table, whatever becomes of
the rest, and a second call goes on where the first one ended.
"""

from __future__ import annotations

import csv
import io
import multiprocessing
import os
import pickle
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from functools import partial
from glob import glob
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from microlib._common import Tidy, end_with_starter, flag, flat_row, of_kind, replace_file

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["process_files"]

#: What a row begins with; the rest is the result's. `modified` tells a file that has changed since.
_OWN = ["file", "error", "modified", "work"]
#: Of the table; names of files in another encoding are kept as they are.
_ENCODING = {"encoding": "utf-8", "errors": "surrogateescape"}
#: Threads of several processes that wait for one core make a calibration ten times slower.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

Row = dict[str, Any]


def process_files(
    files: str | Iterable[str | PathLike[str]],
    work: Callable[[Path], Any],
    table: str | PathLike[str],
    *,
    executor: Executor | None = None,
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
        Where the work is done, for example ``dask.distributed.Client(…).get_executor()`` on a
        cluster. By default a pool with a process for each core.
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
        or `work` cannot be handed to another process.

    Notes
    -----
    A row is appended as soon as a file is done, and stays there if the process is killed: only what
    was being done is lost. An exception is a row. If a process dies over a file, all files that
    were being done are rows with that error; ``retry=True`` does them again.

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
    of_kind("table", table, str, PathLike)
    of_kind("executor", executor, Executor, type(None))
    again, bar = flag("retry", retry), flag("progress", progress)
    target = Path(table).expanduser()
    if not target.parent.is_dir():
        raise ValueError(f"table must lie in an existing folder, got {target.parent}")
    description = _description(work)
    pool = executor or _processes(work, description)
    rows = _read(target, description)
    due: dict[str, str] = {}
    for name in names:
        modified = str(os.stat(name).st_mtime_ns) if os.path.exists(name) else "0"
        row = rows.get(name)
        if row is None or row["modified"] != modified or (again and row["error"]):
            due[name] = modified
            rows.pop(name, None)
    # Processes begin as they get work, with the environment of that moment.
    unset = [name for name in _THREADS if name not in os.environ]
    os.environ |= dict.fromkeys(unset, "1")
    try:
        futures = {pool.submit(_values, work, name): name for name in due}
    finally:
        for name in unset:
            del os.environ[name]
    columns: list[str] = []
    try:
        for future in tqdm(as_completed(futures), total=len(due), disable=not bar):
            name = futures[future]
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
    finally:
        for future in futures:
            future.cancel()
        if executor is None:
            pool.shutdown()
    found = pd.read_csv(
        target,
        dtype=dict.fromkeys(("file", "error", "work"), str),
        keep_default_na=False,
        na_values=[""],
        encoding_errors="surrogateescape",
    )
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


def _processes(work: object, description: str) -> Executor:
    try:
        pickle.dumps(work)
    except Exception as error:
        need = "work must be a function of a module to be handed to other processes"
        raise ValueError(f"{need}, got {description}: {error}") from error
    # Spawned: a fork of a process with threads may hang.
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(mp_context=spawn, initializer=end_with_starter)


def _read(path: Path, description: str) -> dict[str, Row]:
    """Return the rows of a table by file; one that was cut off is left out."""
    try:
        text = path.read_text(**_ENCODING) if path.exists() else ""
        reader = csv.DictReader(io.StringIO(text[: text.rfind("\n") + 1]))
        rows = {row["file"]: row for row in reader if None not in (*row, *row.values())}
        own = not text or list(reader.fieldnames or ())[: len(_OWN)] == _OWN
    except (OSError, KeyError, csv.Error):
        own = False
    if not own:
        raise ValueError(f"table must be one that process_files wrote, got {path}")
    if others := {row["work"] for row in rows.values()} - {description}:
        raise ValueError(
            f"table must be of the same work, got {path} with {min(others)}, now {description}: "
            "name another file"
        )
    return rows


def _write(columns: list[str], rows: Iterable[Row], path: Path, mode: str = "w") -> None:
    with path.open(mode, newline="", **_ENCODING) as stream:  # type: ignore[call-overload]
        csv.DictWriter(stream, columns, lineterminator="\n").writerows(rows)


def _values(work: Callable[[Path], Any], name: str) -> Row:
    result = work(Path(name))
    of_kind("what work returns", result, Tidy, Mapping, type(None))
    row = result.to_dict() if isinstance(result, Tidy) else flat_row(result or {})
    if clash := sorted(set(row) & set(_OWN)):
        raise ValueError(f"what work returns must not have {', '.join(clash)}: a row has them")
    return row
