"""The parser, the files, the notes and the exit status of all commands."""

from __future__ import annotations

import argparse
import logging
import os
import sys
import tempfile
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NoReturn

from tqdm import tqdm

import microlib
from microlib._command import _calibrate, _depth, _modulus, _track
from microlib._command._shared import option
from microlib._common import ArgumentError, home_path, replace_file

#: Endings of names that are not meant as folders.
_FILE_ENDINGS = (".csv", ".json", ".png", ".tif", ".tiff", ".ply", ".txt", ".xlsx")


class _Parser(argparse.ArgumentParser):
    """A parser whose errors have one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message.removeprefix('argument ')}\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status, as its help lists them."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # replace letters that the console's encoding lacks
            stream.reconfigure(errors="replace")
    # Silence the messages that libraries print themselves.
    os.environ |= {"OPENCV_LOG_LEVEL": "OFF", "OPENCV_FFMPEG_LOGLEVEL": "-8"}
    logging.getLogger("tifffile").addHandler(logging.NullHandler())
    parser = _parser()
    a = parser.parse_args(arguments)
    if a.task is None:
        parser.print_help()
        return 0
    a.out = home_path(a.out)
    if ".." in a.out.parts:  # before a folder that is missing, files are not found
        a.out = a.out.resolve()
    notes: dict[str, None] = {}  # each once, in their order
    a.note = lambda text: notes.setdefault(f"note: {text}")
    a.say = (lambda *_: None) if a.quiet else print
    # Shown in a terminal only.
    a.bar = partial(tqdm, desc=a.task, leave=False, disable=a.quiet or None)
    a.end = 0, ""  # a task can set another exit status and its reason
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_: a.note(message)
        try:
            _write_files(a)
            status, text = a.end
        except KeyboardInterrupt:
            status, text = 130, "stopped"
        except Exception as error:
            status, text, notes = 2, _explain(a, error), {}
    if status:
        notes[f"microlib {a.task}: {text}"] = None
    for note in notes:  # last, where they are seen
        print(" ".join(note.split()), file=sys.stderr)
    return status


def _explain(a: argparse.Namespace, error: Exception) -> str:
    """Return the message of an error, with options in place of names of arguments."""
    if isinstance(error, OSError) and error.errno:  # a full disk has no file's name
        return f"{error.filename or a.out}: {error.strerror}"
    if isinstance(error, ArgumentError):
        name, *part = error.argument.split(" ", 1)  # a box has sides, as in "box width"
        return " ".join([option(name) if name in a else name, *part, error.problem])
    known = isinstance(error, (OSError, ValueError, ImportError))
    return str(error) if known else f"{type(error).__name__}: {error}"


def _write_files(a: argparse.Namespace) -> None:
    """Write the files that a task yields, each atomically."""
    files, written = _targets(a), []

    def protect(inputs: Sequence[Path]) -> None:
        for target in files.values():
            if target.exists() and any(target.samefile(file) for file in inputs):
                raise ValueError(f"{target} is an input: give another --out")

    a.protect = protect
    for name, write in a.run(a):
        if name == "look.png" and a.no_look:
            continue
        file = files[name]
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            replace_file(file, write)
            written.append(name)
        except Exception as error:
            # Without a picture, and without a mesh if there is no height, the rest is useful.
            if not name.startswith("look") and not isinstance(error, ValueError):
                raise
            a.note(f"{file.name} is not written: {_explain(a, error)}")
    for name in files.keys() - {*written, "table"}:  # track writes its table row by row
        files[name].unlink(missing_ok=True)  # of an earlier run
    names = [file.name for file in files.values() if file.exists()]
    a.say(f"{files[a.files[0]].parent}: {', '.join(names)}")


def _targets(a: argparse.Namespace) -> dict[str, Path]:
    """Return the path of each file; raise if one exists already or cannot be written."""
    ending = a.out.suffix.lower()
    if "table" in a.files:
        if ending != ".csv":
            raise ArgumentError("out", f"must be a table that ends in .csv, got {a.out}")
        files = {name: a.out.with_name(f"{a.out.stem}_{name}") for name in a.files}
        files["table"] = a.out
    else:
        if ending in _FILE_ENDINGS and not a.out.is_dir():
            raise ArgumentError("out", f"must be a folder, got {a.out}")
        files = {name: a.out / name for name in a.files}
    for file in files.values():
        if file.is_dir() or (file.exists() and not a.overwrite):
            raise ValueError(f"{file} exists already: give another --out, or --overwrite")
    nearest = next(p for p in files[a.files[0]].absolute().parents if p.exists())
    try:
        tempfile.TemporaryFile(dir=nearest).close()
    except OSError as error:
        raise ValueError(f"{a.out} cannot be written: {error.strerror}") from error
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
    for task in (_depth, _calibrate, _track, _modulus):
        name = task.__name__.rpartition("_")[2]
        about, _, example = (task.run.__doc__ or "").partition("\n")
        sub = tasks.add_parser(name, help=about, description=about, epilog=example)
        task.add_options(sub)
        sub.set_defaults(run=task.run)
        out = "CSV file" if "table" in sub.get_default("files") else "folder for the results"
        sub.add_argument("-o", "--out", required=True, type=Path, metavar="OUT", help=out)
        sub.add_argument("--overwrite", action="store_true", help="replace earlier results")
        sub.add_argument("--no-look", action="store_true", help="write no picture of the result")
        sub.add_argument("--quiet", action="store_true", help="print only errors and notes")
    return parser
