"""What the four commands share: the parser, the files, the notes, the exit status."""

from __future__ import annotations

import argparse
import re
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
from microlib._common import replace_file

#: Endings of files that people ask for where a folder is meant.
_OF_FILES = (".csv", ".json", ".png", ".tif", ".tiff", ".ply", ".txt", ".xlsx")


class _Parser(argparse.ArgumentParser):
    """A parser that says in one line what is wrong."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message.removeprefix('argument ')}\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status, as its help lists them."""
    a = _parser().parse_args(arguments)
    a.out = a.out.expanduser()
    notes: dict[str, None] = {}  # each once, in their order
    a.note = lambda text: notes.setdefault(f"note: {text}")
    a.say = (lambda *_: None) if a.quiet else print
    # Shown in a terminal only.
    a.bar = partial(tqdm, desc=a.task, leave=False, disable=a.quiet or None)
    a.end = 0, ""  # a task may end with another status, and say why
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_: a.note(message)
        try:
            _write_files(a)
            status, text = a.end
        except (OSError, ValueError, ImportError) as error:
            status, text, notes = 2, str(error), {}
            if isinstance(error, OSError) and error.errno:  # a full disk tells no file
                text = f"{error.filename or a.out}: {error.strerror}"
            elif getattr(error, "name", None) == "cv2":
                text = "OpenCV 4.12 or newer is needed: pip install opencv-python-headless"
        except KeyboardInterrupt:
            status, text = 130, "stopped"
    if status:
        notes[f"microlib {a.task}: {text}"] = None
    for note in notes:  # last, where they are read
        print(_in_options(a, note), file=sys.stderr)
    return status


def _write_files(a: argparse.Namespace) -> None:
    """Write what a task gives, each file whole or not at all."""
    files = _targets(a)
    left_out = {"look.png": a.no_look, "look.mp4": not getattr(a, "video", False)}
    for name, write in a.run(a):
        file = files[name]
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            if not left_out.get(name):
                replace_file(file, write)
                continue
        except ValueError as error:  # the others are written all the same
            a.note(f"{file.name} is not written: {error}")
        file.unlink(missing_ok=True)  # of another run
    written = [file for file in files.values() if file.exists()]
    a.say(f"{written[0].parent}: {', '.join(file.name for file in written)}")


def _targets(a: argparse.Namespace) -> dict[str, Path]:
    """Return where each file goes; refuse what is there already or cannot be written."""
    ending = a.out.suffix.lower()
    if "table" in a.files:
        files = {name: a.out.with_name(f"{a.out.stem}_{name}") for name in a.files}
        files["table"] = a.out
        wrong, need = ending != ".csv", "a table that ends in .csv"
    else:
        files = {name: a.out / name for name in a.files}
        wrong, need = ending in _OF_FILES and not a.out.is_dir(), "a folder"
    if wrong:
        raise ValueError(f"out must be {need}, got {a.out}")
    if there := [f for f in files.values() if f.is_dir() or (f.exists() and not a.overwrite)]:
        raise ValueError(f"{there[0]} is there already: give another --out, or --overwrite")
    nearest = next(p for p in files[a.files[0]].absolute().parents if p.exists())
    try:
        tempfile.TemporaryFile(dir=nearest).close()
    except OSError as error:
        raise ValueError(f"{a.out} cannot be written: {error.strerror}") from error
    return files


def _in_options(a: argparse.Namespace, text: str) -> str:
    """Return a message of the library with the command's options for the library's arguments."""
    source = a.source if isinstance(a.source, str) else "photographs"
    words = {name: option(name) for name in vars(a)}
    told = ("frames", "frame", "image", "world", "x", "y", "curve", "span")
    words |= dict.fromkeys(told, source)
    words |= {"positions": "--spacing", "poisson_ratio": "--poisson"}
    words |= {"pixel_size": "--cell"} if "cell" in a else {}
    text = re.sub(r"stds\['(\w+)'\]", r"\1_std", text)
    # A box has sides, as in "box width must".
    argument = r"(?<!\S)(\w+)( x| y| width| height)?(?= (?:must|cannot(?! be read)|could) )"
    text = re.sub(argument, lambda m: words.get(m[1], m[1]) + (m[2] or ""), text)
    return " ".join(text.split())


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
        name = task.__name__.rpartition("_")[2]
        about, _, example = task.run.__doc__.partition("\n")
        sub = tasks.add_parser(name, help=about, description=about, epilog=example)
        task.add_options(sub)
        sub.set_defaults(run=task.run)
        table = "table" in sub.get_default("files")
        out = "CSV file to write" if table else "folder for the results"
        sub.add_argument("-o", "--out", required=True, type=Path, metavar="OUT", help=out)
        # What presses an embryo has had the name of the second for longer.
        overwrite = ["--overwrite", *([] if task is _modulus else ["--force"])]
        sub.add_argument(*overwrite, action="store_true", help="write over files that are there")
        sub.add_argument("--no-look", action="store_true", help="no picture of the result")
        sub.add_argument("--quiet", action="store_true", help="print errors and notes only")
    return parser
