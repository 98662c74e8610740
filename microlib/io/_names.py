"""The order of image files by the numbers in their names."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from decimal import Decimal
from itertools import pairwise
from math import prod
from pathlib import Path
from statistics import mode

#: Whole numbers, whatever stands between them; numbers that may have a sign and decimals.
_WHOLE, _DECIMAL = r"(\d+)", r"([+-]?\d+(?:[.,]\d+)?)"

#: The numbers that vary in the names of files, and the files; sorted.
Reading = list[tuple[tuple[Decimal, ...], Path]]


def in_order(files: Sequence[Path]) -> list[Path]:
    """Return image files in the order of the numbers in their names.

    Parameters
    ----------
    files : sequence of Path
        Files of one stack.

    Returns
    -------
    list of Path
        In the order of their whole numbers, such as 2 before 10, or of their decimals.

    Raises
    ------
    ValueError
        If two files differ only in their format, names differ in more than their numbers, or
        their numbers give two orders: as whole numbers and as decimals, by the first number and
        by another one, or of a counter that may have begun again.

    Warns
    -----
    UserWarning
        If numbers are missing in an otherwise even sequence.
    """
    names = [file.stem for file in files]
    if twice := sorted(file.name for file in files if names.count(file.stem) > 1):
        raise ValueError(f"frames must be one file each, got {twice[0]} and {twice[1]}")
    whole, decimal = _read(files, _WHOLE), _read(files, _DECIMAL)
    readings = [reading for reading in (whole, decimal) if reading]
    remedy = "rename them, give a pattern of some, or pass a list of files"
    if not readings:
        one, *rest = sorted(files)
        text = _split(one, _WHOLE)[::2]
        two = next((file for file in rest if _split(file, _WHOLE)[::2] != text), rest[0])
        raise ValueError(
            f"frames must have names that differ only in numbers, got {one.name} and {two.name}: "
            + remedy
        )
    readings += [*_by_another_number(readings[-1]), *_begun_again(whole)]
    first, *others = ([file for _, file in reading] for reading in readings)
    for other in others:
        if other != first:
            both = [", ".join(file.name for file in order[:4]) for order in (first, other)]
            raise ValueError(
                "frames must have one order, their names give two: "
                f"{both[0]}, … or {both[1]}, …; {remedy}"
            )
    _warn_of_gaps(readings[-1])
    return first


def _split(file: Path, pattern: str) -> list[str]:
    """Return text and numbers of a name in turn."""
    return re.split(pattern, file.stem.casefold())


def _read(files: Sequence[Path], pattern: str) -> Reading | None:
    """Read the numbers in names; None if the text around them differs, or two have the same."""
    parts = [_split(file, pattern) for file in files]
    if len({tuple(each[::2]) for each in parts}) != 1:
        return None
    columns = [c for c in zip(*(each[1::2] for each in parts), strict=True) if len(set(c)) > 1]
    numbers = []
    for column in columns:
        # A hyphen before every number separates it.
        cut = all(text[0] == "-" for text in column)
        numbers.append([Decimal(text[cut:].replace(",", ".")) for text in column])
    values: list[tuple[Decimal, ...]] = list(zip(*numbers, strict=True))
    return sorted(zip(values, files, strict=True)) if len(set(values)) == len(files) else None


def _by_another_number(reading: Reading) -> Iterator[Reading]:
    """Yield the orders by numbers that are not the first ones in the names."""
    columns = [*zip(*(numbers for numbers, _ in reading), strict=True)]
    # Two axes, such as channels and positions, have all pairs of their numbers.
    if len(columns) > 1 and prod(len(set(column)) for column in columns) == len(reading):
        yield sorted(reading, key=lambda each: each[0][::-1])
    for k, column in enumerate(columns[1:], 1):
        if set(column) == {min(column) + n for n in range(len(column))}:  # a counter
            yield sorted(reading, key=lambda each: each[0][k])


def _begun_again(reading: Reading | None) -> Iterator[Reading]:
    """Yield the order of a counter of fixed width that may have begun again, as 98, 99, 00, 01."""
    if not reading or not (gaps := _gaps(reading)):
        return
    high, fixed = reading[-1][0][0], len({len(file.stem) for _, file in reading}) == 1
    top = 10 ** len(str(high))
    if fixed and max(gaps) > top / 2 and high >= top - 2 * len(reading):
        first = gaps.index(max(gaps)) + 1
        yield reading[first:] + reading[:first]


def _gaps(reading: Reading) -> list[Decimal]:
    """Return the differences of successive numbers; none where several numbers vary."""
    if len(reading[0][0]) != 1 or len(reading) < 3:
        return []
    return [after[0] - before[0] for (before, _), (after, _) in pairwise(reading)]


def _warn_of_gaps(reading: Reading) -> None:
    gaps = _gaps(reading)
    usual = mode(gaps) if gaps else Decimal(0)
    for gap, ((_, before), (_, after)) in zip(gaps, pairwise(reading), strict=False):
        if gap > usual and 2 * gaps.count(usual) > len(gaps):
            warnings.warn(f"no frame between {before.name} and {after.name}", stacklevel=2)
