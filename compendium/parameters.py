"""The parameters of a notebook: which there are, of which type, and what a reader's text means."""

from __future__ import annotations

import ast
import json
import math
import re
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from glob import glob
from pathlib import Path

import nbformat

__all__ = ["Parameter", "read_parameters", "read_values"]

ROOT = Path(__file__).resolve().parent.parent
#: The guides' parameter for the folder of the results.
OUT = "out"
_BOUNDS: dict[str, Callable[[float], bool]] = {
    "": lambda number: True,
    ">": lambda number: number > 0,
    "≥": lambda number: number >= 0,
    "≠": lambda number: number != 0,
}
#: How the comment behind a parameter states its bound: ``# µm, > 0, of the membrane``.
_STATED = re.compile(r"  # .*?([>≥≠]) 0\b")


@dataclass(frozen=True)
class Parameter:
    """A name that the parameter cell of a notebook sets.

    Attributes
    ----------
    name : str
        As in the cell.
    like : object
        A value of its type: the default, or for an optional one zero.
    optional : bool
        Whether it may be ``None``.
    is_input : bool
        Whether the default is a file of this project, so that another value must be a file, too.
    bound : str
        What a number must be to zero: ``>``, ``≥`` or ``≠``; empty for anything.
    """

    name: str
    like: object
    optional: bool = False
    is_input: bool = False
    bound: str = ""

    def read(self, text: str) -> object:
        """Return the value that a text stands for.

        Parameters
        ----------
        text : str
            As typed in a shell.

        Returns
        -------
        object
            Of the type of `like`.

        Raises
        ------
        ValueError
            If the text is of another type, or an input does not exist.

        Examples
        --------
        >>> Parameter("spacing", 25.0).read("1e1")
        10.0
        >>> Parameter("spacing", 25.0, bound=">").read("-1e1")
        Traceback (most recent call last):
        ValueError: spacing must be a finite number > 0, got -1e1
        >>> Parameter("out", "build").read("2025-01-01")
        '2025-01-01'
        """
        if self.optional and text == "None":
            return None
        if isinstance(self.like, str):
            if self.is_input and not _exists(text):
                raise ValueError(f"{self.name} must name a file, got {text}: no such file")
            return text
        try:
            if isinstance(self.like, list):
                return _numbers(json.loads(text), self.like)
            number = _number(text, self.like)
            if not _BOUNDS[self.bound](number):
                raise ValueError
            return number
        except (ValueError, TypeError, OverflowError):
            raise ValueError(f"{self.name} must be {self._wanted()}, got {text}") from None

    def _wanted(self) -> str:
        if isinstance(self.like, list):
            return f"{len(self.like)} numbers in brackets, such as {self.like}"
        kind = "a whole number" if isinstance(self.like, int) else "a finite number"
        kind += f" {self.bound} 0" if self.bound else ""
        return f"{kind} or None" if self.optional else kind


def _number(value: object, like: object) -> float:
    if isinstance(value, bool) or (isinstance(like, int) and isinstance(value, float)):
        raise ValueError
    if isinstance(like, int):
        return int(value)  # type: ignore[call-overload]
    number = float(value)  # type: ignore[arg-type]
    if not math.isfinite(number):
        raise ValueError
    return number


def _numbers(values: object, like: list) -> list[float]:
    if not isinstance(values, list):
        raise ValueError
    return [_number(value, one) for value, one in zip(values, like, strict=True)]


def _exists(text: str) -> bool:
    return Path(text).exists() or (ROOT / text).is_file() or bool(glob(text))


def read_parameters(notebook: Path) -> dict[str, Parameter]:
    """Read the parameter cell of a notebook.

    Parameters
    ----------
    notebook : pathlib.Path
        Its cell with the tag ``parameters`` holds one assignment a line; ``name: float | None =
        None`` makes an optional one, and ``> 0``, ``≥ 0`` or ``≠ 0`` in the comment a bound.

    Returns
    -------
    dict of str to Parameter
        By name, in the order of the cell.
    """
    found = {}
    for cell in nbformat.read(notebook, as_version=4).cells:
        if "parameters" not in cell.metadata.get("tags", []):
            continue
        lines = cell.source.splitlines()
        for node in ast.parse(cell.source).body:
            stated = _STATED.search(lines[node.lineno - 1])
            bound = stated[1] if stated else ""
            if isinstance(node, ast.Assign):
                name, default = ast.unparse(node.targets[0]), ast.literal_eval(node.value)
                own = isinstance(default, str) and (ROOT / default).is_file()
                found[name] = Parameter(name, default, is_input=own, bound=bound)
            elif isinstance(node, ast.AnnAssign):
                name = ast.unparse(node.target)
                if ast.unparse(node.annotation) != "float | None":
                    raise ValueError(f"{name} must be annotated as float | None or not at all")
                found[name] = Parameter(name, 0.0, optional=True, bound=bound)
    return found


def read_values(notebook: Path, texts: Mapping[str, str]) -> dict[str, object]:
    """Read a reader's values for the parameters of a notebook.

    Parameters
    ----------
    notebook : pathlib.Path
        Whose parameters they are.
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
        exist, or the folder for the results cannot be written to.
    """
    known = read_parameters(notebook)
    for name in texts:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"it has {', '.join(known)}."
            raise ValueError(f"{notebook.stem} has no parameter {name}; {hint}")
    values = {name: known[name].read(text) for name, text in texts.items()}
    if OUT in texts:
        prepare_folder(OUT, Path(texts[OUT]))
    return values


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
