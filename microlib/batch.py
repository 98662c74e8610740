"""The same measurement on many files, in processes or on a cluster, with a row for each in a table.

A folder of thousands of images takes hours: what is done stays in the table, whatever becomes of
the rest, and a second call goes on where the first one ended.
"""

from __future__ import annotations

import csv
import multiprocessing
import os
import pickle
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from functools import partial
from glob import glob
from io import StringIO
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

Work = Callable[[Path], Any]


def process_files(
    files: str | Iterable[str | PathLike[str]],
    work: Work,
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
        failed; ``modified``, the file's time in ns since 1970; ``work``, what was done; then what
        the result has, missing where it failed. `table` holds the same,
        and after these the files of earlier calls.

    Raises
    ------
    ValueError
        If there is no file, one stands twice, `table` was made by other `work` or is no such table,
        or `work` cannot be handed to another process.

    Notes
    -----
    Each row is written as its file is done, so that a process that is killed loses what was being
    done and nothing else. An exception is a row. If a process dies over a file, all files that were
    being done are rows with that error; ``retry=True`` does them again.

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

    paths = _paths(files)
    if not callable(work):
        raise ValueError(f"work must be a function of a path, got {type(work).__name__}")
    of_kind("table", table, str, PathLike)
    of_kind("executor", executor, Executor, type(None))
    again, bar = flag("retry", retry), flag("progress", progress)
    if executor is None:
        try:
            pickle.dumps(work)
        except Exception as error:
            raise ValueError(
                "work must be a function of a module to be handed to other processes, got "
                f"{_description(work)}: {error}"
            ) from error
    target = Path(table).expanduser()
    if not target.parent.is_dir():
        raise ValueError(f"table must lie in an existing folder, got {target.parent}")
    description = _description(work)
    rows = _read(target, description)
    due = []
    for path in paths:
        row = rows.get(str(path))
        if row is None or row["modified"] != str(_modified(path)) or (again and row["error"]):
            due.append(path)
    columns = list(dict.fromkeys([*_OWN, *(name for row in rows.values() for name in row)]))
    for row in tqdm(_rows(due, work, description, executor), total=len(due), disable=not bar):
        known = row["file"] in rows
        rows[row["file"]] = row
        if not known and set(row) <= set(columns) and target.exists():
            with target.open("a", encoding="utf-8", newline="") as file:
                csv.writer(file).writerow([row.get(name, "") for name in columns])
        else:  # new columns, or a row that changes
            columns = list(dict.fromkeys([*columns, *row]))
            _write(target, list(rows.values()), columns)
    asked = {str(path): rows[str(path)] for path in paths}
    _write(target, list((asked | rows).values()), columns)
    found = pd.read_csv(target, dtype=dict.fromkeys(("file", "error", "work"), str))
    return found.fillna({"error": ""})[: len(paths)]


def _write(path: Path, rows: list[dict[str, Any]], columns: list[str]) -> None:
    text = StringIO(newline="")
    csv.DictWriter(text, columns).writeheader()
    csv.DictWriter(text, columns).writerows(rows)
    replace_file(path, partial(Path.write_bytes, data=text.getvalue().encode()))


def _paths(files: object) -> list[Path]:
    if isinstance(files, str):
        names: list[Any] = sorted(glob(str(Path(files).expanduser()), recursive=True))
    else:
        try:
            names = list(files)  # type: ignore[call-overload]
        except TypeError:
            kind = type(files).__name__
            raise ValueError(f"files must be paths or a pattern, got {kind}") from None
        for name in names:
            of_kind("files", name, str, PathLike)
    found = [Path(name).expanduser() for name in names]
    if not found:
        raise ValueError(f"files must name at least one file, got none for {files!r}")
    if twice := [path for path, count in Counter(found).items() if count > 1]:
        raise ValueError(f"files must name each file once, got {twice[0]} twice")
    return found


def _description(work: Work) -> str:
    """Name a function and its settings, which a table must not mix."""
    if isinstance(work, partial):
        settings = [*map(repr, work.args), *(f"{k}={v!r}" for k, v in work.keywords.items())]
        return f"{_description(work.func)}({', '.join(settings)})"
    return getattr(work, "__qualname__", type(work).__qualname__)


def _modified(path: Path) -> int:
    """Return the time of a file, of a folder the latest of its files; 0 where there is none."""
    files = [path, *path.iterdir()] if path.is_dir() else [path]
    return max(file.stat().st_mtime_ns if file.exists() else 0 for file in files)


def _read(path: Path, description: str) -> dict[str, dict[str, Any]]:
    """Return the rows of a table; one that was cut off is left out."""
    if not path.exists() or not path.stat().st_size:
        return {}
    try:
        text = path.read_bytes().decode()
        lines = list(csv.reader(StringIO(text[: text.rfind("\n") + 1], newline="")))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"table must be a CSV file, got {path}: {error}") from error
    if not lines or lines[0][: len(_OWN)] != _OWN:
        raise ValueError(f"table must be one that process_files wrote, got {path}")
    rows = [
        dict(zip(lines[0], line, strict=True)) for line in lines[1:] if len(line) == len(lines[0])
    ]
    if others := {row["work"] for row in rows} - {description}:
        raise ValueError(
            f"table must be of the same work, got {path} with {sorted(others)[0]}, now "
            f"{description}: name another file"
        )
    if not text.endswith("\n"):  # what follows would be appended to the row that was cut off
        whole = text[: text.rfind("\n") + 1]
        replace_file(path, lambda file: file.write_bytes(whole.encode()))
    return {row["file"]: row for row in rows}


def _rows(
    due: list[Path], work: Work, description: str, executor: Executor | None
) -> Iterator[dict[str, Any]]:
    if not due:
        return
    pool = executor
    if pool is None:
        # Spawned: a fork of a process with threads may hang.
        spawn = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(
            min(len(due), os.cpu_count() or 1), mp_context=spawn, initializer=end_with_starter
        )
    try:
        with _one_thread_each():
            futures = {pool.submit(_values, work, path): path for path in due}
        for future in as_completed(futures):
            path = futures[future]
            row = {"file": str(path), "error": "", "modified": _modified(path), "work": description}
            try:
                row |= future.result()
            except Exception as error:  # of the work, or of a process that died
                row["error"] = f"{type(error).__name__}: {' '.join(str(error).split())}"
            yield row
    finally:
        if executor is None:
            pool.shutdown(wait=True, cancel_futures=True)


def _values(work: Work, path: Path) -> dict[str, Any]:
    result = work(path)
    if not isinstance(result, (Tidy, Mapping, type(None))):
        raise TypeError(
            f"work must return a result, a mapping or None, got {type(result).__name__}"
        )
    row = result.to_dict() if isinstance(result, Tidy) else flat_row(result or {})
    if clash := sorted(set(row) & set(_OWN)):
        raise TypeError(f"work must not return {', '.join(clash)}: a row has them already")
    return row


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Let processes that begin meanwhile have one thread of linear algebra, unless told.

    Threads of several processes that wait for one core make a calibration ten times slower.
    """
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    unset = [name for name in names if name not in os.environ]
    os.environ.update(dict.fromkeys(unset, "1"))
    try:
        yield
    finally:
        for name in unset:
            del os.environ[name]
