"""The parser, the files, the notes and the exit status of all commands."""

from __future__ import annotations

import argparse
import logging
import os
import re
import sys
import tempfile
import warnings
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NoReturn

import microlib
from microlib._command import _calibrate, _depth, _modulus, _track
from microlib._command._session import End, Session, explain, option
from microlib._common import ArgumentError, home_path

#: Each has its `FILES`, `add_options` and `run`.
_TASKS: dict[str, Any] = {
    "depth": _depth,
    "calibrate": _calibrate,
    "track": _track,
    "modulus": _modulus,
}

#: Endings of names that are not meant as folders.
_FILE_ENDINGS = (".csv", ".json", ".png", ".tif", ".tiff", ".ply", ".txt", ".xlsx")


class _Parser(argparse.ArgumentParser):
    """A parser whose errors have one line."""

    def error(self, message: str) -> NoReturn:
        if message.startswith("argument TASK"):
            message = f"the first word must be a task: {', '.join(_TASKS)}; options follow it"
        if message.endswith("expected 4 arguments"):
            message += ", with blanks between them, as in 30 40 64 64"
        self.exit(2, f"{self.prog}: {message.removeprefix('argument ')}\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status, as its help lists them."""
    if arguments is None:  # a program that calls it keeps its streams, environment and loggers
        for stream in (sys.stdout, sys.stderr):
            if hasattr(stream, "reconfigure"):  # replace letters that the console's encoding lacks
                stream.reconfigure(errors="replace", line_buffering=True)
        # Silence the messages that libraries print themselves.
        os.environ |= {"OPENCV_LOG_LEVEL": "OFF", "OPENCV_FFMPEG_LOGLEVEL": "-8"}
        logging.getLogger("tifffile").addHandler(logging.NullHandler())
    parser = _parser()
    given = list(sys.argv[1:] if arguments is None else arguments)
    for k in range(len(given) - 1, 0, -1):  # argparse takes -25um for an option
        if re.fullmatch(r"-[.\d].*[^.\d].*", given[k]) and given[k - 1].startswith("--"):
            given[k - 1 : k + 1] = [f"{given[k - 1]}={given[k]}"]
    a, unknown = parser.parse_known_args(given)
    if unknown:
        parser.error(_advice(unknown[0], a))
    if a.task is None:
        parser.print_help()
        return 0
    if not a.out:  # of an unset variable
        parser.error("--out must name a file or a folder, got an empty text")
    task, out = _TASKS[a.task], home_path(a.out)
    if ".." in out.parts:  # before a folder that is missing, files are not found
        out = out.resolve()
    notes: dict[str, None] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_: notes.setdefault(f"note: {message}")
        session = None
        try:
            files = _output_files(task.FILES, out, a.overwrite)
            session = Session(a.task, out, files, notes, a.quiet, not a.no_look)
            end = task.run(a, session)
            session.finish()
        except (KeyboardInterrupt, Exception) as error:
            stopped = isinstance(error, KeyboardInterrupt)
            reason = "stopped" if stopped else explain(error, out, vars(a))
            end = End(130 if stopped else 2, reason + (session.mixture() if session else ""))
            if not stopped:
                notes.clear()
    if end.status:
        notes[f"microlib {a.task}: {end.reason}"] = None
    for note in notes:  # last, where they are seen
        print(" ".join(note.split()), file=sys.stderr)
    return end.status


def _advice(unknown: str, a: argparse.Namespace) -> str:
    """Return what is wrong with a word that no option takes."""
    if re.fullmatch(r"[nuµμmc]?[mN](/px)?", unknown):
        return f"a number and its unit have no blank between them, as in 0.5{unknown}"
    near = get_close_matches(unknown.split("=")[0], [option(name) for name in vars(a)], 1)
    return f"unknown {unknown}" + "".join(f": did you mean {name}?" for name in near)


def _output_files(names: Sequence[str], out: Path, overwrite: bool) -> dict[str, Path]:
    """Return the path of each file; raise if one exists already or cannot be written."""
    ending = out.suffix.lower()
    if "table" in names:
        if ending != ".csv":
            raise ArgumentError("out", f"must be a table that ends in .csv, got {out}")
        files = {name: out.with_name(f"{out.stem}_{name}") for name in names} | {"table": out}
    else:
        if ending in _FILE_ENDINGS and not out.is_dir():
            raise ArgumentError("out", f"must be a folder, got {out}")
        files = {name: out / name for name in names}
    for file in files.values():
        if file.is_dir() or (file.exists() and not overwrite):
            raise ValueError(f"{file} exists already: give another --out, or --overwrite")
    first, *_ = files.values()
    nearest = next(p for p in first.absolute().parents if p.exists())
    try:
        tempfile.TemporaryFile(dir=nearest).close()
    except OSError as error:
        raise ValueError(f"{out} cannot be written: {error.strerror}") from error
    return files


def _parser() -> argparse.ArgumentParser:
    about = (microlib.__doc__ or "").partition("\n")[0]  # python -OO has none
    statuses = (
        "Exit status: 0 done; 2 error; 3 the film ended early, and the rows so far are written; "
        "4 the part was lost in most frames; 130 stopped by Ctrl-C."
    )
    parser = _Parser(prog="microlib", description=about, epilog=statuses)
    parser.add_argument("--version", action="version", version=microlib.__version__)
    tasks = parser.add_subparsers(dest="task", metavar="TASK")
    for name, task in _TASKS.items():
        about, _, example = (task.run.__doc__ or "").partition("\n")
        sub = tasks.add_parser(name, help=about, description=about, epilog=example)
        task.add_options(sub)
        out = "CSV file" if "table" in task.FILES else "folder for the results"
        sub.add_argument("-o", "--out", required=True, metavar="OUT", help=out)
        sub.add_argument("--overwrite", action="store_true", help="replace earlier results")
        sub.add_argument("--no-look", action="store_true", help="write no picture of the result")
        sub.add_argument("--quiet", action="store_true", help="print only errors and notes")
    return parser
