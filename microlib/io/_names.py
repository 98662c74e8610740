"""The order of image files by the numbers in their names."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from decimal import Decimal
from itertools import pairwise, product
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
        In the order of their whole numbers, such as 2 before 10. Where signs, decimals or a counter
        that begins again at 0 or 1 give another order, in that with evenly spaced numbers. Names
        without numbers are in alphabetical order.

    Raises
    ------
    ValueError
        If two files differ only in their format, names differ in more than their numbers, or two
        orders are as good.

    Warns
    -----
    UserWarning
        If numbers are missing in an otherwise even sequence, or names have no numbers.
    """
    names = [file.stem for file in files]
    if twice := sorted(file.name for file in files if names.count(file.stem) > 1):
        raise ValueError(f"frames must be one file each, got {twice[0]} and {twice[1]}")
    whole, decimal = _read(files, _WHOLE), _read(files, _DECIMAL)
    readings = [reading for reading in (whole, decimal, _rolled_over(whole)) if reading]
    if not readings:
        return _without_numbers(files)
    even = [reading for reading in readings if _is_even(reading)]
    orders = even or readings
    if decimal and not even:
        orders = [*orders, *_by_another_number(decimal)]
    first, *others = ([file for _, file in reading] for reading in orders)
    for other in others:
        if other != first:
            both = [", ".join(file.name for file in order[:4]) for order in (first, other)]
            raise ValueError(
                f"frames must have one order, their names give two: {both[0]}, … or {both[1]}, …; "
                "rename them, give a pattern of some, or pass a list of files"
            )
    _warn_of_gaps(orders[0])
    return first


def _without_numbers(files: Sequence[Path]) -> list[Path]:
    """Return files in alphabetical order; raise if some of their names are a numbered series."""
    texts = {file: _split(file, _WHOLE)[::2] for file in sorted(files)}
    ordered = [*texts]
    for file, other in product(ordered, ordered):
        if file != other and texts[file] == texts[other]:  # one series, and others beside it
            stray = next((each for each in ordered if texts[each] != texts[file]), other)
            raise ValueError(
                f"frames must have names that differ only in numbers, got {file.name} and "
                f"{stray.name}: give a pattern of some, or pass a list of files"
            )
    if len(files) > 1:
        warnings.warn("names without a common number: frames in alphabetical order", stacklevel=2)
    return ordered


def _by_another_number(reading: Reading) -> Iterator[Reading]:
    """Yield the orders by numbers that are not the first ones in the names."""
    columns = [*zip(*(numbers for numbers, _ in reading), strict=True)]
    # Two axes, such as channels and positions, have all pairs of their numbers.
    if len(columns) > 1 and prod(len(set(column)) for column in columns) == len(reading):
        yield sorted(reading, key=lambda each: each[0][::-1])
    for column in columns[1:]:
        pairs = zip(column, reading, strict=True)
        counter: Reading = [((number,), file) for number, (_, file) in pairs]
        counter.sort()
        if len(set(column)) == len(reading) and _is_even(counter):
            yield counter


def _split(file: Path, pattern: str) -> list[str]:
    """Return text and numbers of a name in turn."""
    return re.split(pattern, file.stem.casefold())


def _read(files: Sequence[Path], pattern: str) -> Reading | None:
    """Read the numbers in names; None if the text around them differs, or two have the same."""
    parts = [_split(file, pattern) for file in files]
    if len({tuple(each[::2]) for each in parts}) != 1:
        return None
    numbers = []
    columns = zip(*(each[1::2] for each in parts), strict=True)
    for k, (before, column) in enumerate(zip(parts[0][:-1:2], columns, strict=True)):
        if len(set(column)) > 1:
            # A hyphen before every number, after a letter or digit, separates; else it is a sign.
            joins = before[-1:].isalpha() or (k > 0 and not before)
            cut = joins and all(text[0] == "-" for text in column)
            numbers.append([Decimal(text[cut:].replace(",", ".")) for text in column])
    values: list[tuple[Decimal, ...]] = list(zip(*numbers, strict=True))
    return sorted(zip(values, files, strict=True)) if len(set(values)) == len(files) else None


def _rolled_over(reading: Reading | None) -> Reading | None:
    """Return the order of a counter of fixed width that begins again at 0 or at 1."""
    if not reading or not (gaps := _gaps(reading)):
        return None
    low, high = reading[0][0][0], reading[-1][0][0]
    first, top = gaps.index(max(gaps)) + 1, 10 ** len(str(high))
    fixed = len({len(file.stem) for _, file in reading}) == 1
    if not fixed or max(gaps) < top / 2 or high < top - 2 * len(reading):
        return None
    period = Decimal(top if low == 0 else top - 1)
    return reading[first:] + [((value + period,), file) for (value,), file in reading[:first]]


def _gaps(reading: Reading) -> list[Decimal]:
    """Return the differences of successive numbers; none where several numbers vary."""
    if len(reading[0][0]) != 1 or len(reading) < 3:
        return []
    return [after[0] - before[0] for (before, _), (after, _) in pairwise(reading)]


def _is_even(reading: Reading) -> bool:
    """Return whether the numbers rise by one step, or by multiples of it that leave few out."""
    steps = [gap / min(gaps) for gap in gaps] if (gaps := _gaps(reading)) else []
    return bool(steps) and all(step % 1 == 0 for step in steps) and sum(steps) < 2 * len(reading)


def _warn_of_gaps(reading: Reading) -> None:
    gaps = _gaps(reading)
    usual = mode(gaps) if gaps else Decimal(0)
    for gap, ((_, before), (_, after)) in zip(gaps, pairwise(reading), strict=False):
        if gap > usual and 2 * gaps.count(usual) > len(gaps):
            gap_at = f"no frame between {before.name} and {after.name}"
            effect = "if one is missing, all positions and times after it are wrong"
            warnings.warn(f"{gap_at}: {effect}", stacklevel=2)
