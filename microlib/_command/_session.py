"""One run of a command: its messages, its files, and how it ends."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from math import floor, inf, log10
from pathlib import Path
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

from tqdm import tqdm

from microlib._common import SOFTWARE, ArgumentError, replace_file

if TYPE_CHECKING:
    import pandas as pd

#: Writes a file.
Writer = Callable[[Path], object]


class End(NamedTuple):
    """How a run ends: its exit status, and the reason if that is not 0."""

    status: int = 0
    reason: str = ""


@dataclass(frozen=True)
class Session:
    """The messages and the files of one run.

    A task calls `protect` as soon as it knows its inputs and before its work, then `write` once for
    each file; `say`, `note` and `bar` at any time. `finish` comes after the task.

    Attributes
    ----------
    task : str
        Name of the command.
    out : Path
        What the user gave as ``--out``.
    files : dict
        Path of each output by its name.
    notes : dict
        Messages for the end of the run, each once, as keys.
    quiet, look : bool
        Whether to print only errors and notes; whether to write a picture of the result.
    written : set of str
        Names of the files that are written.
    """

    task: str
    out: Path
    files: dict[str, Path]
    notes: dict[str, None]
    quiet: bool
    look: bool
    written: set[str] = field(default_factory=set)

    def say(self, text: object) -> None:
        """Print a result or a scale that is used."""
        if not self.quiet:
            try:
                tqdm.write(str(text))  # above a progress bar
            except OSError as error:
                error.filename = "standard output"
                raise

    def note(self, text: object) -> None:
        """Keep a message for the end of the run, where it is seen."""
        self.notes[f"note: {text}"] = None

    def bar(self, steps: Any = None, **options: Any) -> Any:
        """Return a progress bar, which is shown only in a terminal."""
        columns, lines = get_terminal_size()  # 80 and 24 where a terminal states none
        return tqdm(
            steps,
            desc=self.task,
            leave=False,
            disable=self.quiet or sys.stderr is None or None,
            ncols=columns,
            nrows=lines,
            miniters=1,  # also where slow frames, as of a lost part, follow fast ones
            **options,
        )

    def protect(self, inputs: Sequence[Path]) -> None:
        """Raise if one of the files is an input."""
        for target in self.files.values():
            if target.exists() and any(target.samefile(file) for file in inputs):
                raise ValueError(f"{target} is an input: give another --out")

    def write(self, name: str, write: Writer) -> None:
        """Write one of the files atomically; note a picture or a map that cannot be made."""
        if name == "look.png" and not self.look:
            return
        file = self.files[name]
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            replace_file(file, write)
        except Exception as error:
            # Without a picture, and without a mesh if there is no height, the rest is useful.
            if not name.startswith("look") and not isinstance(error, ValueError):
                raise
            self.note(f"{file.name} is not written: {explain(error, self.out)}")
        else:
            self.written.add(name)

    def open_lines(self, name: str) -> TextIO:
        """Open one of the files, which keeps the lines so far if the process is killed."""
        file = self.files[name]
        file.parent.mkdir(parents=True, exist_ok=True)
        self.written.add(name)
        return file.open("w", 1, encoding="utf-8", newline="")

    def finish(self) -> None:
        """Remove files of an earlier run, and print which files there are."""
        old = [file for name, file in self.files.items() if name not in self.written]
        for file in filter(Path.exists, old):
            self.note(f"{file} of an earlier run is removed")
            file.unlink()
        names = [file.name for name, file in self.files.items() if name in self.written]
        folder = next(iter(self.files.values())).parent
        self.say(f"{'this folder' if folder == Path() else folder}: {', '.join(names)}")

    def mixture(self) -> str:
        """Return which files are new, if a run that failed left others of an earlier run."""
        there = {name: file.name for name, file in self.files.items() if file.exists()}
        new = [name for key, name in there.items() if key in self.written]
        old = [name for key, name in there.items() if key not in self.written]
        both = f"; new files: {', '.join(new)}; files of an earlier run: {', '.join(old)}"
        return both if new and old else ""


def explain(error: BaseException, out: Path, options: Collection[str] = ()) -> str:
    """Return the message of an error, with options in place of names of arguments."""
    if isinstance(error, OSError) and error.errno:  # a full disk has no file's name
        return f"{error.filename or out}: {error.strerror}"
    if isinstance(error, ArgumentError):
        name, *part = error.argument.split(" ", 1)  # a box has sides, as in "box width"
        return " ".join([option(name) if name in options else name, *part, error.problem])
    known = isinstance(error, (OSError, ValueError, ImportError))
    return str(error) if known else f"{type(error).__name__}: {error}"


def option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def text(content: str) -> Writer:
    """Return a writer of a text file."""
    return lambda file: file.write_text(content, encoding="utf-8", newline="\n")


def rounded(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of estimates, one in each row, with three digits of their uncertainty."""
    columns = ["value", "uncertainty", "low", "high"]

    def shorten(row: pd.Series) -> pd.Series:
        uncertainty = row["uncertainty"]
        if not 0 < uncertainty < inf:
            return row
        digits = 2 - floor(log10(uncertainty))
        return row.map(lambda value: round(value, digits))

    return table.assign(**table[columns].apply(shorten, axis=1))


def picture(draw: Callable[[], Any]) -> Writer:
    """Return a writer that draws the figure."""

    def write(file: Path) -> None:
        from microlib._plots import default_style

        with default_style():
            draw().savefig(file, dpi=150, metadata={"Software": SOFTWARE})

    return write
