"""What the four commands share: the parser, the notes, the exit status."""

from __future__ import annotations

import argparse
import re
import sys
import warnings
from collections.abc import Sequence
from typing import NoReturn

import microlib
from microlib._command import _calibrate, _depth, _modulus, _track
from microlib._command._files import Unfinished


class _Parser(argparse.ArgumentParser):
    """A parser that says in one line what is wrong."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message.removeprefix('argument ')}\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status, as its help lists them."""
    a = _parser().parse_args(arguments)
    a.say = (lambda *_: None) if a.quiet else print
    # A bar is shown in a terminal only.
    a.bar = {"disable": True if a.quiet else None, "leave": False}
    notes: dict[str, None] = {}  # each once, in their order

    def fail(text: object) -> None:
        print(f"microlib {a.task}: {_in_options(a, str(text))}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_: notes.setdefault(_in_options(a, str(message)))
        try:
            status: int = a.run(a) or 0
        except (OSError, ValueError, ImportError) as error:
            status, file = 2, getattr(error, "filename", None)
            if getattr(error, "name", None) == "cv2":
                fail("OpenCV 4.10 or newer is needed: pip install opencv-python-headless")
            else:
                fail(f"{file}: {error.args[1]}" if file else error)
        except Unfinished as end:
            status, text = end.args
            fail(text)
        except KeyboardInterrupt:
            status = 130
            fail("stopped")
    for note in notes if status != 2 else ():  # last, where they are read
        print(f"note: {note}", file=sys.stderr)
    return status


def _in_options(a: argparse.Namespace, text: str) -> str:
    """Return a message of the library with the command's options for the library's arguments."""
    options = {name: f"--{name.replace('_', '-')}" for name in vars(a)}
    words = options | {name: str(getattr(a, of, of)) for name, of in a.words.items()}
    text = re.sub(r"\w+(?= (?:must|cannot|could) )", lambda m: words.get(m[0], m[0]), text)
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
        name, about = task.__name__.rpartition("_")[2], task.run.__doc__
        sub = tasks.add_parser(name, help=about, description=about)
        sub.set_defaults(run=task.run)
        task.add_options(sub)
        # What presses an embryo has its name from before.
        force = [] if task is _modulus else ["--force"]
        sub.add_argument(
            "--overwrite", *force, action="store_true", help="write over files that are there"
        )
        sub.add_argument("--no-look", action="store_true", help="no picture of the result")
        sub.add_argument("--quiet", action="store_true", help="print errors and notes only")
    return parser
