"""Files that a command writes: asked for before the work, written whole."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from microlib._common import replace_file


class Unfinished(Exception):
    """What is written is a part, or worth little: the exit status, and what is said of it."""


def csv_file(text: str) -> Path:
    """Return a path, if it is that of a table, as argparse asks for it."""
    if not text.lower().endswith(".csv"):
        raise argparse.ArgumentTypeError(f"must be a table that ends in .csv, got {text}")
    return Path(text)


def beside(table: Path, ending: str) -> Path:
    """Return the name of what belongs to a table, as track_look.png to track.csv."""
    return table.with_name(table.stem + ending)


def refuse_targets(a: argparse.Namespace, files: Sequence[Path]) -> None:
    """Refuse to begin if a file to be written is there already, or its folder takes none."""
    there = [file for file in files if file.exists()]
    if there and not a.overwrite:
        raise ValueError(f"{there[0]} is there already: give another --out, or --overwrite")
    nearest = next(place for place in files[0].absolute().parents if place.exists())
    try:
        tempfile.TemporaryFile(dir=nearest).close()
    except OSError as error:
        raise ValueError(f"{a.out} cannot be written: {error.strerror}") from error


def write(path: Path, content: Any) -> None:
    """Write a text, a table as CSV or a figure as a picture, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if hasattr(content, "savefig"):
        replace_file(path, lambda file: content.savefig(file, dpi=150))
    else:
        if not isinstance(content, str):
            content = content.to_csv(lineterminator="\n", index=content.index.name is not None)
        replace_file(path, lambda file: file.write_text(content, encoding="utf-8"))
