"""What the four commands share: the parser, the files, the notes, the exit status."""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import microlib
from microlib._command import _calibrate, _depth, _modulus, _track
from microlib._command._scales import option
from microlib._common import replace_file


class _Parser(argparse.ArgumentParser):
    """A parser that says in one line what is wrong."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message.removeprefix('argument ')}\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status, as its help lists them."""
    a = _parser().parse_args(arguments)
    a.say = (lambda *_: None) if a.quiet else print
    # Shown in a terminal only.
    a.bar = {"desc": a.task, "leave": False, "disable": a.quiet or None}
    a.end = 0, ""  # a task may end with another status, and say why
    notes: dict[str, None] = {}  # each once, in their order
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_: notes.setdefault(f"note: {message}")
        try:
            _write_files(a)
            status, text = a.end
        except (OSError, ValueError, ImportError) as error:
            status, text, notes = 2, str(error), {}
            if isinstance(error, OSError) and error.filename:
                text = f"{error.filename}: {error.args[1]}"
            elif getattr(error, "name", None) == "cv2":
                text = "OpenCV 4.10 or newer is needed: pip install opencv-python-headless"
        except KeyboardInterrupt:
            status, text = 130, "stopped"
    if status:
        notes[f"microlib {a.task}: {text}"] = None
    for note in notes:  # last, where they are read
        print(_in_options(a, note), file=sys.stderr)
    return status


def _write_files(a: argparse.Namespace) -> None:
    """Write what a task gives, each file whole or not at all."""
    files = {name: _place(a, name) for name in a.files if name != "look.png" or not a.no_look}
    _refuse_targets(a, list(files.values()))
    for name, write in a.run(a):
        if name in files:
            files[name].parent.mkdir(parents=True, exist_ok=True)
            replace_file(files[name], write)
    written = [file for file in files.values() if file.exists()]
    a.say(f"{written[0].parent}: {', '.join(file.name for file in written)}")


def _place(a: argparse.Namespace, name: str) -> Path:
    """Return where a file goes: into the folder, or beside the table, as track_look.png."""
    if "table" not in a.files:
        return a.out / name
    return a.out if name == "table" else a.out.with_name(f"{a.out.stem}_{name}")


def _refuse_targets(a: argparse.Namespace, files: Sequence[Path]) -> None:
    """Refuse to begin if a file to be written is there already, or its folder takes none."""
    there = [file for file in files if file.exists()]
    if there and not a.overwrite:
        raise ValueError(f"{there[0]} is there already: give another --out, or --overwrite")
    nearest = next(place for place in files[0].absolute().parents if place.exists())
    try:
        tempfile.TemporaryFile(dir=nearest).close()
    except OSError as error:
        raise ValueError(f"{a.out} cannot be written: {error.strerror}") from error


def _in_options(a: argparse.Namespace, text: str) -> str:
    """Return a message of the library with the command's options for the library's arguments."""
    words = {name: option(name) for name in vars(a)}
    words |= {name: str(getattr(a, of, of)) for name, of in a.words.items()}
    argument = r"\w+(?= (?:must|cannot(?! be read)|could) )"
    text = re.sub(argument, lambda m: words.get(m[0], m[0]), text)
    return " ".join(text.split())


def _table(text: str) -> Path:
    """Return the path of a table, as argparse asks for it."""
    if not text.lower().endswith(".csv"):
        raise argparse.ArgumentTypeError(f"must be a table that ends in .csv, got {text}")
    return Path(text)


def _parser() -> argparse.ArgumentParser:
    about = microlib.__doc__.splitlines()[0]
    statuses = (
        "Exit status: 0 done; 2 refused; 3 a film ended early, the rows so far are written; "
        "4 the part was lost in most frames; 130 stopped by Ctrl-C."
    )
    parser = _Parser(prog="microlib", description=about, epilog=statuses)
    parser.add_argument("--version", action="version", version=microlib.__version__)
    tasks = parser.add_subparsers(dest="task", required=True, metavar="TASK")
    for task in (_depth, _calibrate, _track, _modulus):
        name, about = task.__name__.rpartition("_")[2], task.run.__doc__
        sub = tasks.add_parser(name, help=about, description=about)
        task.add_options(sub)
        sub.set_defaults(run=task.run)
        table = "table" in sub.get_default("files")
        out = "CSV file to write" if table else "folder for the results"
        kind = _table if table else Path
        sub.add_argument("-o", "--out", required=True, type=kind, metavar="OUT", help=out)
        # What presses an embryo has had the name of the second for longer.
        overwrite = ["--overwrite", *([] if task is _modulus else ["--force"])]
        sub.add_argument(*overwrite, action="store_true", help="write over files that are there")
        sub.add_argument("--no-look", action="store_true", help="no picture of the result")
        sub.add_argument("--quiet", action="store_true", help="print errors and notes only")
    return parser
