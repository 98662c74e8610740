"""The parameters of a notebook: a table of them, and a reader's values as typed in a shell."""

from __future__ import annotations

import ast
import math
import re
import tempfile
from collections.abc import Sequence
from difflib import get_close_matches
from glob import glob
from pathlib import Path
from typing import Any

import pandas as pd
import papermill

from compendium import ROOT

#: How the comment behind a parameter states its bound: ``# µm, > 0, of the membrane``.
_BOUND = re.compile(r"([>≥≠]) 0\b")
#: A number with a decimal comma, which is no list.
_COMMA = re.compile(r"^\s*-?\d+,\d+\s*$")


def describe(notebook: str) -> pd.DataFrame:
    """Return a table of the parameters of a notebook, except where its records are written.

    Parameters
    ----------
    notebook : str
        Name without ``.ipynb``.

    Returns
    -------
    pandas.DataFrame
        A row for each parameter: default, values that are accepted, and meaning.

    Examples
    --------
    >>> describe("04_mechanical_characterization").loc["seed", "accepted values"]
    'a whole number ≥ 0'
    """
    rows = {}
    for name, entry in papermill.inspect_notebook(ROOT / "notebooks" / f"{notebook}.ipynb").items():
        if name != "record":
            default, bound = ast.literal_eval(entry["default"]), _BOUND.search(entry["help"])
            accepted = "a text"
            if not isinstance(default, str):
                accepted = _wanted(default, bound[1] if bound else "")
            meaning = _BOUND.sub("", entry["help"]).strip(" ,")
            rows[name] = (entry["default"], accepted, re.sub(", (?=[,;])", "", meaning))
    columns = ["default", "accepted values", "meaning"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("parameter")


def read_values(notebook: Path, texts: Sequence[tuple[str, str]]) -> dict[str, object]:
    """Read a reader's values for the parameters of a notebook.

    Parameters
    ----------
    notebook : pathlib.Path
        Its cell with the tag ``parameters`` holds one assignment a line, whose default tells the
        type: a number, a list of numbers, a list of such lists, a text, or ``None`` for a number
        that may be missing. The comment behind it may state a bound, ``> 0``, ``≥ 0`` or ``≠ 0``,
        or begin with ``input:`` if the text names a file that must exist.
    texts : sequence of tuple of str
        Names and values, as typed in a shell.

    Returns
    -------
    dict of str to object
        Of the types of the parameters.

    Raises
    ------
    ValueError
        If there is no such parameter, one is given twice, a text is of another type or out of
        bounds, a file does not exist, or the folder for the results, ``out``, cannot be written to.
    """
    known = papermill.inspect_notebook(notebook)
    values: dict[str, object] = {}
    for name, text in texts:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"it has {', '.join(known)}."
            raise ValueError(f"{notebook.stem} has no parameter {name}; {hint}")
        if name in values:
            raise ValueError(f"{name} must be given once, got {values[name]!r} and {text!r}")
        default, comment = ast.literal_eval(known[name]["default"]), known[name]["help"]
        if isinstance(default, str):
            values[name] = text
            word = f'"{text}"' in comment  # that the guide knows, such as "demo"
            if comment.startswith("input:") and not (word or Path(text).exists() or glob(text)):
                raise ValueError(f"{name} must name a file, got {text}: no such file")
        else:
            bound = _BOUND.search(comment)
            sign = bound[1] if bound else ""
            try:
                values[name] = _like(ast.literal_eval(text.strip()), default, sign)
            except (ValueError, SyntaxError, TypeError):
                got = f"got {text}" + ": write a decimal point" * bool(_COMMA.search(text))
                raise ValueError(f"{name} must be {_wanted(default, sign)}, {got}") from None
        if name == "out":
            prepare_folder(name, Path(text))
    return values


def _like(value: Any, default: object, sign: str) -> object:
    """Return a value with the type of a default; a list of lists may have any length."""
    if isinstance(default, list):
        each = default[:1] * len(value) if isinstance(default[0], list) else default
        if not isinstance(value, list) or not value:
            raise ValueError
        return [_like(one, like, sign) for one, like in zip(value, each, strict=True)]
    if default is None and value is None:
        return None
    kinds = (int,) if isinstance(default, int) else (int, float)
    if type(value) not in kinds or not math.isfinite(value):
        raise ValueError
    if {">": value <= 0, "≥": value < 0, "≠": value == 0}.get(sign):
        raise ValueError
    return value if isinstance(default, int) else float(value)


def _wanted(default: object, sign: str) -> str:
    if isinstance(default, list):
        nested = isinstance(default[0], list)
        kind = f"lists of {len(default[0])}" if nested else str(len(default))
        return f"{kind} numbers in brackets, such as {default}"
    kind = "a whole number" if isinstance(default, int) else "a finite number"
    return kind + (f" {sign} 0" if sign else "") + (" or None" if default is None else "")


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
