"""Apply one function to many files: a row per file, kept as it comes, and only what is missing.

What a night of images needs and a loop does not give: several processes, a failure that costs one
row, a table that survives a kill, and a second run that does not begin anew.
"""

from __future__ import annotations

import csv
import io
import json
import multiprocessing
import os
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from os import PathLike
from pathlib import Path
from time import perf_counter
from typing import Any

import cv2
import numpy as np
import pandas as pd

from microlib._common import Tidy, end_with_starter, flag, flat_row, of_kind, replace_file, whole

__all__ = ["process_files"]

#: What a row begins with; the rest is the result's.
_OWN = ("file", "error", "seconds", "bytes", "modified", "work")
#: What the libraries of linear algebra read when they are loaded.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
#: Files that are handed to a process before it asks: it never waits, and few are done twice.
_AHEAD = 2

Row = dict[str, Any]
Work = Callable[[Path], Any]


def process_files(
    files: str | Iterable[str | PathLike[str]],
    work: Work,
    table: str | PathLike[str],
    *,
    workers: int = 1,
    retry: bool = False,
    progress: Callable[[int, int], object] | None = None,
) -> pd.DataFrame:
    """Apply a function to every file and keep a table with a row per file.

    Parameters
    ----------
    files : str or iterable of path-like
        The files, or folders, or a pattern such as ``"plates/*.tif"``.
    work : callable
        Takes a `pathlib.Path` and returns a result of this library, a mapping of names to numbers
        and texts, or None. With several `workers` it must be a function of a module, or
        `functools.partial` of one.
    table : path-like
        The table, a CSV file. If it is there, only files without a row in it are done, and those
        that have changed since, by size or time.
    workers : int, optional
        Processes. With one the files are done in this process.
    retry : bool, optional
        Whether files that failed are done again.
    progress : callable, optional
        Called with the number of files that are done and of all, after each.

    Returns
    -------
    pandas.DataFrame
        One row per file, in the order of `files`: ``file``; ``error``, empty or the reason why it
        failed; ``seconds``; ``bytes`` and ``modified`` (ns since 1970) of the file; ``work``, what
        was done; then what the result has, missing where it failed. `table` holds the same.

    Raises
    ------
    ValueError
        If there is no file, one stands twice, `table` was made by other `work`, is no such table or
        is being written by another call, or `work` cannot be handed to another process.

    Notes
    -----
    Each row is written as its file is done, so that a process that is killed loses what was being
    done and nothing else; a row that was cut off is left out and done again. An exception is a row,
    and so is a process that dies over a file, which is tried a second time by itself.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> def count(path):
    ...     return {"words": len(path.read_text().split())}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name, text in (("a.txt", "one two"), ("b.txt", "three")):
    ...         _ = (Path(folder) / name).write_text(text)
    ...     found = process_files(f"{folder}/*.txt", count, Path(folder) / "words.csv")
    >>> found["words"].tolist()
    [2, 1]
    """
    paths = _paths(files)
    if not callable(work):
        raise ValueError(f"work must be a function of a path, got {type(work).__name__}")
    of_kind("table", table, str, PathLike)
    count, again = whole("workers", workers, least=1), flag("retry", retry)
    if progress is not None and not callable(progress):
        raise ValueError(f"progress must be a function, got {type(progress).__name__}")
    if count > 1:
        _check_pickles(work)
    target = Path(table).expanduser()
    if not target.parent.is_dir():
        raise ValueError(f"table must lie in an existing folder, got {target.parent}")
    with _Table.opened(target, _description(work)) as kept:
        due = [path for path in paths if not kept.has(path, again)]
        done = len(paths) - len(due)
        for row in _rows(due, work, count):
            kept.add(row)
            done += 1
            if progress is not None:
                progress(done, len(paths))
        kept.arrange([str(path) for path in paths])
    texts = dict.fromkeys(("file", "error", "work"), str)
    found = pd.read_csv(target, dtype=texts).fillna({"error": ""})
    asked = found[found["file"].isin({str(path) for path in paths})]
    return asked.reset_index(drop=True)


def _paths(files: object) -> list[Path]:
    if isinstance(files, str):
        pattern = Path(files).expanduser()
        parts = pattern.parts
        first = next((k for k, p in enumerate(parts) if any(c in p for c in "*?[")), len(parts))
        if first == len(parts):
            raise ValueError(f"files must be a list of paths or a pattern with *, got {files!r}")
        found = sorted(Path(*parts[:first]).glob(str(Path(*parts[first:]))))
    elif isinstance(files, Iterable) and not isinstance(files, (bytes, Mapping, np.ndarray)):
        items = list(files)
        if not all(isinstance(item, (str, PathLike)) for item in items):
            kinds = sorted({type(item).__name__ for item in items})
            raise ValueError(f"files must be paths, got {', '.join(kinds)}")
        found = [Path(item).expanduser() for item in items]
    else:
        raise ValueError(f"files must be paths or a pattern, got {type(files).__name__}")
    if not found:
        raise ValueError(f"files must name at least one file, got none for {files!r}")
    if len(set(found)) < len(found):
        twice = next(path for path in found if found.count(path) > 1)
        raise ValueError(f"files must name each file once, got {twice} twice")
    return found


def _description(work: Work) -> str:
    """Name a function and its settings, which a table must not mix."""
    if isinstance(work, partial):
        settings = [repr(v) for v in work.args]
        settings += [f"{name}={value!r}" for name, value in sorted(work.keywords.items())]
        return f"{_description(work.func)}({', '.join(settings)})"
    return getattr(work, "__qualname__", type(work).__qualname__)


def _check_pickles(work: Work) -> None:
    try:
        pickle.dumps(work)
    except Exception as error:
        text = "work must be a function of a module to be handed to other processes"
        raise ValueError(f"{text}, got {_description(work)}: {error}") from error


def _state(path: Path) -> tuple[int | None, int | None]:
    """Return size and time of a file, of a folder those of its files; None where there is none."""
    try:
        files = [f for f in path.iterdir() if f.is_file()] if path.is_dir() else [path]
        found = [file.stat() for file in files or [path]]
    except OSError:
        return None, None
    return sum(f.st_size for f in found), max(f.st_mtime_ns for f in found)


def _row(path: Path, work: Work, description: str) -> Row:
    """Do one file; what goes wrong is its row."""
    begun, (size, modified), values, error = perf_counter(), _state(path), {}, ""
    try:
        values = _values(work(path))
    except Exception as exception:
        text = " ".join(str(exception).split())
        error = f"{type(exception).__name__}: {text}"
    seconds = round(perf_counter() - begun, 3)
    own = (str(path), error, seconds, size, modified, description)
    return dict(zip(_OWN, own, strict=True)) | values


def _values(result: object) -> Row:
    if result is None:
        return {}
    if not isinstance(result, (Tidy, Mapping)):
        raise TypeError(
            f"work must return a result, a mapping or None, got {type(result).__name__}"
        )
    row = result.to_dict() if isinstance(result, Tidy) else flat_row(result)
    if clash := sorted(set(row) & set(_OWN)):
        raise TypeError(f"work must not return {', '.join(clash)}: a row has them already")
    return row


def _rows(due: list[Path], work: Work, workers: int) -> Iterator[Row]:
    description = _description(work)
    if workers == 1:
        yield from (_row(path, work, description) for path in due)
        return
    waiting = list(reversed(due))
    while waiting:
        alone: list[Path] = []
        yield from _pooled(waiting, work, description, workers, alone)
        for path in alone:  # one of these ended its process, and with it the pool
            only: list[Path] = []
            yield from _pooled([path], work, description, 1, only)
            if only:
                size, modified = _state(path)
                reason = "BrokenProcessPool: the process ended while it did this file"
                own = (str(path), reason, None, size, modified, description)
                yield dict(zip(_OWN, own, strict=True))


def _pooled(
    waiting: list[Path], work: Work, description: str, workers: int, broken: list[Path]
) -> Iterator[Row]:
    """Do files in processes until all are done or a process dies; those in its hands are `broken`.

    Notes
    -----
    Processes are spawned: a fork of a process with threads may hang.
    """
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin)
    begun: dict[Future[Row], Path] = {}
    try:
        while waiting or begun:
            while waiting and len(begun) < _AHEAD * workers:
                path = waiting.pop()
                with _one_thread_each():
                    begun[pool.submit(_row, path, work, description)] = path
            for future in wait(begun, return_when=FIRST_COMPLETED).done:
                path = begun.pop(future)
                yield future.result()
    except BrokenProcessPool:
        broken += [path, *begun.values()]
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Let the processes that begin meanwhile have one thread of linear algebra, unless told.

    Threads of several processes that wait for one core make a calibration ten times slower.
    """
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update({name: "1" for name, value in before.items() if value is None})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]


def _begin() -> None:
    """Use one thread, and end with the process that began this one."""
    cv2.setNumThreads(1)
    end_with_starter()


class _Table:
    """A CSV file that grows by a row, and by columns where a row brings new ones."""

    def __init__(self, path: Path, rows: dict[str, dict[str, str]], columns: list[str]) -> None:
        self.path, self.rows, self.columns = path, rows, columns

    @classmethod
    @contextmanager
    def opened(cls, path: Path, description: str) -> Iterator[_Table]:
        """Hold a table, for this call alone; a row that was cut off is left out."""
        with _alone(path):
            rows, columns = _read(path)
            others = {row["work"] for row in rows.values()} - {description}
            if others:
                raise ValueError(
                    f"table must be of the same work, got {path} with {sorted(others)[0]}, "
                    f"now {description}: name another file"
                )
            kept = cls(path, rows, columns or list(_OWN))
            kept._write()
            yield kept

    def has(self, path: Path, retry: bool) -> bool:
        row = self.rows.get(str(path))
        if row is None or (retry and row["error"]):
            return False
        return (row["bytes"], row["modified"]) == tuple(_text(value) for value in _state(path))

    def add(self, row: Row) -> None:
        texts = {name: _text(value) for name, value in row.items()}
        before = self.rows.pop(row["file"], None)
        self.rows[row["file"]] = texts
        new = [name for name in row if name not in self.columns]
        self.columns += new
        if new or before is not None:
            self._write()
            return
        with self.path.open("a", encoding="utf-8", newline="") as file:
            csv.writer(file).writerow([texts.get(name, "") for name in self.columns])

    def arrange(self, order: list[str]) -> None:
        """Put the rows in order; those of files that were not asked for come last."""
        known = {name: self.rows[name] for name in order}
        self.rows = known | self.rows
        self._write()

    def _write(self) -> None:
        text = io.StringIO(newline="")
        writer = csv.writer(text)
        writer.writerow(self.columns)
        writer.writerows([row.get(name, "") for name in self.columns] for row in self.rows.values())
        replace_file(self.path, lambda file: file.write_bytes(text.getvalue().encode()))


def _read(path: Path) -> tuple[dict[str, dict[str, str]], list[str]]:
    if not path.exists():
        return {}, []
    try:
        content = path.read_bytes().decode()
        lines = list(csv.reader(io.StringIO(content[: content.rfind("\n") + 1], newline="")))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"table must be a CSV file, got {path}: {error}") from error
    if not content:
        return {}, []
    if not lines or tuple(lines[0][: len(_OWN)]) != _OWN:
        raise ValueError(f"table must be one that process_files wrote, got {path}")
    whole_lines = [line for line in lines[1:] if len(line) == len(lines[0])]
    return {line[0]: dict(zip(lines[0], line, strict=True)) for line in whole_lines}, lines[0]


def _text(value: object) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else json.dumps(value)


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Keep a second call away from a table; the system lets go of it when this process ends."""
    try:
        import fcntl
    except ImportError:  # on Windows; two calls at once are the caller's care there
        yield
        return
    name = path.with_name(f".{path.name}.lock")
    with name.open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not os.path.samestat(os.fstat(lock.fileno()), name.stat()):
                raise OSError("the call that held it has just removed it")
        except OSError as error:
            raise ValueError(f"table must be written by one call, got {path} in use") from error
        try:
            yield
        finally:
            name.unlink()
