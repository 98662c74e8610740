"""A reader's values for the parameters of a notebook, read from what was typed in a shell."""

from __future__ import annotations

import ast
import json
import math
import re
import tempfile
from collections.abc import Mapping
from difflib import get_close_matches
from glob import glob
from pathlib import Path

import papermill

ROOT = Path(__file__).resolve().parent.parent
#: How the comment behind a parameter states its bound: ``# µm, > 0, of the membrane``.
_BOUND = re.compile(r"([>≥≠]) 0\b")


def read_values(notebook: Path, texts: Mapping[str, str]) -> dict[str, object]:
    """Read a reader's values for the parameters of a notebook.

    Parameters
    ----------
    notebook : pathlib.Path
        Its cell with the tag ``parameters`` holds one assignment a line, whose default tells the
        type: a number, a list of numbers, a text, or ``None`` for a number that may be missing. The
        comment behind it may state a bound: ``> 0``, ``≥ 0`` or ``≠ 0``.
    texts : mapping of str to str
        By name, as typed in a shell.

    Returns
    -------
    dict of str to object
        Of the types of the parameters.

    Raises
    ------
    ValueError
        If there is no such parameter, a text is of another type or out of bounds, a file does not
        exist, or the folder for the results, ``out``, cannot be written to.
    """
    known = papermill.inspect_notebook(notebook)
    values = {}
    for name, text in texts.items():
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"it has {', '.join(known)}."
            raise ValueError(f"{notebook.stem} has no parameter {name}; {hint}")
        bound = _BOUND.search(known[name]["help"])
        default = ast.literal_eval(known[name]["default"])
        values[name] = _value(name, text, default, bound[1] if bound else "")
        if name == "out":
            prepare_folder(name, Path(text))
    return values


def _value(name: str, text: str, default: object, bound: str) -> object:
    if isinstance(default, str):
        # A default that is a file of this project is an input: another one must exist, too.
        exists = Path(text).exists() or (ROOT / text).is_file() or glob(text)
        if (ROOT / default).is_file() and not exists:
            raise ValueError(f"{name} must name a file, got {text}: no such file")
        return text
    if default is None and text == "None":
        return None
    if isinstance(default, list):
        wanted = f"{len(default)} numbers in brackets, such as {default}"
    else:
        wanted = "a whole number" if isinstance(default, int) else "a finite number"
        wanted += f" {bound} 0" if bound else ""
        wanted += " or None" if default is None else ""
    try:
        if isinstance(default, list):
            numbers = json.loads(text)
            if not isinstance(numbers, list) or any(type(n) not in (int, float) for n in numbers):
                raise ValueError
            return [_number(str(n), like) for n, like in zip(numbers, default, strict=True)]
        number = _number(text, default)
        if {">": number <= 0, "≥": number < 0, "≠": number == 0}.get(bound):
            raise ValueError
        return number
    except (ValueError, OverflowError):
        raise ValueError(f"{name} must be {wanted}, got {text}") from None


def _number(text: str, like: object) -> float:
    number = int(text) if isinstance(like, int) else float(text)
    if not math.isfinite(number):
        raise ValueError
    return number


def prepare_folder(name: str, folder: Path) -> None:
    """Make a folder, and refuse it if no file can be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ValueError(
            f"{name} must be a folder that can be written to, got {folder}: {error.strerror}"
        ) from None
