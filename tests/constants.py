"""Write down every constant and default of the modules, and say which have changed.

``tests/constants`` holds what is set at the top of each module and the defaults of its
functions and classes, private ones included. It holds what is, not that it is right: why a number
has its value says the comment beside it, and what rests on it the benchmarks. ``make results``
writes it anew; the commit that changes a number says why.
"""

from __future__ import annotations

import ast
import enum
import importlib
import inspect
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path

import numpy as np

from tests.results import kept
from tests.snapshots import compare, describe_data

ROOT = Path(__file__).resolve().parent.parent
#: One text for the library, one for the compendium.
FOLDER = ROOT / "tests" / "constants"
#: Of an array more is told by its ends and means.
_MANY = 60


def modules(folder: str) -> list[str]:
    """Return the names of a folder's modules but those of figures, whose constants are looks."""
    inside = [path.relative_to(ROOT).with_suffix("") for path in ROOT.glob(f"{folder}/**/*.py")]
    named = [path.parts for path in inside if path.name[:2] != "__" and "figures" not in path.parts]
    return sorted(".".join(parts) for parts in named)


def differences(_: str, before: str, text: str) -> list[str]:
    """Return the lines in which two texts of a module differ."""
    # Rounding decides the mean of what lies evenly around zero.
    return compare(before, text, of_itself=1e-9, of_largest=1e-12)


def changes(module: str) -> list[str]:
    """Return the lines that are not as they were written."""
    lines = differences(module, kept(FOLDER, module), told(module))
    return lines and [*lines, "", "`make results` writes the constants anew"]


@cache
def told(module: str) -> str:
    """Return the lines of a module: its constants, then its defaults."""
    found = importlib.import_module(module)
    lines = [f"{name} = {shown(getattr(found, name))}" for name in assigned(found)]
    for name, value in vars(found).items():
        value = inspect.unwrap(getattr(value, "py_func", value))
        if getattr(value, "__module__", None) != module:
            continue
        if inspect.isfunction(value):
            lines += defaults(name, value)
        elif inspect.isclass(value) and not issubclass(value, enum.Enum):
            for part, function in vars(value).items():
                function = getattr(function, "__func__", getattr(function, "fget", function))
                if inspect.isfunction(function):
                    lines += defaults(f"{name}.{part}", inspect.unwrap(function))
    return "".join(f"{line}\n" for line in lines if line)


def assigned(module: object) -> Iterator[str]:
    """Yield what is set at the top of a module and holds data."""
    tree = ast.parse(inspect.getsource(module))  # type: ignore[arg-type]
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        for target in targets if isinstance(node, ast.Assign | ast.AnnAssign) else ():
            for part in ast.walk(target) if target else ():
                # What an alias of types stands for is never computed with.
                if isinstance(part, ast.Name) and shown(getattr(module, part.id)):
                    yield part.id


def defaults(name: str, function: object) -> Iterator[str]:
    for each in inspect.signature(function).parameters.values():  # type: ignore[arg-type]
        if each.default not in (each.empty, None) and (said := shown(each.default)):
            yield f"{name}({each.name}={said})"


def shown(value: object) -> str:
    """Return a value as text, without digits that rounding decides; nothing of what is no data."""
    if isinstance(value, float | np.floating):
        return f"{value:.12g}"
    if isinstance(value, str | int | bool | np.integer | complex | range | slice | None):
        return str(value) if isinstance(value, np.integer) else repr(value)
    if isinstance(value, np.ndarray):
        if value.size > _MANY or value.dtype.kind not in "buif":
            return "; ".join(describe_data(value))
        return f"{value.dtype.name} {shown(value.tolist())}"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{shown(k)}: {shown(v)}" for k, v in value.items()) + "}"
    if isinstance(value, set | frozenset):
        return "{" + ", ".join(sorted(map(shown, value))) + "}"
    if isinstance(value, tuple | list):
        return "(" + ", ".join(map(shown, value)) + ")"
    if isinstance(value, re.Pattern):
        return repr(value.pattern)
    if is_dataclass(value) and not isinstance(value, type):
        parts = ", ".join(f"{f.name}={shown(getattr(value, f.name))}" for f in fields(value))
        return f"{type(value).__name__}({parts})"
    return ""


def names() -> list[str]:
    """Return the modules that have a constant or a default."""
    return [name for name in modules("microlib") + modules("compendium") if told(name)]
