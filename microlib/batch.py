"""The same measurement on many files, in processes or on a cluster, with a row for each in a table.

A folder of thousands of images takes hours: what is done stays in the table, whatever becomes of
the rest, and a second call goes on where the first one ended.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from functools import partial
from glob import glob
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from microlib._common import (
    Tidy,
    check_callable,
    end_with_starter,
    flag,
    flat_row,
    of_kind,
    replace_file,
)

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["process_files"]

#: What a row begins with; the rest is the result's. `modified` tells a file that has changed since.
_OWN = ["file", "error", "modified", "work"]

#: Times as long as writing the table takes is between two writings: a twentieth goes into it.
_PAUSE = 20
#: Threads of several processes that wait for one core make a calibration ten times slower.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

Work = Callable[[Path], Any]
Row = dict[str, Any]


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
    The table is written whole as files are done, a twentieth of the time at most, and at the end,
    also of a call that is interrupted. A process that is killed loses what was being done, and of
    a table of ten thousand rows what was done in its last second. An exception is a row. If a
    process dies over a file, all files that were being done are rows with that error;
    ``retry=True`` does them again.

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
    check_callable("work", work)
    of_kind("table", table, str, PathLike)
    of_kind("executor", executor, Executor, type(None))
    again, bar = flag("retry", retry), flag("progress", progress)
    target = Path(table).expanduser()
    if not target.parent.is_dir():
        raise ValueError(f"table must lie in an existing folder, got {target.parent}")
    description = _description(work)
    rows = _read(target, description)

    def write() -> None:
        asked = {str(path): rows[str(path)] for path in paths if str(path) in rows}
        content = pd.DataFrame(list((asked | rows).values()), dtype=object).to_csv(index=False)
        replace_file(target, lambda file: file.write_bytes(content.encode()))

    due = []
    for path in paths:
        row = rows.get(str(path))
        if row is None or row["modified"] != str(_modified(path)) or (again and row["error"]):
            due.append(path)
    done = tqdm(_done(due, work, executor), total=len(due), disable=not bar)
    next_time = 0.0
    try:
        for row in done:
            rows[row["file"]] = row | {"work": description}
            if time.monotonic() >= next_time:
                begin = time.thread_time()
                write()
                next_time = time.monotonic() + _PAUSE * (time.thread_time() - begin)
    finally:
        if due and rows:
            write()
    found = pd.read_csv(target, dtype=dict.fromkeys(("file", "error", "work"), str))
    order = pd.Index(found["file"]).get_indexer([str(path) for path in paths])
    return found.fillna({"error": ""}).iloc[order].reset_index(drop=True)


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


def _read(path: Path, description: str) -> dict[str, Row]:
    """Return the rows of a table; one that was cut off before `work` is left out."""
    import pandas as pd

    if not path.exists() or not path.stat().st_size:
        return {}
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
    except (OSError, ValueError) as error:
        raise ValueError(f"table must be a CSV file, got {path}: {error}") from error
    if list(table.columns[: len(_OWN)]) != _OWN:
        raise ValueError(f"table must be one that process_files wrote, got {path}")
    if others := set(table["work"]) - {description, ""}:
        raise ValueError(
            f"table must be of the same work, got {path} with {min(others)}, now {description}: "
            "name another file"
        )
    return {str(row["file"]): dict(row) for _, row in table.iterrows() if row["work"]}


def _done(due: list[Path], work: Work, executor: Executor | None) -> Iterator[Row]:
    """Yield the row of each file as it is done."""
    pool = executor or _processes(work, len(due))
    unset = [name for name in _THREADS if name not in os.environ]
    os.environ.update(dict.fromkeys(unset, "1"))  # for processes, which begin as they get work
    try:
        futures = {pool.submit(_values, work, path): path for path in due}
    finally:
        for name in unset:
            del os.environ[name]
    try:
        for future in as_completed(futures):
            path = futures[future]
            row = dict.fromkeys(_OWN, "") | {"file": str(path), "modified": _modified(path)}
            try:
                row |= future.result()
            except Exception as error:  # of the work, or of a process that died
                row["error"] = f"{type(error).__name__}: {' '.join(str(error).split())}"
            yield row
    finally:
        if executor is None:
            pool.shutdown(wait=True, cancel_futures=True)


def _processes(work: Work, count: int) -> Executor:
    try:
        pickle.dumps(work)
    except Exception as error:
        raise ValueError(
            "work must be a function of a module to be handed to other processes, got "
            f"{_description(work)}: {error}"
        ) from error
    # Spawned: a fork of a process with threads may hang.
    spawn = multiprocessing.get_context("spawn")
    workers = max(1, min(count, os.cpu_count() or 1))
    return ProcessPoolExecutor(workers, mp_context=spawn, initializer=end_with_starter)


def _values(work: Work, path: Path) -> Row:
    result = work(path)
    of_kind("what work returns", result, Tidy, Mapping, type(None))
    row = result.to_dict() if isinstance(result, Tidy) else flat_row(result or {})
    if clash := sorted(set(row) & set(_OWN)):
        raise ValueError(f"what work returns must not have {', '.join(clash)}: a row has them")
    return row
