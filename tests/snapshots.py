"""Texts of what a call returns or a figure draws, compared with those of when a person looked.

Numbers are compared as numbers, so that another machine's last digits change nothing.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from difflib import unified_diff
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

LOCK = Path(__file__).resolve().parent.parent / "environment.txt"
#: Numbers that are written one by one; of more, the ends, the range and means.
FEW = 12
_NUMBERS = (float, int, np.number)


def others_than_locked(*packages: str) -> list[str]:
    """Return those packages whose version is another than that which the texts are of."""
    lock = dict(re.findall(r"^([\w-]+)==([\w.]+)", LOCK.read_text(encoding="utf-8"), re.MULTILINE))
    return [name for name in packages if version(name) != lock[name]]


def compare(
    expected: str, found: str, *, of_itself: float = 2e-4, of_largest: float = 1e-9
) -> list[str]:
    """Return the lines in which two texts differ by more than rounding, as a diff.

    Two numbers are the same that differ by no more than these shares of the larger of them and of
    the largest in their line. Both being below 1e-15, they are rounding noise around zero.
    """
    old, new = expected.splitlines(), found.splitlines()
    if len(old) == len(new):
        shares = (of_itself, of_largest)
        pairs = zip(old, new, strict=True)
        new = [one if _agree(one, other, *shares) else other for one, other in pairs]
    return list(unified_diff(old, new, "before", "now", lineterm="", n=2))


def _agree(one: str, other: str, of_itself: float, of_largest: float) -> bool:
    if one == other:
        return True
    first, second = one.split(), other.split()
    if len(first) != len(second):
        return False
    numbers = [_number(word) for word in (*first, *second)]
    largest = max((abs(v) for v in numbers if v is not None and np.isfinite(v)), default=0.0)
    for left, right in zip(first, second, strict=True):
        a, b = _number(left), _number(right)
        if left == right:
            continue
        if a is None or b is None:
            return False
        size = max(abs(a), abs(b))
        if not (abs(a - b) <= of_itself * size + of_largest * largest or size < 1e-15):
            return False
    return True


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


def numbers(name: str, values: ArrayLike, *, few: int = FEW) -> str:
    """Write a few numbers; of many their count, ends, range, quarters and means.

    The last of the means has weights that no two places share, so that numbers in another order
    are noticed.
    """
    flat = np.asarray(np.ma.filled(np.ma.asarray(values, float), np.nan)).ravel()
    if flat.size <= few:
        return f"{name}: {' '.join(map(_short, flat))}"
    finite = flat[np.isfinite(flat)]
    count = f"{flat.size}" if finite.size == flat.size else f"{finite.size} of {flat.size}"
    if not finite.size:
        return f"{name}: none of {flat.size}"
    weights = np.modf(0.6180339887498949 * np.arange(1, finite.size + 1))[0]
    told = {
        "ends": flat[[0, 1, -2, -1]],
        "range": (finite.min(), finite.max()),
        "quarters": flat[(np.array([1, 2, 3]) * flat.size) // 4],
        "means": (finite.mean(), finite.std(), (weights * finite).mean()),
    }
    parts = [f"{key} {' '.join(map(_short, each))}" for key, each in told.items()]
    return f"{name}: [{count}] {' '.join(parts)}"


def _short(value: float) -> str:
    return f"{value + 0.0:.6g}"


def describe_data(data: object, name: str = "") -> list[str]:
    """Return lines of nested mappings, lists, tables, arrays, results and values."""
    if isinstance(data, Mapping):
        return [line for key, each in data.items() for line in describe_data(each, f"{name}.{key}")]
    if isinstance(data, pd.DataFrame):
        columns = {f"{key}": data[key] for key in data}
        return [line for k, each in columns.items() for line in describe_data(each, f"{name}.{k}")]
    if isinstance(data, pd.Series):
        plain = isinstance(data.index, pd.RangeIndex)
        by = [] if plain else describe_data(data.index.to_numpy(), f"{name} by {data.index.name}")
        return [*by, *describe_data(data.to_numpy(), name)]
    if isinstance(data, np.ndarray):
        return _array(data, name)
    if isinstance(data, list | tuple):
        rows = [each for row in data for each in (row if isinstance(row, list) else [row])]
        if all(each is None or isinstance(each, _NUMBERS) for each in rows):
            return [numbers(name, np.array(rows, float))]
        return [line for k, one in enumerate(data) for line in describe_data(one, f"{name}.{k}")]
    if isinstance(data, _NUMBERS) and not isinstance(data, bool):
        return [numbers(name, data)]
    if data is None or isinstance(data, str | bool | bytes):
        return [f"{name} {data!r}"]
    return [f"{name} is a {type(data).__name__}", *_parts(data, name)]


def _array(data: np.ndarray, name: str) -> list[str]:
    kind = f"{name} {data.dtype.name} {'x'.join(map(str, data.shape))}"
    if data.dtype.kind in "buif":
        return [numbers(kind, data)]
    if data.dtype.kind == "c":
        return [numbers(f"{kind} real", data.real), numbers(f"{kind} imaginary", data.imag)]
    return [f"{name} {len(data)} texts", *describe_data(data.tolist(), name)]


def _parts(data: object, name: str) -> Iterator[str]:
    """Describe the public fields and properties of an object, and what it iterates over."""
    public = (
        [each.name for each in fields(data)]
        if is_dataclass(data)
        else [*getattr(data, "__dict__", ())]
    )
    kinds = type(data).__mro__
    public += [k for kind in kinds for k, v in vars(kind).items() if isinstance(v, property)]
    for key in dict.fromkeys(public):
        try:
            value = None if key.startswith("_") else getattr(data, key)
        except ValueError as error:  # a property of what is not yet complete
            yield f"{name}.{key} refuses: {error}"
            continue
        if value is not None and not callable(value):
            yield from describe_data(value, f"{name}.{key}")
    if isinstance(data, Iterable):
        yield from describe_data(list(data), f"{name} gives")
